"""Export to COCO: a folder of pictures and a file of annotations for each set of the split."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..read.example import InstanceLabel
from ..read.stored import StoredDataset
from ..write.coco import coco_categories
from .options import Options, settled
from .outline import polygons
from .picture_job import PictureJob
from .placing import place


@dataclass(frozen=True, slots=True, kw_only=True)
class CocoPicture:
    """An image, its files (folder and source), and its annotations as JSON without id."""

    image: dict[str, Any]
    files: tuple[tuple[str, Path], ...]
    annotations: tuple[str, ...]


def content(job: PictureJob) -> CocoPicture:
    """Check the files of a picture, and encode its annotations."""
    scene, options = job.scene, job.options
    view, (height_px, width_px) = scene.view(), scene.size_px
    name = f"{scene.image_id:06d}.png"
    image = {"id": scene.image_id, "file_name": name, "width": width_px, "height": height_px}
    optics = {"cam_K": view.cam_K, "distortion": view.distortion, "depth_scale": view.depth_scale}
    annotations = (
        {"image_id": scene.image_id} | _entry(label, settled(options.polygons))
        for label in scene.labels(min_visibility=settled(options.min_visibility))
    )
    files = [("images", scene.png(settled(options.picture)))]
    files += [(depth, scene.png(depth)) for depth in options.depths]
    return CocoPicture(
        image=image | optics,
        files=tuple(files),
        annotations=tuple(json.dumps(entry, allow_nan=False) for entry in annotations),
    )


def write_split(
    folder: Path,
    split: str,
    contents: Iterable[CocoPicture],
    stored: StoredDataset,
    options: Options,
) -> None:
    """Write `annotations/instances_SPLIT.json`, `images/SPLIT/000000.png`, and folders of depth.

    The id of an image is the picture's number. In addition to COCO's keys, an image has `cam_K`,
    `distortion` and `depth_scale` [mm]. An annotation has `visib_fract`, `cam_R_m2c`, `cam_t_m2c`
    [mm] and `gt_id`, its index in the dataset's `scene_gt.json`.
    """
    labels = folder / "annotations" / f"instances_{split}.json"
    labels.parent.mkdir(exist_ok=True)
    images: list[dict[str, Any]] = []
    count, separator = 0, "\n"
    with open(labels, "w", encoding="utf-8") as file:
        info = json.dumps({"description": f"Graycast, {split}"})
        file.write(f'{{"info": {info},\n"licenses": [],\n')
        categories = coco_categories(stored.categories.items())
        file.write(f'"categories": {json.dumps(categories)},\n"annotations": [')
        for picture in contents:
            images.append(picture.image)
            for kind, source in picture.files:
                target = folder / kind / split / picture.image["file_name"]
                place(source, target, link=settled(options.link))
            for annotation in picture.annotations:
                count += 1
                file.write(f'{separator}{{"id": {count}, {annotation[1:]}')
                separator = ",\n"
        lines = ",\n".join(json.dumps(image, allow_nan=False) for image in images)
        file.write(f'],\n"images": [\n{lines}]}}\n')


def _entry(label: InstanceLabel, as_polygons: bool) -> dict[str, Any]:
    shape: Any = label.segmentation
    if as_polygons:
        whole = (polygon + label.box[:2] for polygon in polygons(label.window()))
        shape = [polygon.ravel().tolist() for polygon in whole]
    entry = {
        "category_id": label.obj_id,
        "iscrowd": 0,
        "area": label.area_px,
        "bbox": label.box,
        "segmentation": shape,
        "gt_id": label.instance,
    }
    if label.visib_fract is not None:
        entry["visib_fract"] = label.visib_fract
    if label.pose is not None:
        entry["cam_R_m2c"], entry["cam_t_m2c"] = label.pose
    return entry
