"""Read the bin and the parts of a stored dataset, and search for grips on these parts."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pydantic import ValidationError

from ...base.errors import ConfigError, DatasetError
from ...base.frames import inverse
from ...base.progress import UNWATCHED, ProgressMeter
from ...cell.config import Config, resolve_parts
from ...cell.stored_bin import stored_bin
from ...dataset.read.example import pose_m
from ...dataset.read.stored import StoredDataset, StoredScene
from ...dataset.write.claim import BESIDE_CONFIG, part_digest, rig_of
from ...rig.pair import Rig
from ...world.drop import Body, make_bodies
from ...world.parts import Part
from ...world.scene import Bin, Scene
from ..grasp import Grip
from ..pick.arm.obstacles import standing
from ..pick.arm.robot import Obstacle
from ..pick.tool.tools import Tool, grips_on
from ..pick.tool.touch import ContactPart
from .label_options import Labelling


@dataclass(frozen=True, slots=True, kw_only=True)
class Stock:
    """Bin, parts and rig that all scenes of a dataset share."""

    bin: Bin
    parts: tuple[Part, ...]
    rig: Rig


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspWorld:
    """A `Stock` with rigid bodies of its parts, and with all tried grips on each kind of part."""

    stock: Stock
    tool: Tool
    bodies: tuple[Body, ...]
    kinds: tuple[ContactPart, ...]
    places: tuple[tuple[Grip, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenePoses:
    """Poses of the camera and of the parts of a scene."""

    T_world_cam: Float[np.ndarray, "4 4"]
    T_world_part: Float[np.ndarray, "n 4 4"]
    T_cam_part: Float[np.ndarray, "n 4 4"]
    part_index: Int[np.ndarray, " n"]


def read_stock(dataset: StoredDataset, files: Path) -> Stock:
    """Return the parts, the bin and the rig of a dataset.

    Args:
        files: the folder that paths in the configuration are relative to.

    Raises:
        DatasetError: the poses are unknown, or files of the parts or of the bin have changed.
        GraycastError: a file in the configuration cannot be used.
    """
    claim = dataset.claim
    if dataset.real:
        raise DatasetError(
            f"{dataset.folder}: holds real pictures, whose poses are not known: give a simulated "
            "dataset"
        )
    if claim["distractors"]:
        raise DatasetError(
            f"{dataset.folder}: has foreign parts among its own, and no file states their poses: "
            "make a dataset without domain.distractors"
        )
    content = {key: value for key, value in claim["config"].items() if key not in BESIDE_CONFIG}
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        raise DatasetError(
            f"{dataset.folder}: its configuration is of another version of Graycast: "
            f"{error.errors()[0]['msg']}"
        ) from error
    parts, _ = resolve_parts(config, files)
    for part, record in zip(parts, claim["parts"], strict=True):
        if part_digest(part) != record["content"]:
            raise DatasetError(
                f"{dataset.folder}: part {record['name']} has changed since the dataset was made: "
                "restore its files, or use the version of Graycast that made the dataset"
            )
    return Stock(bin=stored_bin(dataset, files), parts=parts, rig=rig_of(claim["rig"]))


def make_world(
    stock: Stock, labelling: Labelling, *, progress: ProgressMeter = UNWATCHED
) -> GraspWorld:
    """Return a stock with its rigid bodies and with the grips on each kind of part.

    Raises:
        ConfigError: the jaws do not fit around any of the parts.
    """
    bodies = make_bodies(stock.parts, progress=progress)
    places = []
    for part, body in zip(stock.parts, bodies, strict=True):
        progress.stage(f"{part.name}: searching for grasps")
        places.append(tuple(grips_on(labelling.tool, part, body, count=labelling.places)))
    if not any(places):
        names = ", ".join(part.name for part in stock.parts)
        raise ConfigError(f"tool: its jaws fit around none of {names}: increase opening_m")
    return GraspWorld(
        stock=stock,
        tool=labelling.tool,
        bodies=bodies,
        kinds=tuple(
            ContactPart.of(part, body) for part, body in zip(stock.parts, bodies, strict=True)
        ),
        places=tuple(places),
    )


def read_heap(scene: StoredScene) -> ScenePoses:
    """Read the poses of the camera and of the parts of a scene.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    view, poses = scene.view(), scene.poses()
    T_world_cam = inverse(pose_m(view.cam_R_w2c, view.cam_t_w2c))
    T_cam_part = np.array([pose_m(pose.cam_R_m2c, pose.cam_t_m2c) for pose in poses])
    T_cam_part = T_cam_part.reshape(-1, 4, 4)
    return ScenePoses(
        T_world_cam=T_world_cam,
        T_world_part=T_world_cam @ T_cam_part,
        T_cam_part=T_cam_part,
        part_index=np.array([pose.obj_id - 1 for pose in poses], dtype=np.int64),
    )


def around(world: GraspWorld, heap: ScenePoses) -> tuple[Obstacle, ...]:
    """Return the bin, the table and the rig as obstacles."""
    stock = world.stock
    scene = Scene(rig=stock.rig, T_world_cam=heap.T_world_cam, parts=stock.parts, bin=stock.bin)
    return standing(scene, np.eye(4))
