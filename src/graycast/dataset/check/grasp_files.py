"""Read and check the files of grasp labels, which a dataset stores apart from its scenes.

grasps/suction/grasps.json         the dataset, the tool and the options
grasps/suction/train/000000.json   the labels of one scene; the file is complete or missing

Grasp labels are not part of the scenes: adding or removing them leaves the dataset unchanged.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...base.frames import is_rigid
from ..files.places import SPLITS
from ..files.records import Matrix3, OneImage, Pose, Positive, Record, Vector
from ..files.safe_reading import Unreadable, read_json
from ..files.scene_folder import SceneFolder
from .model_check import Model
from .plain_scene import transform_of

GRASPS, GRASP_CLAIM = "grasps", "grasps.json"
GRASP_FORMAT = 1
POSE_MM, POSE_TURN = 1e-6, 1e-9  # tolerances between two computations of a pose
BOX_MM = 1e-3  # tolerance: a model's PLY stores nine digits

Reach = Literal["free", "part", "bin", "table", "rig"]
Ended = Literal["held", "lost seal", "slipped", "not held", "missed", "other part"]


class GraspClaim(Record):
    """The content of `grasps.json`. `dataset` is the fingerprint in `graycast.json`."""

    format_version: Literal[1]
    config: dict[str, Any]
    seed: Annotated[int, Field(ge=0)]
    dataset: str
    versions: dict[str, str]

    @property
    def opening_mm(self) -> float | None:
        """Opening of the jaws; None for a suction cup."""
        jaws = self.config.get("tool", {}).get("jaws")
        return None if jaws is None else 1e3 * float(jaws["opening_m"])


class Simulated(Record):
    """The outcome of a grasp in a physics simulation."""

    success: bool
    ended: Ended
    least_factor: Annotated[float, Field(ge=0)] | None


class Grasp(Record):
    """A grasp: the tool's pose in the model's frame [mm] and in the camera's, and its score.

    `opening` [mm] is the distance of the pads when the jaws touch the part; None for a suction cup.
    """

    R_t2m: Matrix3
    t_t2m: Vector
    cam_R_t2c: Matrix3
    cam_t_t2c: Vector
    opening: Positive | None
    score: Annotated[float, Field(ge=0, le=1)]
    reach: Reach
    simulated: Simulated | None


class InstanceGrasps(Record):
    obj_id: Annotated[int, Field(ge=1)]
    grasps: list[Grasp]


SceneGrasps = OneImage[list[InstanceGrasps]]
"""The labels of one scene, with an entry for each instance of `scene_gt.json`."""


def grasp_problems(out: Path, fingerprint: str, models: Mapping[int, Model]) -> Iterator[str]:
    """Yield all problems of the grasp labels of a dataset; a scene may have no labels.

    Args:
        out: the folder of the dataset.
        fingerprint: the fingerprint of the dataset.
        models: the models of the dataset, by object id.
    """
    for folder in sorted((out / GRASPS).glob("*")):
        if folder.name.startswith("."):
            continue
        try:
            claim = read_json(folder / GRASP_CLAIM, GraspClaim)
        except Unreadable as error:
            yield f"{GRASPS}/{folder.name}: {error}"
            continue
        if claim.dataset != fingerprint:
            yield f"{GRASPS}/{folder.name}: {GRASP_CLAIM} is of another dataset"
        for path in sorted(path for split in SPLITS for path in (folder / split).glob("*")):
            if not path.name.startswith("."):
                where = path.relative_to(out)
                for what in _file_problems(out, path, claim.opening_mm, models):
                    yield f"{where}: {what}"


def _file_problems(
    out: Path, path: Path, opening_mm: float | None, models: Mapping[int, Model]
) -> Iterator[str]:
    try:
        labels = read_json(path, SceneGrasps).image
        scene = SceneFolder(out / path.parent.name / path.stem)
        poses = scene.record("scene_gt", OneImage[list[Pose]]).image
    except Unreadable as error:
        yield str(error)
        return
    if [entry.obj_id for entry in labels] != [pose.obj_id for pose in poses]:
        yield f"its {len(labels)} instances are not the {len(poses)} of scene_gt.json"
        return
    for i, (entry, pose) in enumerate(zip(labels, poses, strict=True)):
        for k, grasp in enumerate(entry.grasps):
            for what in _grasp_problems(grasp, pose, opening_mm, models.get(pose.obj_id)):
                yield f"instance {i}, grasp {k}: {what}"


def _grasp_problems(
    grasp: Grasp, pose: Pose, opening_mm: float | None, model: Model | None
) -> Iterator[str]:
    T_part_tool = transform_of(grasp.R_t2m, grasp.t_t2m)
    T_cam_tool = transform_of(grasp.cam_R_t2c, grasp.cam_t_t2c)
    if not (is_rigid(T_part_tool) and is_rigid(T_cam_tool)):
        yield "R_t2m or cam_R_t2c is not a rotation"
        return
    off = np.abs(transform_of(pose.cam_R_m2c, pose.cam_t_m2c) @ T_part_tool - T_cam_tool)
    if off[:3, 3].max() > POSE_MM or off[:3, :3].max() > POSE_TURN:
        yield "cam_R_t2c and cam_t_t2c are not its pose on the model, at the model's pose"
    if model is not None:
        low, high = model.vertices.min(axis=0) - BOX_MM, model.vertices.max(axis=0) + BOX_MM
        if (T_part_tool[:3, 3] < low).any() or (T_part_tool[:3, 3] > high).any():
            yield f"t_t2m {grasp.t_t2m} is outside of the model's box"
    if (grasp.opening is None) != (opening_mm is None):
        yield f"opening is {grasp.opening}, which only jaws have, and always"
    elif grasp.opening is not None and opening_mm is not None and grasp.opening > opening_mm:
        yield f"opening is {grasp.opening:g} mm, the jaws open {opening_mm:g} mm"
    trial = grasp.simulated
    if trial is not None and grasp.reach != "free":
        yield f"it is simulated, and its reach is {grasp.reach}"
    if trial is not None and trial.success != (trial.ended == "held"):
        yield f"success is {trial.success} and ended is {trial.ended}"
