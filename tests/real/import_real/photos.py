"""Writers of two photos of a part (96 x 64 pixels) with labels, and of depth of a slope."""

import json
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

W, H = 96, 64
K = np.array([[100.0, 0.0, 47.5], [0.0, 100.0, 31.5], [0.0, 0.0, 1.0]])
BOX = [20, 10, 60, 10, 60, 50, 20, 50]  # pixels 20 to 59 and 10 to 49


def picture() -> np.ndarray:
    image = np.full((H, W, 3), 100, np.uint8)
    image[10:50, 20:60] = (200, 60, 20)
    return image


def part(mask_rows=slice(10, 50), mask_columns=slice(20, 60)) -> np.ndarray:
    mask = np.zeros((H, W), bool)
    mask[mask_rows, mask_columns] = True
    return mask


def write_pictures(folder: Path) -> None:
    (folder / "rgb").mkdir(parents=True)
    (folder / "annotations").mkdir()
    for k in range(2):
        Image.fromarray(picture()).save(folder / "rgb" / f"{k:06d}.png")


def coco(segmentation=None) -> dict:
    """Return the content of a COCO file for two pictures with one annotation each."""
    return {
        "images": [
            {"id": k, "file_name": f"{k:06d}.png", "width": W, "height": H} for k in range(2)
        ],
        "categories": [{"id": 1, "name": "part"}],
        "annotations": [
            {"id": k, "image_id": k, "category_id": 1, "bbox": [20, 10, 40, 40], "iscrowd": 0}
            | {"segmentation": segmentation or [BOX]}
            for k in range(2)
        ],
    }


def write_coco(folder: Path, content: dict) -> Path:
    """Write the pictures with this COCO file; return the folder."""
    write_pictures(folder)
    (folder / "annotations/instances.json").write_text(json.dumps(content))
    return folder


def write_labelme(folder: Path, shapes: list[dict]) -> Path:
    write_pictures(folder)
    for k in range(2):
        content = {"shapes": shapes, "imageHeight": H, "imageWidth": W}
        (folder / f"annotations/{k:06d}.json").write_text(json.dumps(content))
    return folder


def write_depth(folder: Path, depth: np.ndarray, count=2) -> Path:
    """Write the same depth as several pictures: integers as PNG, floats as NPY."""
    (folder / "depth").mkdir(parents=True)
    for k in range(count):
        if depth.dtype.kind in "ui":
            assert cv2.imwrite(str(folder / f"depth/{k:06d}.png"), depth)
        else:
            np.save(folder / f"depth/{k:06d}.npy", depth)
    return folder


def slope_mm() -> np.ndarray:
    return np.tile(np.linspace(700, 800, W), (H, 1))
