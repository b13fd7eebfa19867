"""Write COCO annotations: masks as run lengths, one file per scene as in BOP, one per split."""

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ...rendering.radiance import Silhouette
from ..files.records import split_annotation

IGNORED_BELOW = 0.1  # calc_gt_coco of bop_toolkit ignores instances below this visibility.


def run_lengths(crop: Silhouette, *, height_px: int, width_px: int) -> list[int]:
    """Return COCO's uncompressed RLE of a mask: the lengths of runs, column by column.

    Runs of 0 and of 1 alternate, starting with 0. The crop must be inside the image.
    """
    bh, bw = crop.mask.shape
    slab = np.zeros((bw, height_px), dtype=bool)  # transposed: COCO counts down the columns
    slab[:, crop.top_px : crop.top_px + bh] = crop.mask.T
    flat = np.zeros(slab.size + 2, dtype=np.int8)
    flat[1:-1] = slab.ravel()
    turns = np.flatnonzero(np.diff(flat)) + crop.left_px * height_px
    end = height_px * width_px
    lengths = np.diff(np.concatenate([[0], turns, [end]]))
    # A mask that ends in the last pixel has no closing run of 0.
    return lengths.tolist() if lengths[-1] > 0 else lengths[:-1].tolist()


def scene_annotation(
    *,
    image_id: int,
    obj_id: int,
    run_length: list[int],
    box: list[int],
    area_px: int,
    visib_fract: float,
    height_px: int,
    width_px: int,
) -> dict[str, Any]:
    """Return an entry of `scene_gt_coco.json`, without id, with the keys of calc_gt_coco.

    As in bop_toolkit, `box` is [x, y, width, height] of the amodal mask inside the image.
    """
    return {
        "image_id": image_id,
        "category_id": obj_id,
        "iscrowd": 0,
        "area": area_px,
        "bbox": box,
        "segmentation": {"counts": run_length, "size": [height_px, width_px]},
        "width": width_px,
        "height": height_px,
        "ignore": visib_fract < IGNORED_BELOW,
    }


def scene_image(*, image_id: int, file_name: str, height_px: int, width_px: int) -> dict[str, Any]:
    """Return the entry of an image in `scene_gt_coco.json`."""
    return {"id": image_id, "file_name": file_name, "width": width_px, "height": height_px}


def coco_categories(names: Iterable[tuple[int, str]]) -> list[dict[str, Any]]:
    """Return COCO categories from object ids and names."""
    return [{"id": i, "name": name, "supercategory": "graycast"} for i, name in names]


def scene_coco(
    *,
    obj_ids: Iterable[int],
    images: list[dict[str, Any]],
    annotations: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return `scene_gt_coco.json`, without BOP's dates, so that equal scenes give equal files."""
    return {
        "info": {"description": "graycast_train", "version": "0.1.0"},
        "licenses": [],
        "categories": coco_categories((obj_id, str(obj_id)) for obj_id in obj_ids),
        "images": images,
        "annotations": annotations,
    }


def add_images(
    whole: dict[str, Any], images: list[dict[str, Any]], annotations: Iterable[Mapping[str, Any]]
) -> None:
    """Append images and annotations to a scene's file; annotation ids continue from the last."""
    whole["images"] += images
    first = len(whole["annotations"]) + 1
    whole["annotations"] += [{**entry, "id": k} for k, entry in enumerate(annotations, first)]


def split_coco(
    annotated: Iterable[tuple[int, list[Any], list[Any]]],
    *,
    pictures: Iterable[Mapping[str, Any]],
    categories: list[dict[str, Any]],
) -> Iterator[str]:
    """Yield the text of the split's COCO file in pieces, so that memory use stays constant.

    Args:
        annotated: for each image its id, its annotations in `scene_gt_coco.json` and its list
            in `scene_gt_info.json`.
        pictures: COCO images, in the same order.
        categories: COCO categories with the parts' names.

    Boxes enclose the visible masks, which the segmentations hold as compressed RLE.
    """
    yield '{"info": {"description": "Graycast, training split"},\n"licenses": [],\n'
    yield f'"categories": {json.dumps(categories)},\n"images": ['
    separator = "\n"
    for picture in pictures:
        yield separator + json.dumps(picture)
        separator = ",\n"
    yield '],\n"annotations": ['
    separator, annotation_id = "\n", 0
    for image_id, annotations, infos in annotated:
        visible = [info["visib_fract"] for info in infos if info["px_count_visib"] > 0]
        for annotation, visib_fract in zip(annotations, visible, strict=True):
            annotation_id += 1
            entry = {"id": annotation_id} | split_annotation(annotation, image_id)
            yield separator + json.dumps(entry | {"visib_fract": visib_fract})
            separator = ",\n"
    yield "]}\n"
