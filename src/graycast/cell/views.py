"""Poses (`T_world_cam`) from which a cell's scanners take their images, listed or random."""

import itertools
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator
from scipy.spatial.transform import Rotation, Slerp

from ..base.errors import ConfigError
from ..base.frames import axis_rotation, inverse, is_rigid, rigid, transform_points
from ..base.settings import Level, Positive, PositiveSpan, Settings, SpanOf, Vector
from ..camera.rig_file import ScannerSections
from ..rig.former_names import RigName
from ..rig.optics import Optics, rays
from ..rig.pair import Rig, place, standoff_m
from ..world.scene import Bin

Pose = Float[np.ndarray, "4 4"]
MOST_VIEWS = 1000
FARTHEST_SIGMAS = 3.0  # A jitter beyond this many sigmas is drawn again.
_BEYOND = 0.05  # [rad] margin beyond a picture's edges, which distortion may bend outwards
_TURN = 13  # number of azimuths at which the depth of a dome is computed

Tilt = SpanOf[Annotated[float, Field(ge=0, le=80)]]
Angle = SpanOf[Annotated[float, Field(ge=-360, le=360)]]
Count = Annotated[int, Field(ge=1, le=MOST_VIEWS)]


class ViewSection(Settings):
    """The pose of the rig. At azimuth 0, its baseline is parallel to the world's x axis."""

    distance_m: Positive | None = Field(
        default=None,
        description="The distance from the middle of the baseline to the target in metres. "
        "Without this key, the lines of sight of camera and projector meet at the "
        "target.",
    )
    tilt_deg: float = Field(
        default=0.0,
        ge=0,
        le=80,
        description="The angle between the viewing axis and the vertical, in degrees.",
    )
    azimuth_deg: float = Field(
        default=0.0, description="The rotation of the rig about the vertical, in degrees."
    )
    target_m: Vector | None = Field(
        default=None,
        description="The point in the world that the rig looks at, in metres. Without this "
        "key, it is above the middle of the floor at a third of the bin's height.",
    )
    T_world_cam: tuple[float, ...] | None = Field(
        default=None,
        description="The camera's pose, which replaces all other keys: the 16 numbers of a "
        "4x4 matrix by rows, in metres.",
    )

    @model_validator(mode="after")
    def _one_pose(self) -> "ViewSection":
        if self.T_world_cam is None:
            return self
        # Values are compared with defaults, because a configuration from a manifest sets every key.
        own = {name: field.default for name, field in ViewSection.model_fields.items()}
        others = [n for n in own if n != "T_world_cam" and getattr(self, n) != own[n]]
        if others:
            raise ValueError(f"T_world_cam is the whole pose: remove it, or {', '.join(others)}")
        refuse_no_pose(self.T_world_cam, "T_world_cam")
        return self


def refuse_no_pose(pose: tuple[float, ...], name: str) -> None:
    """Refuse, by ValueError, numbers that are not a rotation and a translation."""
    if len(pose) != 16:
        raise ValueError(f"{name} has {len(pose)} numbers; give 16")
    if not is_rigid(np.reshape(pose, (4, 4))):
        raise ValueError(f"{name} is not a rotation and a translation")


class DomeSection(Settings):
    """Camera poses on a dome above the target, drawn for each scene, uniform over solid angle."""

    kind: Literal["dome"] = Field(description="The kind of the poses: dome.")
    count: Count = Field(description="The number of images of a scene.")
    distance_m: PositiveSpan | None = Field(
        default=None,
        description="The distance from the middle of the baseline to the target in metres, or its "
        "lowest and highest value. Without this key, it is that of the view.",
    )
    tilt_deg: Tilt = Field(
        default=(0.0, 40.0),
        description="The angle between the viewing axis and the vertical, in degrees.",
    )
    azimuth_deg: Angle = Field(
        default=(-180.0, 180.0),
        description="The rotation of the rig about the vertical, in degrees.",
    )


