"""Data for the animation of a folder of picks: the robot's shapes, and their poses over time.

All data come from the folder and from the configuration in it. If the configuration names files
(a URDF, meshes), these must exist at their paths.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from ....base.errors import GraycastError
from ....base.file_limits import parse_json
from ....dataset.write.claim import BESIDE_CONFIG
from ....world.parts import Mesh
from ..arm.robot import Robot, open_robot
from ..bin.pick_sections import PickConfig
from ..bin.robot_cell import PickCell, resolve_pick_cell
from ..outcome import TAKEN
from ..tool.solids import joined, shape_mesh
from ..tool.tools import T_flange_tip, Tool
from .pick_files import BINS, CLAIM, MOTION, StoredEpisode

AT_GRIP_M = 1e-3  # largest distance of the tip from its target at the grip, for rounded angles


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The robot's motion in one attempt, and the part that it carried.

    `T_world_limb` has the pose of each limb at each time. At `time_s[grip]`, the tool reaches the
    part. From then until `held_until_s`, the part with the index `part` moves with limb `carrier`.
    """

    time_s: Float[np.ndarray, " t"]
    T_world_limb: Float[np.ndarray, "t limbs 4 4"]
    grip: int
    carrier: int
    part: int | None
    held_until_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Data that all bins of a folder share; `limbs` are in their own frames, the tool's last."""

    folder: Path
    claim: Mapping[str, Any]
    cell: PickCell
    robot: Robot
    limbs: tuple[Mesh, ...]

    @property
    def arm_limbs(self) -> int:
        """Number of `limbs` that belong to the arm."""
        return len(self.limbs) - len(_tool_limbs(self.cell.config.tool))

    def T_world_limb(
        self,
        q: Float[np.ndarray, " joints"],
        opening_m: float | None = None,
        *,
        closed: bool = False,
    ) -> Float[np.ndarray, "limbs 4 4"]:
        """Return the poses of the limbs at joint angles [rad]; the tool is as in `Tool.pieces`."""
        T_world_base, tool = self.cell.T_world_base, self.cell.config.tool
        arm = T_world_base @ self.robot.places(q)
        T_world_flange = T_world_base @ self.robot.flange(q)
        pieces = [piece.T_flange_shape for piece in tool.pieces(opening_m, closed=closed)]
        soft = [T_flange_tip(tool)] * (len(self.limbs) - len(arm) - len(pieces))
        return np.concatenate([arm, T_world_flange @ np.stack([*pieces, *soft])])

    def kinds(self, episode: StoredEpisode) -> tuple[int, ...]:
        """Return the kind of each part of a bin, as an index into the cell's parts.

        Raises:
            GraycastError: the folder does not name the kinds, and the cell has several parts.
        """
        if len(episode.kinds) == episode.filled:
            return episode.kinds
        if len(self.cell.cell.scene.parts) == 1:
            return (0,) * episode.filled
        raise GraycastError(
            f"{self.folder / BINS / f'{episode.bin_id:06d}'}: does not state the kind of each "
            "part: remove this folder and run graycast robot pick again"
        )


def open_replay(out: Path, *, folder: Path) -> Replay:
    """Return the data for the animation of a folder of picks.

    Args:
        out: the folder of picks.
        folder: the folder that paths in the cell's configuration are relative to.

    Raises:
        GraycastError: the folder contains no picks, its `picks.json` is damaged, or files of the
            cell are missing or changed.
    """
    if not (out / CLAIM).is_file():
        raise GraycastError(f"{out}: holds no picks: give a folder that graycast robot pick wrote")
    try:
        claim = parse_json((out / CLAIM).read_bytes())
        content = dict(claim["config"])
        digests = content["files"]
        config = PickConfig.model_validate(
            {key: value for key, value in content.items() if key not in BESIDE_CONFIG}
        )
    except (OSError, ValueError, KeyError, TypeError, ValidationError) as error:
        why = " ".join(str(error).split())
        raise GraycastError(
            f"{out / CLAIM}: cannot be read ({why}): it is damaged, or another version of "
            "Graycast wrote it"
        ) from error
    try:
        cell = resolve_pick_cell(config, folder)
        robot = open_robot(config.robot.arm, folder=folder, home=config.robot.home_rad)
    except (GraycastError, ValueError, OSError) as error:
        raise GraycastError(
            f"{out}: its cell names files that were not found ({error}): give the folder in "
            "which their paths begin with --files"
        ) from error
    changed = [name for name, digest in digests.items() if cell.file_digests.get(name) != digest]
    if changed:
        raise GraycastError(
            f"{out}: {changed[0]} has changed since these picks were made: give the folder "
            "of the original with --files"
        )
    limbs = (*_arm_limbs(robot), *_tool_limbs(config.tool))
    return Replay(folder=out, claim=claim, cell=cell, robot=robot, limbs=limbs)


