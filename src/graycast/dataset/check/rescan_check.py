"""Check what `graycast rescan` added to a dataset, and rebuild its JSON files from the records."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools import mask as coco_mask

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ...base.mask_box import mask_box
from ..files.places import CLAIM
from ..files.safe_reading import Unreadable, read_json, record_as
from ..files.scene_folder import (
    OWN_PICTURES,
    SCANNER,
    AnyPose,
    SceneFolder,
    dead_links,
    own_form,
    scene_folders,
)
from ..files.seal import sum_problems
from ..read.example import known_depth
from ..read.rescanned import (
    RECORDS,
    ImageRecord,
    RescanClaim,
    changes,
    image_records,
    original_sums,
)
from ..write.coco import add_images, scene_coco
from .plain_scene import holes_disagree

_COCO, _POSES = "scene_gt_coco_sl", "scene_gt_sl"
_APART_MM, _TURNED = 0.01, 5e-3  # Files may round R to three digits.
_AGAIN = "restore the original, or remove this scene and run graycast rescan again"
_NEAR, _MOST_FAR = 0.02, 0.5  # At most half of the depths may be 2 % off the perfect depth.


def scene_records(records: Mapping[int, ImageRecord]) -> dict[str, dict[str, Any]]:
    """Return the content of a scene's JSON files according to the records of its images.

    A COCO file is one object for all images; each other file has an entry for each image.
    """
    files: dict[str, dict[str, Any]] = {}
    for number, record in records.items():
        for name, entry in record.entries.items():
            if name != _COCO:
                files.setdefault(name, {})[str(number)] = entry
                continue
            whole = files.setdefault(name, scene_coco(obj_ids=(), images=[], annotations=[]))
            known = {category["id"] for category in whole["categories"]}
            whole["categories"] += [one for one in entry["categories"] if one["id"] not in known]
            add_images(whole, entry["images"], entry["annotations"])
    return files


def rescan_problems(out: Path, *, fast: bool) -> Iterator[tuple[int | None, str]]:
    """Yield all problems of the files that a scanner added, as (scene or None, message)."""
    try:
        claim = read_json(out / CLAIM, RescanClaim)
    except Unreadable as error:
        yield None, str(error)
        return
    yield from ((None, what) for what in dead_links(out))
    scenes = scene_folders(out / claim.split, RECORDS)
    if not scenes:
        yield None, f"{claim.split}/ holds no image with a scan: run graycast rescan again"
    for folder in scenes:
        try:
            for what in _scene_problems(folder, claim, fast=fast):
                yield int(folder.name), what
        except (Unreadable, DatasetError) as error:
            yield int(folder.name), str(error)


def _scene_problems(folder: Path, claim: RescanClaim, *, fast: bool) -> Iterator[str]:
    records = image_records(folder)
    for number, record in records.items():
        yield from sum_problems(folder, record.sha256, listed_in=f"{RECORDS}/{number:06d}.json")
    for name, must in scene_records(records).items():
        try:
            there = parse_json((folder / f"{name}.json").read_bytes())
        except (OSError, ValueError):
            yield f"{name}.json is missing or damaged: run graycast rescan again"
            continue
        if there != must:
            yield f"{name}.json is not what the records of its images say"
    original = SceneFolder(folder, claim.config["sensor"])
    if dead := tuple(dead_links(folder)):
        yield from dead
    else:
        yield from _original_problems(original, records, claim)
    if not fast:
        for number, record in records.items():
            perfect = None if dead else original.picture("depth", number)
            for what in _image_problems(SceneFolder(folder), number, record, claim, perfect):
                yield f"image {number}: {what}"


def _original_problems(
    scene: SceneFolder, records: Mapping[int, ImageRecord], claim: RescanClaim
) -> Iterator[str]:
    """Yield the changes of the original scene since it was scanned."""
    known = [number for number, record in records.items() if record.source and record.has_original]
    poses = not claim.config.get("options", {}).get("depth_only", False)
    sums = original_sums(scene, known, poses=poses) if known else {}
    for number, record in records.items():
        if number in sums and (names := changes(record.source, sums[number])):
            yield (
                f"image {number}: the original has changed since it was scanned "
                f"({', '.join(names)}): {_AGAIN}"
            )
        elif claim.names and (what := _pose_problem(scene, number, record, claim)):
            yield f"image {number}: {what}: {_AGAIN}"


def _pose_problem(
    scene: SceneFolder, number: int, record: ImageRecord, claim: RescanClaim
) -> str | None:
    """Return a message if the original's objects have moved since they were scanned."""
    here = scene.of_instances("scene_gt", number, AnyPose)
    here = [one for one in here if one.obj_id in claim.names]
    scanned = [record_as(one, AnyPose, _POSES) for one in record.entries[_POSES]]
    if [one.obj_id for one in here] != [one.obj_id for one in scanned]:
        return f"scene_gt has {len(here)} objects, and {_POSES} other ones ({len(scanned)})"
    for i, (a, b) in enumerate(zip(here, scanned, strict=True)):
        apart_mm = float(np.linalg.norm(np.subtract(a.cam_t_m2c, b.cam_t_m2c)))
        turned = float(np.abs(np.subtract(a.cam_R_m2c, b.cam_R_m2c)).max())
        if apart_mm > _APART_MM or turned > _TURNED:
            return f"scene_gt and {_POSES}: the poses of instance {i} are {apart_mm:.3g} mm apart"
    return None


