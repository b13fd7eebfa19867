"""Plan collision-free paths with OMPL, and time them with TOPP-RA as fast as the joints allow.

If a straight line in joint angles collides, RRT-Connect plans a path, which is then shortened.
The planner stops after a number of calls instead of after a time, so that a seed gives the same
path on every machine.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial.transform import Rotation

from ....base.frames import rigid
from .robot import ACCELERATION_RAD_S2, Joints, Obstacle, Robot

# largest step between poses that are checked for collisions; 30 mm at a radius of 0.8 m
CHECKED_RAD = 0.04
STEP_M, STEP_RAD = 0.01, 0.1  # largest distance and rotation between poses on a straight line
JUMP_RAD = 0.3  # A joint that turns by more between two poses of a straight line has jumped.
MOST_CALLS = 20_000  # number of calls of its end condition after which the planner gives up
SHORTCUTS = 60
RISE_S = 0.12
SPACED_RAD = 0.1

Free = Callable[[Joints], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """A motion: joint angles at evenly spaced times, beginning at time 0."""

    time_s: Float[np.ndarray, " t"]
    q: Float[np.ndarray, "t joints"]

    def __post_init__(self) -> None:
        self.time_s.flags.writeable = False
        self.q.flags.writeable = False

    @property
    def seconds(self) -> float:
        return float(self.time_s[-1])

    def at(self, time_s: float) -> Joints:
        """Return the joint angles at a time, with linear interpolation."""
        return np.array([np.interp(time_s, self.time_s, joint) for joint in self.q.T])


def plan(
    robot: Robot, start: Joints, goal: Joints, obstacles: Sequence[Obstacle], *, seed: int
) -> Float[np.ndarray, "k joints"] | None:
    """Return the corners of a collision-free path between two sets of joint angles.

    The result is None if no path was found, or if the start or the goal collides.
    """

    def free(q: Joints) -> bool:
        return robot.touches(q, obstacles) is None

    if not free(start) or not free(goal):
        return None
    if _line_is_free(start, goal, free):
        return np.stack([start, goal])
    corners = _connected(robot, start, goal, free, seed)
    if corners is None:
        return None
    rng = np.random.default_rng(seed)
    for _ in range(SHORTCUTS):
        if len(corners) < 3:
            break
        i, j = sorted(rng.choice(len(corners), 2, replace=False).tolist())
        if j - i > 1 and _line_is_free(corners[i], corners[j], free):
            corners = np.delete(corners, range(i + 1, j), axis=0)
    return corners


def _line_is_free(start: Joints, goal: Joints, free: Free) -> bool:
    count = max(int(np.ceil(np.abs(goal - start).max() / CHECKED_RAD)), 1)
    return all(free(start + (goal - start) * i / count) for i in range(1, count))


def _connected(
    robot: Robot, start: Joints, goal: Joints, free: Free, seed: int
) -> Float[np.ndarray, "k joints"] | None:
    from ompl import base, geometric
    from ompl.util import RNG, noOutputHandler

    noOutputHandler()
    RNG.setSeed(seed + 1)  # OMPL would replace the seed 0 by the time.
    space = base.RealVectorStateSpace(len(start))
    bounds = base.RealVectorBounds(len(start))
    for i, (low, high) in enumerate(zip(robot.low, robot.high, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    # OMPL expects the step between checks as a share of the space's maximum extent.
    setup.getSpaceInformation().setStateValidityCheckingResolution(
        CHECKED_RAD / space.getMaximumExtent()
    )
    setup.setStateValidityChecker(lambda state: free(_angles(state, len(start))))
    setup.setStartAndGoalStates(_state(space, start), _state(space, goal))
    setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
    calls = 0

    def patience_is_over() -> bool:
        nonlocal calls
        calls += 1
        return calls > MOST_CALLS

    setup.solve(base.PlannerTerminationCondition(patience_is_over))
    if not setup.haveExactSolutionPath():
        return None
    return np.stack([_angles(state, len(start)) for state in setup.getSolutionPath().getStates()])


def _angles(state: Any, count: int) -> Joints:
    """Return the joint angles of an OMPL state."""
    return np.array([state[i] for i in range(count)])


def _state(space: Any, q: Joints) -> Any:
    state = space.allocState()
    for i, angle in enumerate(q):
        state[i] = float(angle)
    return state


def drive(
    robot: Robot, corners: Float[np.ndarray, "k joints"], *, step_s: float = 0.004
) -> Trajectory:
    """Return the fastest motion along a path that the joints' speeds and accelerations allow.

    A spline through points `SPACED_RAD` apart follows the path and rounds its corners by less than
    this distance. The motion starts and ends at rest. A moving average over `RISE_S` smooths the
    steps in acceleration, as robot controllers do. It does not increase any joint's speed.
    """
    import toppra
    import toppra.algorithm
    import toppra.constraint

    toppra.setup_logging("ERROR")
    points = _spaced(corners)
    if len(points) < 2:
        return Trajectory(time_s=np.zeros(1), q=corners[:1].copy())
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(points, axis=0)).max(axis=1))])
    path = toppra.SplineInterpolator(length, points)
    speed = np.stack([-robot.speed, robot.speed], axis=1)
    most = np.full_like(robot.speed, ACCELERATION_RAD_S2)
    limits = [
        toppra.constraint.JointVelocityConstraint(speed),
        toppra.constraint.JointAccelerationConstraint(np.stack([-most, most], axis=1)),
    ]
    solver = toppra.algorithm.TOPPRA(limits, path, parametrizer="ParametrizeConstAccel")
    driven = solver.compute_trajectory(0, 0)
    window = round(RISE_S / step_s)
    time_s = step_s * np.arange(int(np.ceil(driven.duration / step_s)) + 1)
    q = np.asarray(driven(np.minimum(time_s, driven.duration)))
    wide = np.concatenate([np.repeat(q[:1], window, axis=0), q, np.repeat(q[-1:], window, axis=0)])
    mean = sliding_window_view(wide, window + 1, axis=0).mean(axis=-1)
    return Trajectory(time_s=step_s * np.arange(len(mean)), q=mean)


def _spaced(corners: Float[np.ndarray, "k joints"]) -> Float[np.ndarray, "n joints"]:
    points = [corners[0]]
    for start, end in pairwise(corners):
        count = int(np.ceil(np.abs(end - start).max() / SPACED_RAD))
        points += [start + (end - start) * i / count for i in range(1, count + 1)]
    return np.stack(points)


def straight(
    robot: Robot,
    start: Joints,
    T_base_flange: Float[np.ndarray, "4 4"],
    obstacles: Sequence[Obstacle],
) -> Float[np.ndarray, "k joints"] | None:
    """Return the joint angles of a straight motion of the flange with uniform rotation.

    The result is None if a pose on the line is out of reach, collides, or makes a joint jump.
    """
    here = robot.flange(start)
    away_m = T_base_flange[:3, 3] - here[:3, 3]
    turn_rad = Rotation.from_matrix(T_base_flange[:3, :3] @ here[:3, :3].T).as_rotvec()
    steps = max(np.linalg.norm(away_m) / STEP_M, np.linalg.norm(turn_rad) / STEP_RAD)
    count = max(int(np.ceil(steps)), 1)
    corners = [start]
    for i in range(1, count + 1):
        turned = Rotation.from_rotvec(turn_rad * i / count).as_matrix() @ here[:3, :3]
        q = robot.follow(rigid(turned, here[:3, 3] + away_m * i / count), corners[-1])
        if q is None or np.abs(q - corners[-1]).max() > JUMP_RAD:
            return None
        if robot.touches(q, obstacles) is not None:
            return None
        corners.append(q)
    return np.stack(corners)