class PathSection(Settings):
    """Camera poses along a path, such as a robot's; the path is the same in all scenes."""

    kind: Literal["path"] = Field(description="The kind of the poses: path.")
    count: Annotated[int, Field(ge=2, le=MOST_VIEWS)] = Field(
        description="The number of images. The first one is at the first waypoint, the last one "
        "at the last waypoint."
    )
    waypoints: tuple[ViewSection, ...] = Field(
        min_length=2,
        description="The poses between which the path goes. Images have equal steps between two "
        "waypoints; positions follow straight lines, and rotations are the shortest.",
    )


class JitterSection(Settings):
    """Random camera poses near the view, new for each scene; no deviation exceeds 3 sigma."""

    kind: Literal["jitter"] = Field(description="The kind of the poses: jitter.")
    count: Count = Field(description="The number of images of a scene.")
    position_m: Level = Field(
        default=0.01, description="The sigma along each of the world's axes, in metres."
    )
    rotation_deg: Level = Field(
        default=1.0, le=30, description="The sigma about each of the camera's axes, in degrees."
    )


_SAMPLERS = ("dome", "path", "jitter")


def _listed(value: Any) -> Any:
    """Refuse a value that is neither a list nor a sampler, with an error for users."""
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    if not isinstance(value, list | tuple) and kind not in _SAMPLERS:
        raise ValueError("give a list of places, or a mapping whose kind is dome, path or jitter")
    return value


