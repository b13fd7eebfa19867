"""Read examples from BOP's shards."""

import tarfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ..export.placing import bop_key
from ..export.record import ExportRecord
from ..read.example import Example, pose_m
from .from_bytes import DEPTH_FIELDS, boxes, depth_m, image_fields, masks, picture

Files = Mapping[str, bytes]
Place = tuple[Path, int, int]  # These are the file, offset and length of a tar member.


def open_bop_shards(
    folder: Path, split: str, record: ExportRecord, scene_ids: Sequence[int]
) -> Callable[[int], Example]:
    return partial(_example, _index(folder / split), record)


def _example(
    index: Mapping[str, Mapping[str, Place]], record: ExportRecord, scene_id: int
) -> Example:
    key = bop_key(*record.place(scene_id))
    try:
        return _bop_example(_members(index, key), record, scene_id, key)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        why = f"{type(error).__name__} {error}"
        raise DatasetError(f"{key}: is damaged ({why}): export again") from error


def _bop_example(files: Files, record: ExportRecord, scene_id: int, name: str) -> Example:
    camera = parse_json(files["camera.json"])
    fields: dict[str, Any] = {}
    for kind, ending in (("rgb", "rgb.png"), ("gray", "gray.tiff")):
        if ending in files:
            fields |= image_fields(kind, picture(files[ending], name), name)
    if "depth.png" in files:
        field = DEPTH_FIELDS["depth_sl" if record.options["depth"] == "scanner" else "depth"]
        steps = picture(files["depth.png"], name)
        fields[field] = depth_m(steps, camera["depth_scale"], name)
    K = np.array(camera["cam_K"], float).reshape(3, 3)
    if record.options.get("pixel_origin") == "corner":
        K[:2, 2] -= 0.5
    return Example(
        scene_id=scene_id,
        K=K,
        distortion=tuple(camera.get("distortion", (0.0,) * 5)),
        **fields,
        **(_bop_labels(files, record, scene_id, name) if "gt.json" in files else {}),
    )


def _bop_labels(files: Files, record: ExportRecord, scene_id: int, name: str) -> dict[str, Any]:
    gt, info = parse_json(files["gt.json"]), parse_json(files["gt_info.json"])
    runs = parse_json(files["mask_visib.json"])
    rows = [i for i, entry in enumerate(info) if entry["px_count_visib"] > 0]
    mask = masks([runs[str(i)] for i in rows], record.size_of(scene_id), name)
    pose = [pose_m(gt[i]["cam_R_m2c"], gt[i]["cam_t_m2c"]) for i in rows if "cam_R_m2c" in gt[i]]
    posed, rated = "poses" in record.holds, "shares" in record.holds
    return {
        "instance": np.array(rows, np.int64),
        "obj_id": np.array([gt[i]["obj_id"] for i in rows], np.int64),
        "mask": mask,
        "box_px": boxes(mask) if rows else np.zeros((0, 4), np.float32),
        "T_cam_part": np.array(pose, float).reshape(-1, 4, 4) if posed else None,
        "visib_fract": np.array([info[i]["visib_fract"] for i in rows], float) if rated else None,
    }


def _index(folder: Path) -> dict[str, dict[str, Place]]:
    """Return the place of each member of each sample, by key and ending, from all shards' headers.

    Raises:
        DatasetError: there is no shard, or a shard is cut off.
    """
    index: dict[str, dict[str, Place]] = {}
    shards = sorted(folder.glob("shard-*.tar"))
    if not shards:
        raise DatasetError(f"{folder}: has no shard-000000.tar: export again")
    for path in shards:
        length = path.stat().st_size
        try:
            with tarfile.open(path, "r:") as shard:
                members = shard.getmembers()
        except tarfile.TarError as error:
            raise DatasetError(f"{path}: is damaged ({error}): export again") from error
        for member in members:
            if member.offset_data + member.size > length:
                raise DatasetError(f"{path}: ends before {member.name} does: copy it again")
            key, _, ending = member.name.partition(".")
            index.setdefault(key, {})[ending] = (path, member.offset_data, member.size)
    return index


def _members(index: Mapping[str, Mapping[str, Place]], key: str) -> Files:
    if key not in index:
        raise DatasetError(f"no shard holds {key}, export.json does: export again")
    files = {}
    for ending, (path, offset, length) in index[key].items():
        with open(path, "rb") as shard:
            shard.seek(offset)
            files[ending] = shard.read(length)
    return files
