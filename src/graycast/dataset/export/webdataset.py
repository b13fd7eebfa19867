"""WebDataset shards for training: pictures as PNG, labels as NPY and JSON.

KEY.rgb.png or KEY.gray.png; KEY.depth.npy and KEY.depth_sl.npy, uint16 steps of `depth_scale` [mm],
0 is unknown (no PNG, because the webdataset package decodes every PNG to 8 bits); KEY.obj_id.npy
(n); KEY.boxes.npy (n, 4), x, y, columns, rows; KEY.poses.npy (n, 4, 4), part to camera [m];
KEY.visib_fract.npy (n); KEY.masks.json, COCO's compressed run lengths of what is visible;
KEY.info.json, the camera and the instances' places in the dataset's `scene_gt.json`.
"""

import io
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..stored import StoredDataset, StoredScene
from .options import Options, settled
from .placing import write_shards


def write_split(
    folder: Path, split: str, scenes: Iterable[StoredScene], stored: StoredDataset, options: Options
) -> None:
    """`SPLIT/shard-000000.tar` ..."""
    (folder / split).mkdir()
    samples = ((f"{scene.image_id:06d}", _files(scene, options)) for scene in scenes)
    write_shards(folder / split, samples, most=settled(options.shard_scenes))


def _files(scene: StoredScene, options: Options) -> Iterator[tuple[str, bytes]]:
    if options.picture is not None:
        yield f"{options.image}.png", scene.png(options.picture).read_bytes()
    for depth in options.depths:
        yield f"{depth}.npy", _npy(scene.picture(depth))
    view = scene.view()
    info = {
        "scene_id": scene.image_id,
        "size": list(scene.size_px),
        "cam_K": view.cam_K,
        "distortion": view.distortion,
        "depth_scale": view.depth_scale,
    }
    if "masks" in scene.holds:
        labels = scene.labels(min_visibility=settled(options.min_visibility))
        info["gt_id"] = [label.instance for label in labels]
        yield "obj_id.npy", _npy(np.array([label.obj_id for label in labels], np.int64))
        boxes = np.array([label.box for label in labels], np.float32)
        yield "boxes.npy", _npy(boxes.reshape(-1, 4))
        if "poses" in scene.holds:
            poses = np.array([label.T_cam_part for label in labels], np.float64)
            yield "poses.npy", _npy(poses.reshape(-1, 4, 4))
        if "shares" in scene.holds:
            yield "visib_fract.npy", _npy(np.array([b.visib_fract for b in labels], np.float64))
        yield "masks.json", json.dumps([label.segmentation for label in labels]).encode()
    yield "info.json", json.dumps(info).encode()


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()