def read_motions(replay: Replay, episode: StoredEpisode) -> tuple[Motion | None, ...]:
    """Return the motion of each attempt in a bin; None if the arm did not move.

    Raises:
        GraycastError: the file is damaged, or its motions do not fit the attempts.
    """
    path = replay.folder / BINS / f"{episode.bin_id:06d}" / MOTION
    try:
        motions = parse_json(path.read_bytes())["attempts"]
        return tuple(
            None if one is None else _motion(replay, attempt, one)
            for attempt, one in zip(episode.attempts, motions, strict=True)
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise GraycastError(
            f"{path}: cannot be read ({error}): remove the bin's folder and run graycast "
            "robot pick again"
        ) from error


def _motion(replay: Replay, attempt: Mapping[str, Any], record: Mapping[str, Any]) -> Motion:
    """Return a stored motion; raise ValueError if times, angles and grip are inconsistent."""
    robot, tool = replay.robot, replay.cell.config.tool
    time_s, q = np.array(record["time_s"], dtype=float), np.array(record["q"], dtype=float)
    if q.shape != (len(time_s), len(robot.home)) or not np.isfinite(q).all() or len(time_s) < 2:
        raise ValueError(f"{len(time_s)} times and angles of shape {q.shape}")
    T_world_base = replay.cell.T_world_base
    T_world_flange = np.stack([T_world_base @ robot.flange(one) for one in q])
    sent = np.array(attempt["T_world_tool"], dtype=float)
    tip_m = (T_world_flange @ T_flange_tip(tool))[:, :3, 3]
    off_m = np.linalg.norm(tip_m - sent[:3, 3], axis=1)
    grip = int(off_m.argmin())
    if off_m[grip] > AT_GRIP_M:
        raise ValueError(f"the tool stays {1e3 * off_m[grip]:.1f} mm away from its grip")
    width_m = attempt["opening_m"]
    limbs = [replay.T_world_limb(one, width_m, closed=i >= grip) for i, one in enumerate(q)]
    return Motion(
        time_s=time_s,
        T_world_limb=np.array(limbs),
        grip=grip,
        carrier=len(robot.home),
        part=attempt["part"],
        held_until_s=_held_until(attempt, time_s, grip),
    )


def _held_until(
    attempt: Mapping[str, Any], time_s: Float[np.ndarray, " t"], grip: int
) -> float | None:
    """Return the time until which the tool carried the part; None if not carried or unknown."""
    if attempt["part"] is None:
        return None
    if attempt["outcome"] in {str(outcome) for outcome in TAKEN}:
        return float(time_s[-1])
    lost_s = attempt.get("lost_s")  # Folders of older versions lack this key.
    return None if lost_s is None else float(time_s[grip] + lost_s)


def _arm_limbs(robot: Robot) -> list[Mesh]:
    """Return a mesh for each limb of the arm; it is a single point for a limb without a shape."""
    all_limbs = robot.limbs()
    limbs = []
    for number in range(len(robot.home) + 1):
        shapes = [(shape_mesh(shape), T) for place, shape, T in all_limbs if place == number]
        limbs.append(joined(shapes) if shapes else _NOTHING)
    return limbs


_NOTHING = Mesh(vertices_m=np.zeros((3, 3)), faces=np.array([[0, 1, 2]]))


def _tool_limbs(tool: Tool) -> list[Mesh]:
    return [*(shape_mesh(piece.shape) for piece in tool.pieces()), *tool.soft]
