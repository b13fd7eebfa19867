"""Files of grasp labels in the folder of their dataset; see `dataset.check.grasp_files`."""

import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import DatasetError
from ...base.folder import remove_left, take_lock, write_whole
from ...base.version import __version__
from ...dataset.check.grasp_files import GRASP_CLAIM, GRASP_FORMAT, GRASPS, GraspClaim, SceneGrasps
from ...dataset.files.json_text import json_bytes, plain
from ...dataset.files.records import MM_PER_M
from ...dataset.files.safe_reading import Unreadable, read_json
from ...dataset.read.stored import StoredDataset, StoredScene
from ...dataset.write.claim import difference
from .label_options import Labelling
from .scene_labels import GraspLabel
from .stored_world import ScenePoses

_LOCK = ".lock"
_CLAIMED = ("format_version", "dataset", "seed", "config")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelFolder:
    """An open folder of labels, locked against other runs."""

    out: Path

    def of(self, scene: StoredScene) -> Path:
        """Return the path of a scene's labels, whether or not they exist."""
        return self.out / scene.split / f"{scene.scene_id:06d}.json"

    def write(self, scene: StoredScene, content: bytes) -> None:
        """Write the labels of one scene completely or not at all.

        Raises:
            GraycastError: the file cannot be written.
        """
        path = self.of(scene)
        with suppress(FileExistsError):
            path.parent.mkdir()
        write_whole(path, content)


@contextmanager
def open_labels(
    dataset: StoredDataset, name: str, labelling: Labelling, seed: int
) -> Iterator[LabelFolder]:
    """Create the folder of a set of labels, or open it again to continue the same set.

    Raises:
        DatasetError: the folder holds another set, is in use, or cannot be written.
    """
    out = dataset.folder / GRASPS / name
    claim = _claim(dataset, labelling, seed)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = take_lock(out / _LOCK)
    except OSError as error:
        raise DatasetError(
            f"{out}: cannot be written ({error.strerror}): make the folder writable"
        ) from error
    if lock is None:
        raise DatasetError(
            f"another run is writing to {out}: wait until it ends, or give another --name"
        )
    with lock:
        remove_left(out, *(entry for entry in out.iterdir() if entry.is_dir()))
        if (out / GRASP_CLAIM).exists():
            _refuse_other(out, claim)
        else:
            write_whole(out / GRASP_CLAIM, json_bytes(claim))
        try:
            yield LabelFolder(out=out)
        finally:
            _tidy(out)


def _claim(dataset: StoredDataset, labelling: Labelling, seed: int) -> dict[str, Any]:
    return plain(
        {
            "format_version": GRASP_FORMAT,
            "dataset": dataset.claim["fingerprint"],
            "config": labelling.model_dump(mode="json"),
            "seed": seed,
            "versions": {
                "graycast": __version__,
                "numpy": np.__version__,
                "python": platform.python_version(),
            },
        }
    )


def _refuse_other(out: Path, claim: dict[str, Any]) -> None:
    try:
        stored = read_json(out / GRASP_CLAIM, GraspClaim).model_dump()
    except Unreadable as error:
        raise DatasetError(f"{out}: {error}: remove this folder, or give another --name") from error
    for key in _CLAIMED:
        where = difference(stored[key], claim[key], key)
        if where is not None:
            raise DatasetError(
                f"{out} holds other labels, which differ in {where.removeprefix('config.')}: give "
                "another --name, or remove this folder"
            )


def _tidy(out: Path) -> None:
    """Remove the folder of a set of labels if it has no labels."""
    if any(out.glob("*/*.json")):
        return
    with suppress(OSError):
        (out / GRASP_CLAIM).unlink()
        (out / _LOCK).unlink()
        out.rmdir()
        out.parent.rmdir()


def scene_json(labels: Sequence[GraspLabel], heap: ScenePoses, obj_ids: Sequence[int]) -> bytes:
    """Return the labels of one scene as the content of their JSON file."""
    entries: list[dict[str, Any]] = [{"obj_id": obj_id, "grasps": []} for obj_id in obj_ids]
    for label in labels:
        T_part_tool = label.grip.T_part_tool
        T_cam_tool = heap.T_cam_part[label.instance] @ T_part_tool
        entries[label.instance]["grasps"].append(
            {
                "R_t2m": T_part_tool[:3, :3].ravel(),
                "t_t2m": MM_PER_M * T_part_tool[:3, 3],
                "cam_R_t2c": T_cam_tool[:3, :3].ravel(),
                "cam_t_t2c": MM_PER_M * T_cam_tool[:3, 3],
                "opening": None
                if label.grip.opening_m is None
                else MM_PER_M * label.grip.opening_m,
                "score": label.grip.score,
                "reach": label.reach,
                "simulated": None
                if label.ending is None
                else {
                    "success": label.ending.success,
                    "ended": label.ending.ended,
                    "least_factor": label.ending.least_factor,
                },
            }
        )
    return json_bytes({"0": entries})


def read_scene_labels(path: Path) -> SceneGrasps:
    """Read the grasp labels of a scene from its file.

    Raises:
        DatasetError: the file is missing, is damaged, or has another format.
    """
    try:
        return read_json(path, SceneGrasps)
    except Unreadable as error:
        raise DatasetError(
            f"{path}: {error}: remove it and run graycast dataset grasps again"
        ) from error
