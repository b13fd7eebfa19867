"""Simulate a tool that lifts a part out of the heap and holds or loses it.

The tool follows a given path, which forces on the tool do not change. The part hangs on the tool by
springs and dampers, like a suction cup on its bellows. Their force is known at every step, and the
tool's own law says whether the grip holds. The grip therefore carries its full load: the weight,
other parts on top of the part, friction at walls, and the accelerations of the path.

Leaves out: collisions of the tool's body, which the planner must prevent.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...base.public_value import public_value
from ..scene import Bin
from .body import Body, Kinds, Poses
from .rapier import RapierPart, Terms, open_heap

Vector3 = Float[np.ndarray, "3"]
_Motion = tuple[Float[np.ndarray, "4 4"], Vector3, Vector3]  # world pose, velocity and turning rate
# Springs must keep a part on its path, but the simulation must stay stable: stiffness and damping
# are at most these shares of the largest values that the time step allows.
MOST_STIFFNESS, MOST_DAMPING = 0.1, 0.5
# A robot moves faster than parts in a drop, and stiff springs need a shorter time step.
SPEED_M_S = 10.0
STEP_S = 0.002


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    """A tool's grip on a part: the tool's pose on the part, and the grip's strength and stiffness.

    `T_part_tool` is the tool's pose on the part. `factor` returns the safety factor for the load of
    the part on the tool: a force [N] and a moment about the tool's origin [Nm], both in the tool's
    frame. `stiffness_n_m` applies along each axis, `turning_nm` about each axis [Nm/rad].
    """

    T_part_tool: Float[np.ndarray, "4 4"]
    factor: Callable[[Vector3, Vector3], float]
    stiffness_n_m: float = 2000.0
    turning_nm: float = 2.0

    def __post_init__(self) -> None:
        for name in ("stiffness_n_m", "turning_nm"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be above 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lift:
    """Outcome of a lift.

    `T_world_part` are the parts' poses at the end. `lost_s` is the time at which the tool lost the
    part, or None. `least_factor` is the smallest safety factor during the lift, with `force_n` and
    `moment_nm` at that moment in the tool's frame.
    """

    T_world_part: Float[np.ndarray, "n 4 4"]
    lost_s: float | None
    least_factor: float
    force_n: Vector3
    moment_nm: Vector3


def lift(
    box: Bin,
    bodies: tuple[Body, ...],
    T_world_part: Poses,
    part_index: Kinds,
    number: int,
    hold: Hold,
    T_world_tool: Float[np.ndarray, "t 4 4"],
) -> Lift:
    """Move a tool that holds a part along a path; all parts are at rest at the start.

    Args:
        number: index of the part that the tool holds.
        T_world_tool: the path, a pose for each step of `STEP_S`; at the first pose the tool is on
            the part.
    """
    kinds = [RapierPart.of(body) for body in bodies]
    heap = open_heap(
        Terms(speed_m_s=SPEED_M_S, step_s=STEP_S), box, kinds, T_world_part, part_index
    )
    spring = _Spring.of(hold, bodies[part_index[number]])
    least, worst, lost_s = math.inf, (np.zeros(3), np.zeros(3)), None
    targets = zip(T_world_tool, *_motion(T_world_tool), strict=True)
    for step, target in enumerate(targets):
        if lost_s is None:
            force_n, moment_nm, load = spring.pull(heap.motion(number), target)
            factor = hold.factor(*load)
            if factor < least:
                least, worst = factor, load
            if factor < 1:
                lost_s = step * STEP_S
                force_n, moment_nm = np.zeros(3), np.zeros(3)
            heap.push(number, force_n, moment_nm)
        heap.run(STEP_S)
    return Lift(
        T_world_part=heap.poses(),
        lost_s=lost_s,
        least_factor=least,
        force_n=worst[0],
        moment_nm=worst[1],
    )


def _motion(
    T_world_tool: Float[np.ndarray, "t 4 4"],
) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t 3"]]:
    """Return the velocity [m/s] and the angular velocity [rad/s] of the tool at each step.

    The first velocity is 0; each later velocity follows from the pose and the previous pose.
    """
    before = T_world_tool[np.maximum(np.arange(len(T_world_tool)) - 1, 0)]
    velocity = (T_world_tool[:, :3, 3] - before[:, :3, 3]) / STEP_S
    step = T_world_tool[:, :3, :3] @ before[:, :3, :3].swapaxes(1, 2)
    return velocity, Rotation.from_matrix(step).as_rotvec() / STEP_S


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spring:
    """Springs and dampers between a tool and a part."""

    T_part_tool: Float[np.ndarray, "4 4"]
    k: float
    c: float
    k_turn: float
    c_turn: float

    @staticmethod
    def of(hold: Hold, body: Body) -> "_Spring":
        """Return a spring, critically damped if possible, as stiff as the time step allows at most.

        A force off the centre of mass also turns the part, so the effective mass there is less than
        the part's mass.
        """
        least_moment = float(np.linalg.eigvalsh(body.inertia_kg_m2).min())
        cross = np.cross(np.eye(3), hold.T_part_tool[:3, 3] - body.center_m)
        mobility = cross @ np.linalg.inv(body.inertia_kg_m2) @ cross.T + np.eye(3) / body.mass_kg
        moved_kg = 1 / float(np.linalg.eigvalsh(mobility).max())
        k = min(hold.stiffness_n_m, MOST_STIFFNESS * moved_kg / STEP_S**2)
        k_turn = min(hold.turning_nm, MOST_STIFFNESS * least_moment / STEP_S**2)
        return _Spring(
            T_part_tool=hold.T_part_tool,
            k=k,
            c=min(2 * math.sqrt(k * body.mass_kg), MOST_DAMPING * moved_kg / STEP_S),
            k_turn=k_turn,
            c_turn=2 * math.sqrt(k_turn * least_moment),
        )

    def pull(
        self, part: _Motion, target: _Motion
    ) -> tuple[Vector3, Vector3, tuple[Vector3, Vector3]]:
        """Return the force on the part's origin, the moment about it, and the load on the tool."""
        T, velocity, turning = part
        goal, goal_velocity, goal_turning = target
        tool = T @ self.T_part_tool
        arm = tool[:3, 3] - T[:3, 3]
        force = self.k * (goal[:3, 3] - tool[:3, 3])
        force += self.c * (goal_velocity - velocity - _cross(turning, arm))
        moment = self.k_turn * _turn(goal[:3, :3] @ tool[:3, :3].T)
        moment += self.c_turn * (goal_turning - turning)
        R = tool[:3, :3].T
        return force, moment + _cross(arm, force), (-(R @ force), -(R @ moment))


def _cross(a: Vector3, b: Vector3) -> Vector3:
    """Return the cross product of two vectors, in a tenth of the time of `numpy.cross`."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _turn(R: Float[np.ndarray, "3 3"]) -> Vector3:
    """Return the rotation vector of a rotation."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    twice = np.array([zy - yz, xz - zx, yx - xy])  # the axis times twice the sine of the angle
    sine, cosine = math.hypot(zy - yz, xz - zx, yx - xy) / 2, (xx + yy + zz - 1) / 2
    if sine < 1e-6 and cosine < 0:  # The sine is too small to give the axis of a half turn.
        return Rotation.from_matrix(R).as_rotvec()
    return twice * (math.atan2(sine, cosine) / (2 * sine) if sine > 1e-9 else 0.5)
