"""A robot: forward and inverse kinematics, and collision checks.

Pinocchio computes kinematics, and Coal computes collisions. A robot is a built-in arm or comes
from the user's URDF file. Its base frame is the first link of the URDF, with z up.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from ....base.errors import ConfigError
from ....base.frames import rigid
from ....base.public_value import public_value
from .arms import ARMS, URDF

Joints = Float[np.ndarray, "q"]
_STEPS, _STARTS = 60, 12
_ALIKE_RAD = 0.05
_DAMPING = 1e-6
EXACT_M, EXACT_RAD = 1e-5, 1e-4
# The makers state no accelerations. With this value, a joint has full speed after half a second.
ACCELERATION_RAD_S2 = 6.0


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstacle:
    """A Coal shape in the robot's base frame, with which the robot must not collide.

    If `carries` is true, the robot's base may touch it.
    """

    name: str
    shape: Any
    T_base_shape: Float[np.ndarray, "4 4"]
    carries: bool = False
    placed: Any = field(init=False, repr=False)  # the pose as a Coal object, for many queries

    def __post_init__(self) -> None:
        object.__setattr__(self, "placed", _placed(self.T_base_shape))


@final
@public_value
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounted:
    """A piece of a tool: a convex Coal shape in the flange's frame."""

    name: str
    shape: Any
    T_flange_shape: Float[np.ndarray, "4 4"]

    @staticmethod
    def at(name: str, shape: Any, place_m: tuple[float, float, float]) -> "Mounted":
        """Return a piece at a position, without rotation."""
        return Mounted(name=name, shape=shape, T_flange_shape=rigid(np.eye(3), np.array(place_m)))


