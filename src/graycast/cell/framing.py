"""The shares of a picture that bin and parts cover, and the choice of a scanner for a bin."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from jaxtyping import Float

from ..base.frames import inverse, transform_points
from ..rig.optics import Optics, project
from ..rig.pair import Rig, preset_rig
from ..rig.shelf import SHELF
from ..world.parts import Part
from ..world.scene import Bin, Layout, Scene, bin_of
from .views import Pose, ViewSection, hang

# These presets model manufacturers' products. Presets of self-built scanners are left out.
SCANNERS = tuple(name for name in SHELF if name.startswith("like-"))
ENOUGH = 0.85  # The first scanner with this share of the best `bin_share` is taken.
EDGE = 0.02  # This share of a picture stays free at each of its edges.
STEP_M = 0.01
_NAMED = 3  # A line has the widths of this many parts; for more parts, it has their range.


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """A scanner of the shelf above a bin.

    `distance_m` is `view.distance_m` of a configuration. `bin_share` is the share of the picture
    that the bin covers, and `best_share` the largest of all compared scanners that fit. `missing_m`
    is how far the bin's worst corner is outside the working range, or the field of camera or
    projector; 0 or less if all corners are inside.
    """

    rig: Rig
    T_world_cam: Pose
    distance_m: float
    bin_share: float
    best_share: float
    missing_m: float


def best_framing(box: Bin, names: Iterable[str] = SCANNERS) -> Framing:
    """Return the scanner whose picture a bin fills best, and its distance from the bin.

    Each scanner has the least distance at which all corners of the bin are in its working range and
    in the fields of camera and projector. The result is the first of `names` in whose picture the
    bin covers nearly as much as in the best (`ENOUGH`). If no scanner fits, it is the scanner with
    the least `missing_m`.
    """
    nearest = [_nearest(preset_rig(name, "full"), box) for name in names]
    fits = [one for one in nearest if one.missing_m <= 0]
    if not fits:
        return min(nearest, key=lambda one: one.missing_m)
    best = max(one.bin_share for one in fits)
    first = next(one for one in fits if one.bin_share >= ENOUGH * best)
    return replace(first, best_share=best)


def _nearest(rig: Rig, box: Bin) -> Framing:
    """Return the least distance at which a scanner fits, else the distance of least `missing_m`.

    Distances are multiples of `STEP_M`.
    """
    step = np.arange(round(rig.near_m / STEP_M), round((rig.far_m + box.inner_m[2]) / STEP_M) + 1)
    missing_m = _missing_m(rig, box, step * STEP_M)
    fits = missing_m <= 0
    best = int(np.argmax(fits) if fits.any() else np.argmin(missing_m))
    distance_m = round(float(step[best]) * STEP_M, 6)
    T_world_cam = _hang(rig, box, distance_m)
    share = bin_share(rig.camera, T_world_cam, box)
    return Framing(
        rig=rig,
        T_world_cam=T_world_cam,
        distance_m=distance_m,
        bin_share=share,
        best_share=share,
        missing_m=float(missing_m[best]),
    )


def _hang(rig: Rig, box: Bin, distance_m: float) -> Pose:
    return hang(ViewSection(distance_m=distance_m), rig, box)


def _missing_m(rig: Rig, box: Bin, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return `Framing.missing_m` for each distance."""
    # The rig does not turn with the distance, so a corner moves along a line in its frame.
    corner = bin_corners_m(box)
    at_1_m, at_2_m = (transform_points(inverse(_hang(rig, box, d)), corner) for d in (1.0, 2.0))
    in_camera = at_1_m + (distance_m[:, None, None] - 1) * (at_2_m - at_1_m)
    z_m = in_camera[..., 2]
    lacks_m = (
        rig.near_m - z_m.min(axis=1),
        z_m.max(axis=1) - rig.far_m,
        _beyond_m(rig.camera, in_camera),
        _beyond_m(rig.projector, transform_points(rig.T_proj_cam, in_camera)),
    )
    return np.max(lacks_m, axis=0)


def _beyond_m(optics: Optics, point_m: Float[np.ndarray, "n corners 3"]) -> Float[np.ndarray, " n"]:
    """Return how far the worst point is outside a field, reduced by a margin at its edges [m]."""
    size_px = np.array([optics.width_px, optics.height_px])
    pixel = project(optics, point_m.reshape(-1, 3)).reshape(*point_m.shape[:2], 2)
    beyond_px = np.abs(pixel - (size_px - 1) / 2) - (0.5 - EDGE) * size_px
    beyond_m = beyond_px / [optics.fx_px, optics.fy_px] * point_m[..., 2:]
    worst_m = beyond_m.max(axis=(1, 2))
    return np.where(np.isnan(worst_m), np.inf, worst_m)


def bin_corners_m(box: Bin) -> Float[np.ndarray, "8 3"]:
    """Return the inner corners of a bin in world coordinates."""
    length_m, width_m, height_m = box.inner_m
    sides = ((-length_m / 2, length_m / 2), (-width_m / 2, width_m / 2), (0.0, height_m))
    return np.array([*product(*sides)])


def bin_share(camera: Optics, T_world_cam: Pose, box: Bin) -> float:
    """Return the share of a picture inside the outline of the bin's inner corners."""
    corner = project(camera, transform_points(inverse(T_world_cam), bin_corners_m(box)))
    known = corner[np.isfinite(corner).all(axis=1)].astype(np.float32)
    if len(known) < 3:
        return 0.0
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    edge = np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)], np.float32)
    area_px2, _ = cv2.intersectConvexConvex(cv2.convexHull(known), edge)
    return float(area_px2) / (camera.width_px * camera.height_px)


def part_width_px(part: Part, camera: Optics, T_world_cam: Pose, box: Bin) -> float:
    """Return a part's width in pixels, with its longest side perpendicular to the line of sight.

    The part is in the middle of the bin, at a third of its height.
    """
    middle = np.array([[0.0, 0.0, box.inner_m[2] / 3]])
    ((_, _, z_m),) = transform_points(inverse(T_world_cam), middle)
    return camera.fx_px * float(part.mesh.extent_m.max()) / z_m


def framing_line(scene: Scene, layout: Layout | None = None) -> str:
    """Return a line on how much of a scene's picture the bin fills and how wide the parts are.

    The parts are the labelled parts of a layout or, without a layout, all kinds of the scene.
    """
    kinds = range(len(scene.parts)) if layout is None else sorted({*layout.part_index.tolist()})
    parts = [scene.parts[kind] for kind in kinds if scene.parts[kind].labelled]
    camera, box = scene.rig.camera, bin_of(scene)
    share = bin_share(camera, scene.T_world_cam, box)
    width_px = [part_width_px(part, camera, scene.T_world_cam, box) for part in parts]
    words = [f"the bin fills {100 * share:.0f} % of the picture"]
    if len(parts) > _NAMED:
        words.append(f"parts are {min(width_px):.0f} to {max(width_px):.0f} px wide")
    else:
        each = zip(parts, width_px, strict=True)
        words += [f"{part.name} is {width:.0f} px wide" for part, width in each]
    return ", ".join(words)
