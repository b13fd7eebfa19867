"""Datasets of drawn pictures: bright discs and boxes at known heights on a dark floor."""

import json
from pathlib import Path

import cv2
import numpy as np
from pycocotools import mask as coco_mask

from graycast.real.depth_file import FileOptions
from graycast.real.import_real import import_real

K = np.array([[200.0, 0, 63.5], [0, 200.0, 47.5], [0, 0, 1]])
FLOOR_M, TOP_M = 1.0, 0.9
NAMES = ("disc", "box")


def write_shapes(folder: Path, count: int, *, seed: int = 0, size_px: tuple[int, int] = (96, 128)):
    """Write a real dataset of `count` pictures with colour, depth and masks to `folder/dataset`."""
    rng = np.random.default_rng(seed)
    source = folder / "source"
    for name in ("rgb", "depth", "annotations"):
        (source / name).mkdir(parents=True)
    images, annotations = [], []
    for i in range(count):
        rgb, depth_m, masks = _picture(rng, size_px)
        cv2.imwrite(str(source / "rgb" / f"{i:03d}.png"), rgb)
        np.save(source / "depth" / f"{i:03d}.npy", depth_m)
        images.append(
            {"id": i, "file_name": f"{i:03d}.png", "height": size_px[0], "width": size_px[1]}
        )
        for category, mask in masks:
            runs = coco_mask.encode(np.asfortranarray(mask.astype(np.uint8)))
            runs = {"size": runs["size"], "counts": runs["counts"].decode()}
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": i,
                    "category_id": category + 1,
                    "segmentation": runs,
                    "bbox": coco_mask.toBbox(runs).tolist(),
                    "area": int(mask.sum()),
                    "iscrowd": 0,
                }
            )
    categories = [{"id": i + 1, "name": name} for i, name in enumerate(NAMES)]
    content = {"images": images, "annotations": annotations, "categories": categories}
    (source / "annotations" / "drawn.json").write_text(json.dumps(content))
    import_real(source, folder / "dataset", files=FileOptions(K=K))
    return folder / "dataset"


def _picture(rng, size_px):
    """Return two to four objects that do not touch each other."""
    height, width = size_px
    rgb = np.full((height, width, 3), 40, np.uint8)
    depth_m = np.full(size_px, FLOOR_M, np.float32)
    depth_m[rng.random(size_px) < 0.02] = np.nan
    taken = np.zeros(size_px, np.uint8)
    masks = []
    for _ in range(int(rng.integers(2, 5))):
        for _ in range(50):
            category, half = int(rng.integers(2)), int(rng.integers(9, 14))
            x, y = (int(rng.integers(half + 2, side - half - 2)) for side in (width, height))
            mask = np.zeros(size_px, np.uint8)
            if category == 0:
                cv2.circle(mask, (x, y), half, 1, -1)
            else:
                cv2.rectangle(mask, (x - half, y - half // 2), (x + half, y + half // 2), 1, -1)
            if not (cv2.dilate(mask, np.ones((5, 5))) & taken).any():
                break
        else:
            continue
        taken |= mask
        inside = mask.astype(bool)
        rgb[inside] = (60, 200, 220) if category == 0 else (200, 90, 60)
        depth_m[inside] = TOP_M
        masks.append((category, inside))
    return rgb, depth_m, masks