@final
class Robot:
    """An opened robot; calls do not change its state."""

    def __init__(self, name: str, model: Any, geometry: Any, home: Joints) -> None:
        self.name = name
        self._model, self._geometry = model, geometry
        self._data = model.createData()
        self._flange = model.getFrameId("flange")
        self.home = home
        self._own_pairs()
        self._placed = (
            geometry.createData()
        )  # The data must be created after the pairs, because they hold the results of the pairs.

    def mount(self, pieces: Sequence[Mounted]) -> "Robot":
        """Return the same arm with a tool at its flange."""
        import pinocchio as pin

        geometry = self._geometry.copy()
        flange = self._model.frames[self._flange]
        for piece in pieces:
            placed = flange.placement * pin.SE3(piece.T_flange_shape)
            geometry.addGeometryObject(
                pin.GeometryObject(piece.name, flange.parentJoint, placed, piece.shape)
            )
        return Robot(self.name, self._model, geometry, self.home)

    @property
    def low(self) -> Joints:
        return np.array(self._model.lowerPositionLimit)

    @property
    def high(self) -> Joints:
        return np.array(self._model.upperPositionLimit)

    @property
    def speed(self) -> Joints:
        """Highest speed of each joint [rad/s]."""
        return np.array(self._model.velocityLimit)

    def flange(self, q: Joints) -> Float[np.ndarray, "4 4"]:
        """Return `T_base_flange` at joint angles [rad]."""
        import pinocchio as pin

        pin.framesForwardKinematics(self._model, self._data, q)
        return self._data.oMf[self._flange].homogeneous.copy()

    def limbs(self) -> tuple[tuple[int, Any, Float[np.ndarray, "4 4"]], ...]:
        """Return the shapes of the limbs: index in `places`, Coal shape, and `T_joint_shape`."""
        return tuple(
            (int(thing.parentJoint), thing.geometry, thing.placement.homogeneous.copy())
            for thing in self._geometry.geometryObjects
        )

    def places(self, q: Joints) -> Float[np.ndarray, "joints 4 4"]:
        """Return `T_base_joint` for the base and for every joint, at joint angles [rad]."""
        import pinocchio as pin

        pin.forwardKinematics(self._model, self._data, q)
        return np.stack([place.homogeneous for place in self._data.oMi])

    def reach(
        self, T_base_flange: Float[np.ndarray, "4 4"], near: Joints, *, seed: int
    ) -> list[Joints]:
        """Return sets of joint angles that bring the flange to a pose, the nearest to `near` first.

        Newton's method starts at `near` and at random angles. The list is empty if no start
        converges within the joints' limits; then the pose is assumed to be out of reach.
        """
        rng = np.random.default_rng(seed)
        starts = [near, *rng.uniform(self.low, self.high, (_STARTS - 1, len(near)))]
        solutions: list[Joints] = []
        for start in starts:
            q = self._solve(T_base_flange, start, near)
            if q is not None and all(np.abs(q - other).max() > _ALIKE_RAD for other in solutions):
                solutions.append(q)
        return sorted(solutions, key=lambda q: float(np.abs(q - near).max()))

    def follow(self, T_base_flange: Float[np.ndarray, "4 4"], near: Joints) -> Joints | None:
        """Return joint angles for a pose close to the pose at the joint angles `near`, or None."""
        return self._solve(T_base_flange, near, near)

    def _solve(
        self, T_base_flange: Float[np.ndarray, "4 4"], start: Joints, near: Joints
    ) -> Joints | None:
        import pinocchio as pin

        target = pin.SE3(T_base_flange)
        q = start.copy()
        for _ in range(_STEPS):
            pin.framesForwardKinematics(self._model, self._data, q)
            off = self._data.oMf[self._flange].actInv(target)
            error = pin.log6(off).vector
            if np.abs(error[:3]).max() < EXACT_M and np.abs(error[3:]).max() < EXACT_RAD:
                q = _turned(q, near, self.low, self.high)
                return q if ((q >= self.low) & (q <= self.high)).all() else None
            J = pin.computeFrameJacobian(
                self._model, self._data, q, self._flange, pin.ReferenceFrame.LOCAL
            )
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
            q = q + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12))
        return None

    def touches(self, q: Joints, obstacles: Sequence[Obstacle]) -> str | None:
        """Return the name of the first obstacle that the robot hits, or "itself"; None if free."""
        import pinocchio as pin

        if pin.computeCollisions(self._model, self._data, self._geometry, self._placed, q, True):
            return "itself"
        places = zip(self._geometry.geometryObjects, self._placed.oMg, strict=True)
        pieces = ((it.geometry, at.homogeneous, it.parentJoint == 0) for it, at in places)
        return _first_met(pieces, obstacles)

    def _own_pairs(self) -> None:
        """Select the pairs of links to check, without neighbours and pairs that touch at home."""
        import pinocchio as pin

        geometry = self._geometry
        geometry.removeAllCollisionPairs()
        things = geometry.geometryObjects
        for i in range(len(things)):
            for j in range(i):
                if abs(things[i].parentJoint - things[j].parentJoint) > 1:
                    geometry.addCollisionPair(pin.CollisionPair(j, i))
        data = geometry.createData()
        pin.computeCollisions(self._model, self._data, geometry, data, self.home, False)
        touching = [
            (pair.first, pair.second)
            for pair, result in zip(geometry.collisionPairs, data.collisionResults, strict=True)
            if result.isCollision()
        ]
        for one, other in touching:
            geometry.removeCollisionPair(pin.CollisionPair(one, other))


def tool_touches(
    pieces: Sequence[Mounted],
    T_base_flange: Float[np.ndarray, "4 4"],
    obstacles: Sequence[Obstacle],
) -> str | None:
    """Return the name of an obstacle with which the tool alone collides, or None."""
    placed = ((piece.shape, T_base_flange @ piece.T_flange_shape, False) for piece in pieces)
    return _first_met(placed, obstacles)


def _first_met(
    pieces: Iterable[tuple[Any, Float[np.ndarray, "4 4"], bool]], obstacles: Sequence[Obstacle]
) -> str | None:
    """Return the name of the first obstacle that a piece (shape, pose, is base) hits, or None."""
    import coal

    request, result = coal.CollisionRequest(), coal.CollisionResult()
    for shape, T_base_shape, is_base in pieces:
        here = _placed(T_base_shape)
        for obstacle in obstacles:
            if is_base and obstacle.carries:
                continue
            result.clear()
            if coal.collide(shape, here, obstacle.shape, obstacle.placed, request, result):
                return obstacle.name
    return None