def _kind_of(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "list"
    return value["kind"] if isinstance(value, dict) else value.kind


Listed = Annotated[tuple[ViewSection, ...], Field(min_length=1, max_length=MOST_VIEWS)]
Views = Annotated[
    Annotated[
        Annotated[Listed, Tag("list")]
        | Annotated[DomeSection, Tag("dome")]
        | Annotated[PathSection, Tag("path")]
        | Annotated[JitterSection, Tag("jitter")],
        Discriminator(_kind_of),
    ],
    BeforeValidator(
        _listed, json_schema_input_type=Listed | DomeSection | PathSection | JitterSection
    ),
]

# These words follow the type of camera or content in file names: `mask_visib`, `depth_sl`.
_TAKEN = ("sl", "visib", "info", "coco", "box3d", "sigma", "camera", "gt")


class ScannerEntry(ScannerSections):
    """One of several scanners in a cell.

    The sections code, exposure, sensor, decode and filters override those of the rig.
    """

    name: str = Field(
        description="The name of the scanner, which is part of its file names, as in rgb_NAME."
    )
    rig: RigName = Field(default="paper", description="The name of a preset, or a rig file.")
    T_first_cam: tuple[float, ...] | None = Field(
        default=None,
        description="The pose of its camera in the frame of the first scanner's camera, with which "
        "it moves: the 16 numbers of a 4x4 matrix by rows, in metres.",
    )
    views: Views | None = Field(
        default=None,
        description="The camera poses of this scanner. Without this key, they are those of the key "
        "views of the configuration.",
    )

    @field_validator("name")
    @classmethod
    def _fit_for_files(cls, name: str) -> str:
        plain = name.isascii() and name.replace("-", "").isalnum() and name[:1].isalpha()
        if not plain or len(name) > 32:
            raise ValueError(
                "give 1 to 32 letters, digits and hyphens, a letter first: it is part of file names"
            )
        if name.lower() in _TAKEN:
            raise ValueError("this word has a meaning in file names already: choose another")
        return name

    @model_validator(mode="after")
    def _one_mounting(self) -> "ScannerEntry":
        if self.T_first_cam is not None:
            refuse_no_pose(self.T_first_cam, "T_first_cam")
            if self.views is not None:
                raise ValueError("T_first_cam moves it with the first scanner: remove it, or views")
        return self


def hang(view: ViewSection, rig: Rig, box: Bin) -> Pose:
    """Return the given `T_world_cam`, or the pose of the rig placed above the bin."""
    if view.T_world_cam is not None:
        return np.reshape(view.T_world_cam, (4, 4)).astype(np.float64)
    return _on(
        view,
        rig,
        box,
        distance_m=view.distance_m or standoff_m(rig),
        tilt_rad=float(np.radians(view.tilt_deg)),
        azimuth_rad=float(np.radians(view.azimuth_deg)),
    )


Sampler = DomeSection | PathSection | JitterSection


def how_many(views: tuple[ViewSection, ...] | Sampler | None) -> int:
    """Return the number of images of a scene."""
    if views is None:
        return 1
    return len(views) if isinstance(views, tuple) else views.count


def places(
    views: tuple[ViewSection, ...] | Sampler,
    view: ViewSection,
    rig: Rig,
    box: Bin,
    *,
    rng: np.random.Generator,
) -> tuple[Pose, ...]:
    """Return `T_world_cam` of every image that a rig takes of one scene.

    Args:
        view: the configuration's single view, the centre of a jitter.
        rng: random numbers of this scanner in this scene; a list and a path do not use them.

    Raises:
        ConfigError: camera or projector would be inside the bin, or below the bin's floor.
    """
    match views:
        case DomeSection():
            poses = _on_dome(views, view, rig, box, rng)
        case PathSection():
            poses = _along(views, rig, box)
        case JitterSection():
            poses = _about(views, hang(view, rig, box), rng)
        case _:
            poses = [hang(one, rig, box) for one in views]
    for number, T_world_cam in enumerate(poses):
        refuse_inside(T_world_cam, rig, box, f"views: image {number}")
    return tuple(poses)


def _on_dome(
    dome: DomeSection, view: ViewSection, rig: Rig, box: Bin, rng: np.random.Generator
) -> list[Pose]:
    low, high = np.cos(np.radians(dome.tilt_deg))
    near_m, far_m = _distances(dome, view, rig)
    uniform = rng.uniform(size=(dome.count, 3))
    return [
        _on(
            view,
            rig,
            box,
            distance_m=near_m + (far_m - near_m) * a,
            tilt_rad=float(np.arccos(low + (high - low) * b)),
            azimuth_rad=float(np.radians(dome.azimuth_deg[0] + np.ptp(dome.azimuth_deg) * c)),
        )
        for a, b, c in uniform.tolist()
    ]


def _on(
    view: ViewSection, rig: Rig, box: Bin, *, distance_m: float, tilt_rad: float, azimuth_rad: float
) -> Pose:
    """Place the rig above a view's target, by default at a third of the bin's height."""
    return place(
        rig,
        target_m=np.array(view.target_m or (0.0, 0.0, box.inner_m[2] / 3)),
        distance_m=distance_m,
        tilt_rad=tilt_rad,
        azimuth_rad=azimuth_rad,
    )


def _distances(dome: DomeSection, view: ViewSection, rig: Rig) -> tuple[float, float]:
    return dome.distance_m or (view.distance_m or standoff_m(rig),) * 2


def _along(path: PathSection, rig: Rig, box: Bin) -> list[Pose]:
    T = np.stack([hang(waypoint, rig, box) for waypoint in path.waypoints])
    at = np.arange(len(T))
    when = np.linspace(0, len(T) - 1, path.count)
    turned = Slerp(at, Rotation.from_matrix(T[:, :3, :3]))(when).as_matrix()
    where = np.stack([np.interp(when, at, T[:, k, 3]) for k in range(3)], axis=1)
    return [rigid(R, t) for R, t in zip(turned, where, strict=True)]


def _about(jitter: JitterSection, T: Pose, rng: np.random.Generator) -> list[Pose]:
    poses = []
    for _ in range(jitter.count):
        moved_m = jitter.position_m * _within(rng)
        turn = np.eye(3)
        for axis, sigmas in zip("xyz", _within(rng), strict=True):
            turn = turn @ axis_rotation(axis, np.radians(jitter.rotation_deg) * sigmas)
        poses.append(rigid(T[:3, :3] @ turn, T[:3, 3] + moved_m))
    return poses


def _within(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Draw three standard normal numbers, each within `FARTHEST_SIGMAS`."""
    normal = rng.standard_normal(3)
    while (far := np.abs(normal) > FARTHEST_SIGMAS).any():
        normal[far] = rng.standard_normal(int(far.sum()))
    return normal


def farthest(
    views: tuple[ViewSection, ...] | Sampler, view: ViewSection, rig: Rig, box: Bin
) -> tuple[Pose, ...]:
    """Return poses that include the one with the bin's largest possible depth in any scene."""
    if isinstance(views, DomeSection):
        ends = itertools.product(set(views.tilt_deg), np.linspace(*views.azimuth_deg, _TURN))
        far_m = _distances(views, view, rig)[1]
        return tuple(
            _on(
                view,
                rig,
                box,
                distance_m=far_m,
                tilt_rad=float(np.radians(tilt_deg)),
                azimuth_rad=float(np.radians(azimuth_deg)),
            )
            for tilt_deg, azimuth_deg in ends
        )
    if not isinstance(views, JitterSection):
        return places(views, view, rig, box, rng=np.random.default_rng(0))
    T = hang(view, rig, box)
    back_m = FARTHEST_SIGMAS * np.sqrt(3) * views.position_m * T[:3, 2]
    most_rad = FARTHEST_SIGMAS * np.radians(views.rotation_deg)
    turns = itertools.product("xyz", (-most_rad, 0.0, most_rad))
    return tuple(
        rigid(T[:3, :3] @ axis_rotation(axis, angle_rad), T[:3, 3] - back_m)
        for axis, angle_rad in turns
    )


def refuse_inside(T_world_cam: Pose, rig: Rig, box: Bin, where: str) -> None:
    """Refuse a camera or projector between the bin's walls or below the bin's floor.

    Raises:
        ConfigError: the camera or the projector is at such a place.
    """
    half_m = np.array(box.inner_m[:2]) / 2 + box.wall_m
    for device, T in (("camera", T_world_cam), ("projector", T_world_cam @ rig.T_cam_proj)):
        x, y, z = T[:3, 3].tolist()
        over_bin = abs(x) < half_m[0] and abs(y) < half_m[1]
        if z < 0 or (over_bin and z < box.inner_m[2]):
            raise ConfigError(
                f"{where}: the {device} is at ({x:.3f}, {y:.3f}, {z:.3f}) m, inside the bin or "
                f"under its floor: bring it above the rim at z = {box.inner_m[2]:.3f} m"
            )


def refuse_outside(T_world_cam: Pose, rig: Rig, box: Bin, where: str) -> None:
    """Refuse a camera or a projector whose picture does not contain the bin.

    Raises:
        ConfigError: the bin is not in the picture of the camera, or of the projector.
    """
    end_m = np.array([*(np.array(box.inner_m[:2]) / 2), box.inner_m[2]])
    corner = np.array([*itertools.product((-1, 1), (-1, 1), (0, 1))]) * end_m
    for device, optics, T in (
        ("camera", rig.camera, T_world_cam),
        ("projector", rig.projector, T_world_cam @ rig.T_cam_proj),
    ):
        if _is_beside(optics, transform_points(inverse(T), corner)):
            x, y, z = T[:3, 2].tolist()
            raise ConfigError(
                f"{where}: no part of the bin is in the {device}'s picture, because the {device} "
                f"looks along ({x:.2f}, {y:.2f}, {z:.2f}): move it farther away (view.distance_m), "
                "or turn it (view, or the z axis of T_world_cam) towards the bin"
            )


def _is_beside(optics: Optics, point_m: Float[np.ndarray, "n 3"]) -> bool:
    """Return whether all points (device's frame) are behind the device or beyond one edge."""
    x, y = optics.width_px - 1.0, optics.height_px - 1.0
    ray = rays(optics, np.array([[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]]))
    inwards = np.cross(ray, np.roll(ray, -1, axis=0))
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    away = point_m @ inwards.T < -_BEYOND * np.linalg.norm(point_m, axis=1, keepdims=True)
    return bool((point_m[:, 2] <= 0).all() or away.all(axis=0).any())
