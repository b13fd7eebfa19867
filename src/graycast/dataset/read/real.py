"""Datasets of real pictures: the files of simulated datasets, without the unknown quantities.

`graycast.json` has `kind: real` and a list of what the scenes contain. There are no models, poses,
perfect depth, hidden parts of silhouettes or reasons for missing depth. Everything else is where a
simulated dataset has it, so that one reader serves both. Visible masks may overlap where the
annotators' drawings overlap.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pycocotools import mask as coco_mask
from pydantic import Field

from ...base.errors import DatasetError
from ...base.mask_box import mask_box
from ..files.places import CLAIM, finished_scenes
from ..files.records import (
    Camera,
    Claim,
    CocoFile,
    FormatVersion,
    Manifest,
    OneImage,
    Positive,
    RealAnnotation,
    RealInfo,
    RealPose,
    RealView,
    Record,
    SceneCoco,
    split_annotation,
)
from ..files.safe_reading import Unreadable, read_json
from ..files.scene_folder import SceneFolder, own_form
from .rescanned import claim_kind, is_rescanned

StoredKind = Literal["rgb", "gray_sl", "depth_sl", "masks"]
_ABSENT = ("poses", "models", "perfect depth", "amodal masks", "visible shares", "reasons")
_NAMES = {
    "rgb": "colour pictures",
    "gray_sl": "white-frame pictures",
    "depth_sl": "scanner depth",
    "masks": "masks",
}


class RealPart(Record):
    obj_id: Annotated[int, Field(ge=1)]
    name: str


class RealClaim(Record):
    """The content of `graycast.json` in a dataset of real pictures."""

    format_version: FormatVersion
    kind: Literal["real"]
    depth_scale_mm: Positive
    parts: list[RealPart]
    holds: list[StoredKind]
    sources: list[str]
    versions: dict[str, str]


def read_claim(out: Path) -> Claim | RealClaim:
    """Read the `graycast.json` of a dataset of simulated or of real pictures.

    Raises:
        DatasetError: the file is missing, damaged or of another version of Graycast.
    """
    kind = claim_kind(out)
    if kind == "rescan":
        raise DatasetError(
            f"{out} has scanner depth for a dataset of others: give the folder of its split, where "
            "training examples are read, or use graycast validate and graycast report"
        )
    try:
        if kind == "real":
            return read_json(out / CLAIM, RealClaim)
        return read_json(out / CLAIM, Claim)
    except Unreadable as error:
        raise DatasetError(f"{out} is not a Graycast dataset that can be read: {error}") from error


def absent(out: Path) -> tuple[str, ...]:
    """Return in words the data that a dataset of real pictures lacks; empty if it is simulated.

    Raises:
        DatasetError: see `read_claim`.
    """
    if is_rescanned(out):
        return ()
    claim = read_claim(out)
    if isinstance(claim, Claim):
        return ()
    return (*(_NAMES[name] for name in _NAMES if name not in claim.holds), *_ABSENT)


def real_problems(out: Path, claim: RealClaim) -> Iterator[tuple[int | None, str]]:
    """Yield all problems of a dataset of real pictures, as (scene or None, message)."""
    try:
        camera = read_json(out / "camera.json", Camera)
    except Unreadable as error:
        yield None, str(error)
        return
    if camera.depth_scale != claim.depth_scale_mm:
        yield None, f"camera.json: depth_scale is not graycast.json's {claim.depth_scale_mm}"
    finished = sorted(finished_scenes(out))
    if not finished:
        yield None, "train/ holds no scene"
    for scene_id in finished:
        try:
            scene = SceneFolder(out / "train" / f"{scene_id:06d}")
            yield from ((scene_id, what) for what in _scene_problems(scene, claim, camera))
        except Unreadable as error:
            yield scene_id, str(error)
    if "masks" in claim.holds:
        yield from ((None, what) for what in _split_problems(out, claim, finished))


def _scene_problems(scene: SceneFolder, claim: RealClaim, camera: Camera) -> Iterator[str]:
    size = (camera.height, camera.width)
    view = scene.record("scene_camera", OneImage[RealView]).image
    scene.record("manifest", Manifest)
    if view.depth_scale != claim.depth_scale_mm:
        yield f"scene_camera.json: depth_scale is not graycast.json's {claim.depth_scale_mm}"
    for name in set(claim.holds) - {"masks"}:
        image = scene.png(name)
        shape, dtype = own_form(name, size)
        if image.shape != shape or image.dtype != dtype:
            is_, must = f"{image.shape} {image.dtype}", f"{shape} {np.dtype(dtype)}"
            yield f"{name}/000000.png is {is_}, it must be {must}"
    if "masks" in claim.holds:
        yield from _mask_problems(scene, claim, size)


def _mask_problems(scene: SceneFolder, claim: RealClaim, size: tuple[int, int]) -> Iterator[str]:
    poses = scene.record("scene_gt", OneImage[list[RealPose]]).image
    infos = scene.record("scene_gt_info", OneImage[list[RealInfo]]).image
    entries = scene.record("scene_gt_coco", SceneCoco).annotations
    files = sorted((scene.path / "mask_visib").glob("*.png"))
    if not len(poses) == len(infos) == len(entries) == len(files):
        counts = f"{len(poses)}, {len(infos)}, {len(entries)} instances, {len(files)} masks"
        yield f"scene_gt.json, scene_gt_info.json and scene_gt_coco.json have {counts}"
        return
    known = {part.obj_id for part in claim.parts}
    for i, (pose, info, entry) in enumerate(zip(poses, infos, entries, strict=True)):
        mask = scene.mask("mask_visib", i)
        if mask.shape != size or not mask.any():
            yield f"mask_visib/000000_{i:06d}.png is empty, or not {size[1]} x {size[0]} pixels"
            continue
        x, y, w, h = mask_box(mask)
        if pose.obj_id not in known or entry.category_id != pose.obj_id:
            yield f"instance {i} is of object {pose.obj_id}, its annotation {entry.category_id}"
        if sum(entry.segmentation.counts) != mask.size or not np.array_equal(
            coco_mask.decode(coco_mask.frPyObjects(entry.segmentation.model_dump(), *size)), mask
        ):
            yield f"annotation {i + 1}: its segmentation is not the mask_visib of instance {i}"
        if entry.bbox != [x, y, w, h] or info.bbox_visib != [x, y, w - 1, h - 1]:
            yield f"instance {i}: its boxes {entry.bbox}, {info.bbox_visib} are not its mask's"
        if not entry.area == info.px_count_visib == mask.sum():
            yield f"instance {i}: its area {entry.area} is not the {mask.sum()} pixels of its mask"


def _split_problems(out: Path, claim: RealClaim, finished: list[int]) -> Iterator[str]:
    try:
        split = read_json(out / "train_coco.json", CocoFile[RealAnnotation])
    except Unreadable as error:
        yield str(error)
        return
    if {entry.id: entry.name for entry in split.categories} != {
        part.obj_id: part.name for part in claim.parts
    }:
        yield "train_coco.json: its categories are not the parts of graycast.json"
    if [image.id for image in split.images] != finished:
        yield "train_coco.json: its images are not the scenes"
        return
    for scene_id in finished:
        try:
            scene = SceneFolder(out / "train" / f"{scene_id:06d}")
            coco = scene.record("scene_gt_coco", SceneCoco)
        except Unreadable:
            continue  # The check of the scene reports this.
        there = [e.model_dump(exclude={"id"}) for e in split.annotations if e.image_id == scene_id]
        if there != [split_annotation(e.model_dump(), scene_id) for e in coco.annotations]:
            yield f"train_coco.json: the annotations of image {scene_id} are not the scene's"
