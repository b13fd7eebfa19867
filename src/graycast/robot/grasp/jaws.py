"""Parallel jaws on a part with a known mesh: search for grips, and load that friction holds."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import Field
from scipy.spatial.transform import Rotation

from ...base.frames import inverse, rigid, transform_points
from ...base.kernels import kernel
from ...base.public_value import public_value
from ...base.streams import stream
from ...world.parts import Mesh
from ...world.parts.sampling import spread_points
from .grip import Grip, downs
from .robust import SHAKE, Doubt

CLEARANCE_M = 2e-3  # Each open finger keeps this gap to the part.
TURNS = 8  # number of rotations about the axis of the pads that are tried at each place
PAD_LINES = 8  # number of lines from a pad to the part, on each of two rings
PAD_GIVES_M = 0.5e-3  # depth by which the rubber of a pad is compressed when the jaws close
PROBES = 3000  # number of points on the part's surface; none of them may be inside a finger


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Jaws:
    """Two parallel fingers that close along the tool's x; z points from the tips to the palm.

    The origin of a grip's frame is the middle between both pads.
    """

    opening_m: Annotated[
        float, Field(description="The largest distance between the pads in metres.")
    ] = 0.085
    force_n: Annotated[float, Field(description="The force of each pad in newtons.")] = 60.0
    friction: Annotated[
        float, Field(description="The coefficient of friction between pad and part.")
    ] = 0.4
    finger_m: Annotated[
        tuple[float, float, float],
        Field(
            description="A finger's thickness along x, its width along y, and its length from tip "
            "to palm along z, in metres."
        ),
    ] = (0.010, 0.020, 0.045)
    pad_radius_m: Annotated[
        float,
        Field(
            description="The radius of the disc in which a pad touches, in metres. Its middle lies "
            "that far from the finger's tip."
        ),
    ] = 0.004

    def __post_init__(self) -> None:
        for name in ("opening_m", "force_n", "pad_radius_m"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be greater than 0")
        if self.opening_m > 1:
            raise ValueError(
                f"opening_m is {self.opening_m:g}: this is too large; give metres, not millimetres"
            )
        if not self.friction >= 0:
            raise ValueError(f"friction is {self.friction}; it must be at least 0")


class PadContact(NamedTuple):
    """Contact of closed jaws with a mesh.

    `aside_m` is the offset of the midpoint between the pads along x. `slope` is the tangent of the
    angle between the jaws' axis and the surface normal, at the pad where this angle is larger.
    `ahead_m` is the largest distance by which a finger meets the mesh before its pad does.
    """

    aside_m: float
    slope: float
    ahead_m: float

    @property
    def on_pads(self) -> bool:
        """Whether both pads touch the part; a pad can be compressed by `PAD_GIVES_M`."""
        return self.ahead_m <= PAD_GIVES_M


def jaw_load_factor(
    jaws: Jaws, force_n: Float[np.ndarray, "k 3"], moment_nm: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Return the safety factor of a load between two pads with friction; below 1 the part slips.

    Across the pads' axis, both pads together resist a force of 2 mu F (mu: friction, F: force of
    each pad). About this axis, they resist the moment of two discs with uniform pressure,
    2 mu F (2/3 r). Moments about other axes are not checked: the pads' normal forces resist them,
    because fingers are stiff compared with a part's weight. The drive resists axial forces.

    Args:
        force_n: the force on the part, in the tool's frame.
        moment_nm: the moment of the load about the tool's origin.
    """
    demand = np.sqrt(
        force_n[..., 1] ** 2
        + force_n[..., 2] ** 2
        + (moment_nm[..., 0] / (2 / 3 * jaws.pad_radius_m)) ** 2
    )
    with np.errstate(divide="ignore"):
        return 2 * jaws.friction * jaws.force_n / demand


