"""Parallel jaws on a part with a known mesh: grasp search, and loads held by friction."""

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
TURNS = 8  # At each place, this many turns about the axis of the pads are tried.
PAD_LINES = 8  # number of lines from a pad to the part, on each of two rings
PAD_GIVES_M = 0.5e-3  # The jaws press a rubber pad in by this depth.
PROBES = 3000  # number of points on the part's surface; none may be inside a finger


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

    `aside_m` is the offset along x of the middle between the pads. `slope` is the tangent of the
    angle between the jaws' axis and the surface normal at a pad, the larger of both pads. `ahead_m`
    is the largest distance by which a finger meets the mesh before its pad does.
    """

    aside_m: float
    slope: float
    ahead_m: float

    @property
    def on_pads(self) -> bool:
        """Whether both pads touch the part: the pads can be pressed in by at least `ahead_m`."""
        return self.ahead_m <= PAD_GIVES_M


def jaw_load_factor(
    jaws: Jaws, force_n: Float[np.ndarray, "k 3"], moment_nm: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    """Return the safety factor of a load between two pads with friction; below 1 the part slips.

    Across their axis, both pads together hold a force of 2 friction force. About this axis, they
    hold the moment of two discs of even pressure, 2 friction force (2/3 r). The pads' normal forces
    hold moments about other axes; these are not checked, because fingers are stiff compared with
    a part's weight. The drive holds forces along the axis.

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
    """Return all grips at which open fingers fit round the part, even if they do not hold it.

    Jaws hold if both surface normals are in the cone of friction about the line between the pads,
    and no point of the part is inside an open finger or the palm; a finger may go into a hole or
    between two walls. The score is then the share of random trials (position of the tool, friction,
    centre of mass) in which both pads meet the part within the cone, before the rest of a finger
    does, and hold the load. It is the minimum over an upright tool and one that leans to four
    sides. If the jaws do not hold, it is 0. In the first trial, the tool is at its planned pose.

    Args:
        center_m: the part's centre of mass.
        count: number of places that are tried, evenly over the surface.
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
    """Return random true poses of a tool in its planned frame, within three standard deviations."""
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
    """Return the contact of jaws that close on a mesh; None if a pad meets nothing.

    Lines parallel to the jaws' axis run from each open pad to the opposite pad; the pad meets the
    first surface on them, and surfaces outside the open pads do not count. A pad touches all that
    is within `PAD_GIVES_M` of the point that it meets first. The slope is the tangent of the angle
    between the axis and the mean normal of the touched surface. The flat face of a finger, as wide
    and as long as the finger, is in the plane that the pad touches: a surface more than
    `PAD_GIVES_M` before this plane keeps the pad off the part.

    Args:
        opening_m: distance between the open pads; by default, the jaws' largest opening.
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
    a, b, c = np.moveaxis(corners[near], 1, 0)  # Lines meet none of the other triangles.
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
    """Return the distance and index of each ray's last triangle within `most_m`; -1 if none."""
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
    """Return how far the triangles in a box that ends at `most_x` rise above a plane, along x.

    The plane is `x + lean_y y + lean_z z = 0`. The result is -inf if no triangle is in the box.
    Each triangle is cut by the planes of the box (Sutherland and Hodgman, 1974).
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
