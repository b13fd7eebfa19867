"""Prepare the cell of a robot: arm, tool, rigid bodies, known grips and detector."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ....base.errors import ConfigError
from ....base.frames import inverse, rigid
from ....base.progress import UNWATCHED, ProgressMeter
from ....world.drop import Body, make_bodies
from ....world.drop.rapier import GRAVITY_M_S2
from ....world.parts import Part
from ....world.parts.symmetry import joined, motions, shape_symmetry
from ...grasp import best_first
from ...pose import pose_model
from ..arm.obstacles import standing
from ..arm.robot import Robot, open_robot
from ..arm.ways import Load, Surroundings
from ..tool.tools import T_flange_tip, Tool, grips_on
from ..tool.touch import ContactPart
from .aim import KnownPart
from .robot_cell import PickCell

_PLACES = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The data, apart from the contents of the bin, that picking needs.

    `bare` is the arm without its tool. `alike` are the rigid motions that leave each part's shape
    unchanged, even if they change its paint. `known` maps kinds of part to their grips; it is empty
    if the grips do not come from models. `load` encloses any of the parts.
    """

    cell: PickCell
    bare: Robot
    robot: Robot
    here: Surroundings
    bodies: tuple[Body, ...]
    kinds: tuple[ContactPart, ...]
    alike: tuple[Float[np.ndarray, "s 4 4"], ...]
    known: dict[int, KnownPart]
    detector: Any | None
    load: Load

    @property
    def tool(self) -> Tool:
        return self.cell.config.tool

    @property
    def weight_n(self) -> float:
        """Weight of the heaviest part, in newtons."""
        return max(body.mass_kg for body in self.bodies) * GRAVITY_M_S2

    def tip(self, q: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "4 4"]:
        """Return `T_world_tip` at joint angles [rad], from the arm's forward kinematics."""
        return self.cell.T_world_base @ self.robot.flange(q) @ self.here.T_flange_tip


def make_ready(cell: PickCell, *, progress: ProgressMeter = UNWATCHED) -> Ready:
    """Open the robot and the detector, and search for grips on the parts.

    Raises:
        ConfigError: the robot, the place or the tool does not suit the cell.
        GraycastError: the detector does not exist.
    """
    config, parts = cell.config, cell.cell.scene.parts
    bare = open_robot(config.robot.arm, folder=cell.folder, home=config.robot.home_rad)
    robot = bare.mount(config.tool.pieces())
    size_m = max(float(np.linalg.norm(part.mesh.extent_m)) for part in parts)
    load = Load(below_m=size_m, aside_m=size_m / 2)
    here = _surroundings(cell, robot, load)
    bodies = make_bodies(parts, progress=progress)
    known = {}
    if config.picking.knows == "part":
        for i, (part, body) in enumerate(zip(parts, bodies, strict=True)):
            progress.stage(f"{part.name}: searching for grasps")
            known[i] = _known(config.tool, part, body)
    return Ready(
        cell=cell,
        bare=bare,
        robot=robot,
        here=here,
        bodies=bodies,
        kinds=tuple(ContactPart.of(part, body) for part, body in zip(parts, bodies, strict=True)),
        alike=tuple(motions(joined(part.symmetry, shape_symmetry(part.mesh))) for part in parts),
        known=known,
        detector=_detector(cell),
        load=load,
    )


def _surroundings(cell: PickCell, robot: Robot, load: Load) -> Surroundings:
    """Return the surroundings; raise ConfigError if the arm collides at home or at `place_m`."""
    picking = cell.config.picking
    T_base_world = inverse(cell.T_world_base)
    still = standing(cell.cell.scene, T_base_world)
    hit = robot.touches(robot.home, still)
    if hit is not None:
        raise ConfigError(
            f"robot.home_rad: the arm collides with {hit} at these angles: give other angles, or "
            "move robot.base_m"
        )
    here = Surroundings(
        T_base_world=T_base_world,
        T_flange_tip=T_flange_tip(cell.config.tool),
        standing=still,
        q_place=robot.home,
        approach_m=picking.approach_m,
        straight_m_s=picking.straight_m_s,
        lift_off_m_s=picking.lift_off_m_s,
    )
    place = rigid(np.eye(3), np.array(picking.place_m, dtype=np.float64))
    reached = robot.reach(here.flange(place), robot.home, seed=0)
    if not reached:
        raise ConfigError(
            f"picking.place_m is {picking.place_m}: {robot.name} at {cell.config.robot.base_m} "
            "does not reach it with its tool upright: move one of them"
        )
    loaded = robot.mount((load.piece(here.T_flange_tip),))
    hits = [loaded.touches(q, still) for q in reached]
    if None not in hits:
        raise ConfigError(
            f"picking.place_m is {picking.place_m}: the arm with a part of up to "
            f"{load.below_m:.3f} m below its tip collides with {hits[0]} there: move the place"
        )
    return replace(here, q_place=reached[hits.index(None)])


def _known(tool: Tool, part: Part, body: Body) -> KnownPart:
    """Return a part's model and grips; raise ConfigError if the tool cannot hold the part."""
    grips = best_first(grips_on(tool, part, body, count=_PLACES))
    if not grips:
        raise ConfigError(
            f"tool: it holds part {part.name} ({body.mass_kg * GRAVITY_M_S2:.2f} N) nowhere: give "
            "the tool another size or more force"
        )
    return KnownPart(model=pose_model(part.mesh, part.symmetry), grips=tuple(grips))


def _detector(cell: PickCell) -> Any | None:
    """Open the cell's detector, if any; raise ConfigError if it cannot tell the parts apart."""
    if cell.detector is None:
        return None
    from ....learn.detect import load_detector  # The import of torch takes seconds.

    detector = load_detector(cell.detector)
    names = [part.name for part in cell.cell.scene.parts]
    distinguishes = set(detector.about.names) <= set(names)
    if cell.config.picking.knows == "part" and len(names) > 1 and not distinguishes:
        raise ConfigError(
            f"picking.detector: it knows {', '.join(detector.about.names)}, and the cell has "
            f"{', '.join(names)}: train the detector on parts with these names"
        )
    return detector