def jaw_places(
    mesh: Mesh,
    jaws: Jaws,
    *,
    weight_n: float,
    center_m: Float[np.ndarray, "3"],
    doubt: Doubt,
    count: int = 200,
    chances: int = 24,
    seed: int = 0,
) -> list[Grip]:
    """Return all grips at which the open fingers fit around the part, even if they do not hold it.

    The score is 0 if a surface normal is outside the friction cone about the line between the pads,
    or if a point of the part is inside an open finger or the palm; a finger may reach into a hole
    or between two walls. Otherwise, the score is the share of random trials (pose of the tool,
    friction, centre of mass) in which both pads touch the part within the friction cone, before the
    rest of a finger does, and resist the load. It is the minimum over an upright tool and one that
    leans to four sides. In the first trial, the tool is at its planned pose.

    Args:
        center_m: the part's centre of mass, in the part's frame.
        count: number of places that are tried, evenly distributed over the surface.
        chances: number of random trials for each grip.
        seed: seed for the random trials.
    """
    rng = np.random.default_rng(seed)
    point, normal = spread_points(mesh, count)
    probes = spread_points(mesh, PROBES)[0]
    off = rng.normal(size=(chances, 4))
    T_tool_true = _displaced(doubt, chances, seed)
    friction = jaws.friction * np.maximum(1 + doubt.friction_share * off[:, 0], 0)
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces].astype(np.float64), 1, 0)
    through_m, face = _far_side(point, -normal, a, b - a, c - a, most_m=np.inf)
    far_normal = mesh.face_normal[face]
    slope = np.tan(np.arccos(np.clip(-np.einsum("ni,ni->n", far_normal, normal), 0, 1)))
    fits = (through_m > 1e-4) & (through_m + 2 * CLEARANCE_M <= jaws.opening_m)
    closes = slope <= jaws.friction
    places = []
    for i in np.flatnonzero(fits):
        for turn in 2 * np.pi * np.arange(TURNS) / TURNS:
            T = _closed_on(point[i] - normal[i] * through_m[i] / 2, normal[i], turn)
            opening_m = float(through_m[i])
            if not closes[i] or _in_the_way(jaws, probes, T, opening_m):
                places.append(Grip(T_part_tool=T, score=0.0, opening_m=opening_m))
                continue
            wide_m = opening_m + 2 * CLEARANCE_M
            met = [closing(mesh, jaws, T @ error, opening_m=wide_m) for error in T_tool_true]
            stable = friction >= [one.slope if one and one.on_pads else np.inf for one in met]
            centers = (center_m + doubt.center_m * off[:, 1:] - T[:3, 3]) @ T[:3, :3]
            loads_n = SHAKE * weight_n * downs()[:, None].repeat(chances, axis=1)
            factor = np.array(
                [jaw_load_factor(jaws, each_n, np.cross(centers, each_n)) for each_n in loads_n]
            )
            score = np.mean(stable & (factor * friction / jaws.friction >= 1), axis=1).min()
            places.append(Grip(T_part_tool=T, score=float(score), opening_m=opening_m))
    return places


def _displaced(doubt: Doubt, count: int, seed: int) -> Float[np.ndarray, "k 4 4"]:
    """Return random actual poses of the tool relative to its planned pose.

    The first is the planned pose. Position and rotation errors are normal with the standard
    deviations in `doubt`, and are clipped at three standard deviations on each axis.
    """
    rng = stream(seed, 1)
    off = np.clip(rng.normal(size=(count, 6)), -3, 3)
    off[0] = 0
    turned = Rotation.from_rotvec(doubt.angle_rad * off[:, :3]).as_matrix()
    return np.stack(
        [rigid(R, doubt.position_m * at) for R, at in zip(turned, off[:, 3:], strict=True)]
    )


def closing(
    mesh: Mesh,
    jaws: Jaws,
    T_mesh_tool: Float[np.ndarray, "4 4"],
    *,
    opening_m: float | None = None,
) -> PadContact | None:
    """Return the contact of jaws that close on a mesh; None if a pad touches nothing.

    Lines parallel to the jaws' axis run from each open pad to the opposite pad. The pad meets the
    first surface on these lines; surfaces outside the open pads do not count. A pad touches all
    triangles within `PAD_GIVES_M` of the point that it meets first. The slope is the tangent of the
    angle between the axis and the mean normal of the touched triangles. The flat face of a finger
    is in the plane that the pad touches. Surface that is more than `PAD_GIVES_M` in front of this
    plane keeps the pad away from the part.

    Args:
        opening_m: distance between the open pads; the default is the jaws' largest opening.
    """
    around = 2 * np.pi * np.arange(PAD_LINES) / PAD_LINES
    across = [np.zeros((1, 2))]
    across += [
        share * jaws.pad_radius_m * np.stack([np.cos(around), np.sin(around)], axis=-1)
        for share in (0.5, 0.95)
    ]
    line = np.concatenate(across)
    open_m = jaws.opening_m if opening_m is None else opening_m
    _, wide_m, long_m = jaws.finger_m
    finger = (wide_m / 2, -jaws.pad_radius_m, long_m - jaws.pad_radius_m)
    vertices = transform_points(inverse(T_mesh_tool), mesh.vertices_m.astype(np.float64))
    corners = vertices[mesh.faces]
    low, high = corners[..., 1:].min(axis=1), corners[..., 1:].max(axis=1)
    near = ((low <= jaws.pad_radius_m) & (high >= -jaws.pad_radius_m)).all(axis=1)
    a, b, c = np.moveaxis(corners[near], 1, 0)  # The lines cannot meet the other triangles.
    cross = np.cross(b - a, c - a)
    outermost_m, slopes, ahead_m = [], [], []
    for side in (1.0, -1.0):
        origin = np.column_stack([np.full(len(line), -side * open_m / 2), line])
        way = np.tile([side, 0.0, 0.0], (len(line), 1))
        far_m, face = _far_side(origin, way, a, b - a, c - a, most_m=open_m)
        hit = far_m >= 0
        if hit.sum() < len(line) / 2:
            return None
        touched = face[far_m >= far_m.max() - PAD_GIVES_M]
        normal = cross[touched] / np.linalg.norm(cross[touched], axis=1, keepdims=True)
        mean = normal.mean(axis=0)
        along = side * mean[0] / np.linalg.norm(mean)
        slopes.append(float(np.tan(np.arccos(np.clip(along, 1e-6, 1)))))
        outermost_m.append(side * float(far_m[hit].max() - open_m / 2))
        lean = mean[1:] / (np.linalg.norm(mean) * max(along, 1e-6))
        pad_m = float((far_m - open_m / 2 + line @ lean)[hit].max())
        ahead_m.append(_foremost(corners * [side, 1.0, 1.0], open_m / 2, *finger, *lean) - pad_m)
    return PadContact(sum(outermost_m) / 2, max(slopes), max(ahead_m))