def _image_problems(
    scene: SceneFolder,
    number: int,
    record: ImageRecord,
    claim: RescanClaim,
    perfect: np.ndarray | None,
) -> Iterator[str]:
    entries = record.entries
    names = [name for name in OWN_PICTURES if name.endswith(SCANNER)]
    names += scene.optional_pictures()
    image = {name: scene.png(name, number) for name in names}
    size = image["reason_sl"].shape
    for name in names:
        if image[name].shape != size or image[name].dtype != own_form(name, size)[1]:
            yield f"{name} is {image[name].shape} {image[name].dtype}, reason_sl is {size}"
            return
    depth = image["depth_sl"]
    yield from holes_disagree(image)
    if entries["scene_camera_sl"]["depth_scale"] != claim.depth_scale_mm:
        yield f"its depth_scale is not {CLAIM}'s {claim.depth_scale_mm}"
    yield from _mask_problems(scene, number, entries, depth)
    if claim.config["camera"] == "image":
        yield from _depth_problems(perfect, record, depth * claim.depth_scale_mm)


def _mask_problems(
    scene: SceneFolder, number: int, entries: Mapping[str, Any], depth: np.ndarray
) -> Iterator[str]:
    taken = np.zeros(depth.shape, dtype=bool)
    annotations = iter(entries[_COCO]["annotations"])
    for i, info in enumerate(entries["scene_gt_info_sl"]):
        whole, visible = (scene.mask(kind, i, number) for kind in ("mask_sl", "mask_visib_sl"))
        if whole.shape != depth.shape or visible.shape != depth.shape:
            yield f"the masks of instance {i} are {whole.shape} and {visible.shape}"
            return
        if (taken & visible).any():
            yield f"the visible mask of instance {i} overlaps another's"
        taken |= visible
        counts = int(visible.sum()), int((depth[whole] > 0).sum())
        if counts != (info["px_count_visib"], info["px_count_valid"]):
            yield f"instance {i} has {counts} visible and valid pixels, scene_gt_info_sl others"
        if not visible.any():
            continue
        x, y, columns, rows = mask_box(visible)
        if info["bbox_visib"] != [x, y, columns - 1, rows - 1]:
            yield f"instance {i}: bbox_visib is not its visible mask's"
        own = coco_mask.encode(np.asfortranarray(visible, dtype=np.uint8))["counts"]
        runs = (next(annotations, None) or {}).get("segmentation")
        if runs is None or coco_mask.frPyObjects(runs, *depth.shape)["counts"] != own:
            yield f"instance {i}: its segmentation in {_COCO} is not its visible mask"


def _depth_problems(
    perfect: np.ndarray | None, record: ImageRecord, scanned_mm: np.ndarray
) -> Iterator[str]:
    """Check that the scanned depth is near the perfect one in most pixels that have both."""
    if perfect is None or perfect.shape != scanned_mm.shape or not record.perfect_step_mm:
        return
    perfect_mm = perfect * record.perfect_step_mm
    both = known_depth(perfect) & (scanned_mm > 0)
    far = np.abs(scanned_mm - perfect_mm)[both] > _NEAR * perfect_mm[both]
    if both.any() and far.mean() > _MOST_FAR:
        yield (
            f"{far.mean():.0%} of its depths are more than {_NEAR:.0%} off the perfect depth: the "
            "scanner looked at another scene"
        )
