"""Export to COCO: a folder of pictures and a file of annotations for each set of the split."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pycocotools import mask as coco_mask

from ..read.example import InstanceLabel
from ..read.stored import StoredDataset, StoredScene
from ..write.coco import coco_categories
from .options import Options, settled
from .outline import polygons
from .placing import place


def write_split(
    folder: Path, split: str, scenes: Iterable[StoredScene], stored: StoredDataset, options: Options
) -> None:
    """Write `annotations/instances_SPLIT.json`, `images/SPLIT/000000.png`, and folders of depth.

    The id of an image is the picture's number. In addition to COCO's keys, an image has `cam_K`,
    `distortion` and `depth_scale` [mm]. An annotation has `visib_fract`, `cam_R_m2c`, `cam_t_m2c`
    [mm] and `gt_id`, its index in the dataset's `scene_gt.json`.
    """
    target = folder / "annotations" / f"instances_{split}.json"
    target.parent.mkdir(exist_ok=True)
    images: list[dict[str, Any]] = []
    count, separator = 0, "\n"
    with open(target, "w", encoding="utf-8") as file:
        info = json.dumps({"description": f"Graycast, {split}"})
        file.write(f'{{"info": {info},\n"licenses": [],\n')
        categories = coco_categories(stored.categories.items())
        file.write(f'"categories": {json.dumps(categories)},\n"annotations": [')
        for scene in scenes:
            images.append(_image(folder, split, scene, options))
            for label in scene.labels(min_visibility=settled(options.min_visibility)):
                count += 1
                own = _entry(label, settled(options.polygons))
                entry = {"id": count, "image_id": scene.image_id} | own
                file.write(separator + json.dumps(entry, allow_nan=False))
                separator = ",\n"
        lines = ",\n".join(json.dumps(image, allow_nan=False) for image in images)
        file.write(f'],\n"images": [\n{lines}]}}\n')


def _image(folder: Path, split: str, scene: StoredScene, options: Options) -> dict[str, Any]:
    name = f"{scene.image_id:06d}.png"
    link = settled(options.link)
    place(scene.png(settled(options.picture)), folder / "images" / split / name, link=link)
    for depth in options.depths:
        place(scene.png(depth), folder / depth / split / name, link=link)
    view, (height_px, width_px) = scene.view(), scene.size_px
    image = {"id": scene.image_id, "file_name": name, "width": width_px, "height": height_px}
    optics = {"cam_K": view.cam_K, "distortion": view.distortion, "depth_scale": view.depth_scale}
    return image | optics


def _entry(label: InstanceLabel, as_polygons: bool) -> dict[str, Any]:
    shape: Any = label.segmentation
    if as_polygons:
        mask = coco_mask.decode(label.segmentation).astype(bool)
        shape = [polygon.ravel().tolist() for polygon in polygons(mask)]
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