def _closed_on(
    middle_m: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], turn_rad: float
) -> Float[np.ndarray, "4 4"]:
    least = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(axis, least)
    u /= np.linalg.norm(u)
    z = np.cos(turn_rad) * u + np.sin(turn_rad) * np.cross(axis, u)
    return rigid(np.stack([axis, np.cross(z, axis), z], axis=1), middle_m)


def _in_the_way(
    jaws: Jaws,
    probes: Float[np.ndarray, "n 3"],
    T: Float[np.ndarray, "4 4"],
    opening_m: float,
) -> bool:
    """Return whether the part reaches into an open finger or the palm.

    The gap between an open finger and the surface is not checked here; `closing` checks it.
    """
    x, y, z = ((probes - T[:3, 3]) @ T[:3, :3]).T
    thick, wide, long = jaws.finger_m
    inner = opening_m / 2 + 1e-6
    beside = (np.abs(x) > inner + CLEARANCE_M) & (np.abs(x) < inner + CLEARANCE_M + thick)
    palm_m = long - jaws.pad_radius_m
    finger = beside & (np.abs(y) < wide / 2) & (z > -jaws.pad_radius_m) & (z < palm_m)
    palm = (z >= palm_m) & (np.abs(x) < inner + CLEARANCE_M + thick) & (np.abs(y) < wide / 2)
    return bool((finger | palm).any())


@kernel()
def _far_side(origin, way, a, ab, ac, most_m):
    """Return distance and index of the last triangle on each ray, up to `most_m`; -1 if none."""
    distance, face = np.full(len(origin), -1.0), np.full(len(origin), -1)
    for i in range(len(origin)):
        for f in range(len(a)):
            px = way[i, 1] * ac[f, 2] - way[i, 2] * ac[f, 1]
            py = way[i, 2] * ac[f, 0] - way[i, 0] * ac[f, 2]
            pz = way[i, 0] * ac[f, 1] - way[i, 1] * ac[f, 0]
            det = ab[f, 0] * px + ab[f, 1] * py + ab[f, 2] * pz
            if abs(det) < 1e-15:
                continue
            tx, ty, tz = origin[i, 0] - a[f, 0], origin[i, 1] - a[f, 1], origin[i, 2] - a[f, 2]
            u = (tx * px + ty * py + tz * pz) / det
            qx = ty * ab[f, 2] - tz * ab[f, 1]
            qy = tz * ab[f, 0] - tx * ab[f, 2]
            qz = tx * ab[f, 1] - ty * ab[f, 0]
            v = (way[i, 0] * qx + way[i, 1] * qy + way[i, 2] * qz) / det
            if u < 0 or v < 0 or u + v > 1:
                continue
            t = (ac[f, 0] * qx + ac[f, 1] * qy + ac[f, 2] * qz) / det
            if distance[i] < t <= most_m:
                distance[i], face[i] = t, f
    return distance, face


@kernel()
def _foremost(corners, most_x, half_y, low_z, high_z, lean_y, lean_z):
    """Return the largest height, along x, of the triangles in a box above a plane.

    The plane is `x + lean_y y + lean_z z = 0`, and the box ends at `x = most_x`. The result is -inf
    if no triangle is in the box. The planes of the box clip each triangle (Sutherland and Hodgman,
    1974).
    """
    axes, signs = (0, 1, 1, 2, 2), (1.0, 1.0, -1.0, 1.0, -1.0)
    bounds = (most_x, half_y, half_y, high_z, -low_z)
    polygon, cut = np.empty((8, 3)), np.empty((8, 3))
    foremost = -np.inf
    for f in range(len(corners)):
        count = 3
        polygon[:3] = corners[f]
        for plane in range(5):
            axis, sign, bound = axes[plane], signs[plane], bounds[plane]
            before, size = count - 1, 0
            for k in range(count):
                here, there = sign * polygon[k, axis] - bound, sign * polygon[before, axis] - bound
                if (here <= 0) != (there <= 0):
                    share = there / (there - here)
                    cut[size] = polygon[before] + share * (polygon[k] - polygon[before])
                    size += 1
                if here <= 0:
                    cut[size] = polygon[k]
                    size += 1
                before = k
            polygon, cut, count = cut, polygon, size
        for k in range(count):
            over = polygon[k, 0] + lean_y * polygon[k, 1] + lean_z * polygon[k, 2]
            foremost = max(foremost, over)
    return foremost
