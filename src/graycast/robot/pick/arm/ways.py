"""The arm's paths for one pick: to the approach, down, up, and away to the place of release."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ....base.frames import axis_rotation, inverse, rigid
from ...grasp import CARRIED_M_S2
from ..outcome import Outcome
from .motion import Trajectory, drive, plan, straight
from .robot import Joints, Mounted, Obstacle, Robot

TURNS = 4  # number of rotations about its axis that are tried for a round cup
OFF_M = 0.01  # The tool carries the full load after this distance, because bellows stretch less.
Lines = dict[str, Float[np.ndarray, "k joints"]]  # names of straight motions -> joint angles
ELBOWS = 3  # largest number of the arm's configurations that are tried for a grip


@dataclass(frozen=True, slots=True, kw_only=True)
class Ways:
    """The five parts of a path: `to` the approach, `down` to the grip, `off`, `up` and `away`.

    `off` is short and slow, because a fast tool would jerk the part when it takes over the weight.
    A leaning tool becomes upright at the end of `up`, or during `up` if the arm cannot reach that
    height with a leaning tool, because a heavy part would break the seal of a leaning cup.
    """

    to: Trajectory
    down: Trajectory
    off: Trajectory
    up: Trajectory
    away: Trajectory

    @property
    def loaded(self) -> tuple[Trajectory, ...]:
        return (self.off, self.up, self.away)

    @property
    def all(self) -> tuple[Trajectory, ...]:
        return (self.to, self.down, *self.loaded)

    @property
    def seconds(self) -> float:
        return sum(way.seconds for way in self.all)


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """The extent of a held part from the tip: below it along the tool's axis, and sideways."""

    below_m: float
    aside_m: float

    def piece(self, T_flange_tip: Float[np.ndarray, "4 4"]) -> Mounted:
        """Return a cylinder that encloses the held part."""
        import coal

        below = T_flange_tip @ rigid(np.eye(3), np.array([0.0, 0.0, -self.below_m / 2]))
        shape = coal.Cylinder(self.aside_m, self.below_m)
        return Mounted(name="the part", shape=shape, T_flange_shape=below)


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocked:
    """The reason why no path was found, and the positions [m] of the grips that were tried."""

    outcome: Outcome
    detail: str = ""
    places_m: tuple[Float[np.ndarray, "3"], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """The fixed obstacles and settings for planning; `T_base_world` maps to the robot's base."""

    T_base_world: Float[np.ndarray, "4 4"]
    T_flange_tip: Float[np.ndarray, "4 4"]
    standing: tuple[Obstacle, ...]
    q_place: Joints
    approach_m: float
    straight_m_s: float
    lift_off_m_s: float

    def flange(self, T_world_tip: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Return the flange pose `T_base_flange` that brings the tip to a pose in the world."""
        return self.T_base_world @ T_world_tip @ inverse(self.T_flange_tip)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaySearch:
    """A search for paths to grips and away from them with the part.

    Attributes:
        robot: the robot with its tool.
        obstacles: the fixed obstacles and the measured heap, which also limit the straight paths
            down to the grip and up from it.
        up_m: height by which the tip is raised before the part is carried away.
        load: extent of the carried part.
        seed: seed for the inverse kinematics and the planner.
    """

    robot: Robot
    here: Surroundings
    obstacles: tuple[Obstacle, ...]
    up_m: float
    load: Load
    seed: int

    def ways(
        self, q: Joints, T_world_tip: Float[np.ndarray, "4 4"], *, round_tool: bool
    ) -> Ways | Blocked:
        """Return paths from joint angles to a grip and away with the part, or why there are none.

        A round tool may have several rotations about its axis; any other tool may have two.
        """
        turns = TURNS if round_tool else 2
        result: Ways | Blocked = Blocked(outcome=Outcome.UNREACHABLE)
        for turn in range(turns):
            turned = rigid(axis_rotation("z", 2 * np.pi * turn / turns), np.zeros(3))
            result = self._without_turn(q, T_world_tip @ turned)
            if isinstance(result, Ways):
                break
        return result

    def _without_turn(self, q: Joints, tip: Float[np.ndarray, "4 4"]) -> Ways | Blocked:
        here, robot = self.here, self.robot
        before = tip.copy()
        before[:3, 3] += here.approach_m * tip[:3, 2]
        reached = robot.reach(here.flange(before), here.q_place, seed=self.seed)
        if not reached:
            return Blocked(
                outcome=Outcome.UNREACHABLE,
                detail="no joint angles reach the start of the approach",
            )
        hits = [robot.touches(each, self.obstacles) for each in reached]
        free = [each for each, hit in zip(reached, hits, strict=True) if hit is None]
        if not free:
            return Blocked(
                outcome=Outcome.COLLISION_SEEN, detail=f"the arm would collide with {hits[0]}"
            )
        result: Ways | Blocked = Blocked(outcome=Outcome.UNREACHABLE)
        for q_before in free[:ELBOWS]:
            result = self._by(q, q_before, tip)
            if isinstance(result, Ways):
                break
        return result

    def _by(self, q: Joints, q_before: Joints, tip: Float[np.ndarray, "4 4"]) -> Ways | Blocked:
        """Return paths with given joint angles at the start of the approach, or why none exist."""
        here, robot = self.here, self.robot
        off, raised = tip.copy(), tip.copy()
        off[2, 3] += OFF_M
        raised[2, 3] += max(self.up_m, OFF_M)
        upright = _upright(raised)
        closing = {"down": tip, "off": off}
        near = self._straights(q_before, closing)
        if len(near) < len(closing):
            return self._why(q_before, near, closing)
        q_off = near["off"][-1]
        rising = {"up": raised, "upright": upright}
        rise = self._straights(q_off, rising)
        if len(rise) < len(rising):
            turning = self._straights(q_off, {"upright": upright})
            if not turning:
                return self._why(q_off, rise, rising)
            rise = turning
        first, *rest = rise.values()
        up = np.concatenate([first, *(line[1:] for line in rest)])
        last = up[-1]
        to = plan(robot, q, q_before, self.obstacles, seed=self.seed)
        if to is None:
            return Blocked(outcome=Outcome.UNREACHABLE, detail="no collision-free path to the grip")
        loaded = robot.mount((self.load.piece(here.T_flange_tip),))
        away = plan(loaded, last, here.q_place, self.obstacles, seed=self.seed)
        if away is None:
            return Blocked(
                outcome=Outcome.UNREACHABLE, detail="no collision-free path with the part"
            )
        down_s, up_s = here.approach_m / here.straight_m_s, self.up_m / here.straight_m_s
        return Ways(
            to=drive(robot, to),
            down=_slowly(drive(robot, near["down"]), down_s),
            off=_slowly(drive(robot, near["off"]), OFF_M / here.lift_off_m_s),
            up=_gently(robot, here, _slowly(drive(robot, up), up_s), self.load),
            away=_gently(robot, here, drive(robot, away), self.load),
        )

    def _straights(self, q: Joints, ends: Mapping[str, Float[np.ndarray, "4 4"]]) -> Lines:
        """Return consecutive straight motions of the tip, up to the first that is impossible."""
        lines: Lines = {}
        for name, end in ends.items():
            line = straight(self.robot, q, self.here.flange(end), self.obstacles)
            if line is None:
                break
            lines[name], q = line, line[-1]
        return lines

    def _why(
        self, q: Joints, lines: Lines, ends: Mapping[str, Float[np.ndarray, "4 4"]]
    ) -> Blocked:
        """Return why the next straight motion fails: a collision, or the arm's limits."""
        name, end = list(ends.items())[len(lines)]
        q = [q, *(line[-1] for line in lines.values())][-1]
        T_base_flange = self.here.flange(end)
        if straight(self.robot, q, T_base_flange, ()) is not None:
            for obstacle in self.obstacles:
                if straight(self.robot, q, T_base_flange, (obstacle,)) is None:
                    detail = f"the path {name} collides with {obstacle.name}"
                    return Blocked(outcome=Outcome.COLLISION_SEEN, detail=detail)
        return Blocked(outcome=Outcome.UNREACHABLE, detail=f"no straight path {name}")


def _upright(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose after the smallest rotation that makes the tool's axis vertical."""
    x = np.cross(T[:3, 1], [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross([0.0, 0.0, 1.0], x), [0.0, 0.0, 1.0]], axis=1), T[:3, 3])


def _slowly(way: Trajectory, least_s: float) -> Trajectory:
    """Return the same path with a duration of at least the given number of seconds."""
    stretch = max(1.0, least_s / max(way.seconds, 1e-9))
    return Trajectory(time_s=way.time_s * stretch, q=way.q.copy())


def _gently(robot: Robot, here: Surroundings, way: Trajectory, load: Load) -> Trajectory:
    """Return the same path, slowed down so that no acceleration exceeds `CARRIED_M_S2`.

    The limit applies at the tip and at the lowest point of the part.
    """
    if len(way.q) < 3:
        return way
    step_s = float(way.time_s[1] - way.time_s[0])
    tip = [robot.flange(q) @ here.T_flange_tip for q in way.q]
    fastest = 0.0
    for reach_m in (0.0, -load.below_m):
        place = np.stack([T[:3, 3] + reach_m * T[:3, 2] for T in tip])
        second = np.diff(place, n=2, axis=0) / step_s**2
        fastest = max(fastest, float(np.linalg.norm(second, axis=1).max()))
    return _slowly(way, way.seconds * np.sqrt(fastest / CARRIED_M_S2))
