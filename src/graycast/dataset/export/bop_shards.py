"""Export to BOP's shards for training, in the form that bop_toolkit reads.

An image is the files KEY.rgb.png (or KEY.gray.tiff), KEY.depth.png, KEY.camera.json, KEY.gt.json,
KEY.gt_info.json, KEY.mask.json and KEY.mask_visib.json. Masks are run lengths by the instance's
index in `gt`. Shards keep the order of the scenes. The scenes are independent of each other, so a
program may read them in this order and still see random scenes.

BOP's pixel (0, 0) is the centre of the top-left pixel. In bop_toolkit's renderers it is that
pixel's corner: they project a point to x = fx X/Z + cx, and the centre of pixel k is at k + 1/2.
For these renderers, `pixel_origin="corner"` adds half a pixel to cx and cy.

Source: the documented layout of bop_toolkit's `dataset/bop_webdataset.py`.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from ...base.file_limits import parse_json
from ...base.mask_box import mask_box
from ...rendering.radiance import Silhouette
from ..files.json_text import json_bytes
from ..files.places import camera_file
from ..read.stored import StoredDataset, StoredScene
from ..write.coco import run_lengths
from .options import Options, settled
from .picture_job import PictureJob
from .placing import Sample, bop_key, place, write_shards


def content(job: PictureJob) -> Sample:
    """Return the key of a picture, and its files in a shard."""
    return bop_key(job.scene.scene_id, job.scene.place), list(_files(job.scene, job.options))


def write_split(
    folder: Path, split: str, contents: Iterable[Sample], stored: StoredDataset, options: Options
) -> None:
    """Write `SPLIT/shard-000000.tar` ... and `SPLIT/key_to_shard.json`."""
    (folder / split).mkdir()
    shard_of = write_shards(folder / split, contents, most=settled(options.shard_scenes))
    (folder / split / "key_to_shard.json").write_text(json.dumps(shard_of), encoding="ascii")


def write_rest(
    folder: Path, splits: Iterable[str], stored: StoredDataset, options: Options
) -> None:
    """Write the files of the whole dataset: each scanner's camera, and the models."""
    for name in (camera_file(sensor) for sensor in stored.sizes_px):
        camera = parse_json((stored.folder / name).read_bytes())
        camera |= {key: camera[key] + options.shift_px for key in ("cx", "cy")}
        (folder / name).write_bytes(json_bytes(camera))
    for source in sorted((stored.folder / "models").glob("*")):
        place(source, folder / "models" / source.name, link=False)


def _files(scene: StoredScene, options: Options) -> Iterator[tuple[str, bytes]]:
    if options.image == "rgb":
        yield "rgb.png", scene.png("rgb").read_bytes()
    elif options.image == "gray":
        yield "gray.tiff", cv2.imencode(".tiff", scene.picture("gray_sl"))[1].tobytes()
    for depth in options.depths:
        yield "depth.png", scene.png(depth).read_bytes()
    camera = scene.of_image("scene_camera", object)
    for k in (2, 5):
        camera["cam_K"][k] += options.shift_px
    yield "camera.json", json.dumps(camera).encode()
    if "masks" not in scene.holds:
        return
    scanner = options.depths == ("depth_sl",) and not scene.real
    yield "gt.json", json.dumps(scene.of_image("scene_gt", object)).encode()
    info = scene.of_image("scene_gt_info_sl" if scanner else "scene_gt_info", object)
    yield "gt_info.json", json.dumps(info).encode()
    height_px, width_px = scene.size_px
    if "amodal" in scene.holds:
        yield "mask.json", _run_lengths(map(_counts, scene.masks("mask")), scene)
    visible = (
        [height_px * width_px] if annotation is None else annotation.segmentation.counts
        for _, _, annotation in scene.instances()
    )
    yield "mask_visib.json", _run_lengths(visible, scene)


def _counts(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    x, y, columns, rows = mask_box(mask)
    crop = Silhouette(left_px=x, top_px=y, mask=mask[y : y + rows, x : x + columns])
    height_px, width_px = mask.shape
    return run_lengths(crop, height_px=height_px, width_px=width_px)


def _run_lengths(counts: Iterable[list[int]], scene: StoredScene) -> bytes:
    size = list(scene.size_px)
    each = {i: {"counts": own, "size": size} for i, own in enumerate(counts)}
    return json.dumps(each).encode()