def _placed(T: Float[np.ndarray, "4 4"]) -> Any:
    import coal

    return coal.Transform3s(T[:3, :3], T[:3, 3])


def _turned(q: Joints, near: Joints, low: Joints, high: Joints) -> Joints:
    """Return the angles plus whole turns: close to `near`, and within limits if possible."""
    turn = 2 * np.pi
    q = q + turn * np.round((near - q) / turn)
    return q + turn * ((q < low).astype(float) - (q > high))


def open_robot(text: str, *, folder: Path, home: Sequence[float | int] | None = None) -> Robot:
    """Return a built-in arm by its name, or read a robot from a URDF file in a folder.

    Raises:
        ConfigError: there is no such robot, the file cannot be read, a joint has no limits or no
            speed limit, there is no link `flange`, or `home` does not fit the joints.
    """
    import pinocchio as pin

    path = URDF / f"{text}.urdf" if text in ARMS else folder / text
    home = ARMS.get(text) if home is None else home
    if not path.is_file():
        raise ConfigError(
            f"robot: the robot {text!r} is not known: choose one of {', '.join(ARMS)}, or "
            f"name a URDF file in {folder}"
        )
    _check_limits(path)
    try:
        model = pin.buildModelFromUrdf(str(path))
        geometry = pin.buildGeomFromUrdf(
            model, str(path), pin.GeometryType.COLLISION, package_dirs=[str(path.parent)]
        )
    except (ValueError, RuntimeError) as error:
        raise ConfigError(f"robot {path}: {str(error).strip()}") from error
    _check_joints(text, model)
    if not model.existFrame("flange"):
        raise ConfigError(f"robot {text}: has no link called flange, on which the tool is mounted")
    rest = np.zeros(model.nq) if home is None else np.array(home, float)
    if rest.shape != (model.nq,):
        raise ConfigError(
            f"robot {text}: home has {rest.size} angles, and the robot has {model.nq} joints"
        )
    low, high = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    beyond = np.flatnonzero((rest < low) | (rest > high))
    if len(beyond):
        i = int(beyond[0])
        raise ConfigError(
            f"robot {text}: home of joint {i + 1} is {rest[i]:.3f} rad; its limits are "
            f"{low[i]:.3f} to {high[i]:.3f}"
        )
    return Robot(text, model, geometry, rest)


def _check_limits(path: Path) -> None:
    """Check that the joints' limits have the attributes that Pinocchio's errors do not name.

    Raises:
        ConfigError: a revolute or prismatic joint has no limit, or its limit lacks speed or effort.
    """
    try:
        joints = ElementTree.parse(path).getroot().findall("joint")
    except ElementTree.ParseError as error:
        raise ConfigError(f"robot {path}: it is no XML: {error}") from error
    for joint in joints:
        kind, limit = joint.get("type"), joint.find("limit")
        if kind not in ("revolute", "prismatic"):
            continue
        attributes = {} if limit is None else limit.attrib
        missing = [name for name in ("velocity", "effort") if name not in attributes]
        if limit is None:
            missing = ["lower", "upper", *missing]
        if missing:
            units = "rad and rad/s" if kind == "revolute" else "m and m/s"
            raise ConfigError(
                f"robot {path}: the limit of joint {joint.get('name')} has no "
                f"{', no '.join(missing)}: write it as an attribute of <limit>, in {units}"
            )


def _check_joints(text: str, model: Any) -> None:
    """Check that there are joints, and that each has one variable, limits and a speed.

    Raises:
        ConfigError: there is no joint, or a joint lacks one of these.
    """
    if not model.nq:
        raise ConfigError(
            f"robot {text}: no joint can move: give at least one the type revolute or prismatic"
        )
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        if joint.nq != 1:
            raise ConfigError(
                f"robot {text}: {name} is a continuous joint, which is not supported: give it the "
                "type revolute and limits"
            )
        if not model.velocityLimit[joint.idx_v] > 0:
            raise ConfigError(
                f"robot {text}: {name} has no speed limit: give its limit a velocity greater than 0"
            )
