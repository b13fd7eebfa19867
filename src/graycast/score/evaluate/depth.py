"""The scanner's depth against perfect depth by angle of incidence: bias, noise, spikes, holes.

`graycast dataset stats` has the same figures over all angles and over the parts. The angle is
between the camera's ray and the normal of the perfect surface, from central differences of its
points: exact for planes. Where a pixel's neighbours do not lie on one surface (a step, a crease,
the border of the picture or of perfect depth) there is no such angle: these pixels are a row of
their own.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...dataset.stats.gather import ErrorFigures, error_figures
from ...dataset.stored import SceneContent
from ...rig.optics import undistort

ANGLE_EDGES_DEG = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90)
EDGE = len(ANGLE_EDGES_DEG) - 1  # This row has the pixels without an angle.
_KINK = 0.5  # Along the ray, a pixel may lie this share of the spacing off its neighbours' middle.


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthRow:
    """Pixels with perfect depth within a range of angles.

    Attributes:
        name: `10 to 20 deg`, or `edges`.
        reason: share of the pixels for each reason, `decoded` being those with a depth.
        error: of those with a depth; beyond 1 and 5 mm are spikes.
    """

    name: str
    pixels: int
    reason: dict[str, float]
    error: ErrorFigures


def depth_rows(scenes: Iterable[SceneContent], *, parts_only: bool = False) -> list[DepthRow]:
    """Every scene is read once; a row for each range of angles and one for edges.

    Args:
        parts_only: count only pixels of visible parts.
    """
    steps = [Counter[int]() for _ in range(EDGE + 1)]
    reasons = [Counter[str]() for _ in range(EDGE + 1)]
    scale_mm = 0.0
    for scene in scenes:
        if scene.depth is None or scene.scanner is None:
            continue
        scale_mm = scale_mm or scene.depth_scale_mm
        row = rows_of_pixels(scene)
        if parts_only:
            row = np.where(scene.label >= 0, row, -1)
        _count(scene, row, steps, reasons, scale_mm)
    return [_depth_row(k, steps[k], reasons[k], scale_mm) for k in range(EDGE + 1)]


def rows_of_pixels(scene: SceneContent) -> Int[np.ndarray, "h w"]:
    """The row that counts each pixel; -1 where there is no perfect depth."""
    assert scene.depth is not None
    angle = incidence_rad(
        np.where(scene.depth > 0, scene.depth * (scene.depth_scale_mm / 1000), np.nan),
        K=np.array(scene.view["cam_K"], float).reshape(3, 3),
        distortion=tuple(scene.view["distortion"]),
    )
    edges = np.radians(ANGLE_EDGES_DEG[1:-1])
    row = np.where(np.isnan(angle), EDGE, np.searchsorted(edges, angle, side="right"))
    return np.where(scene.depth > 0, row, -1)


def incidence_rad(
    depth_m: Float[np.ndarray, "h w"],
    *,
    K: Float[np.ndarray, "3 3"],
    distortion: tuple[float, ...],
) -> Float[np.ndarray, "h w"]:
    """Angle between the camera's ray and the surface's normal; NaN where there is no one surface.

    Args:
        depth_m: z of the camera frame, NaN where there is none.
        K: the centre of the top-left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3 of OpenCV.
    """
    y, x = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]].astype(float)
    direction = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]], axis=-1)
    k1, k2, p1, p2, k3 = distortion
    ideal = undistort(direction, (k1, k2, p1, p2, k3))
    ray = np.concatenate([ideal, np.ones((*depth_m.shape, 1))], axis=-1)
    point = _with_border(depth_m[..., None].astype(float) * ray)
    # From the pixel before to the pixel after; NaN at the border.
    across, down = point[1:-1, 2:] - point[1:-1, :-2], point[2:, 1:-1] - point[:-2, 1:-1]
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs((normal * ray).sum(axis=-1)) / length
    return np.where(_smooth(depth_m, K), np.arccos(np.minimum(cosine, 1.0)), np.nan)


def _smooth(
    depth_m: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"]
) -> Bool[np.ndarray, "h w"]:
    """Whether a pixel lies between its neighbours: on a plane 1/z is linear in the picture.

    How far 1/z lies off the mean of its neighbours is told as a depth and compared with their
    spacing on a facing surface, z / f.
    """
    inverse = _with_border(1 / depth_m.astype(float))
    middle = inverse[1:-1, 1:-1]
    beside = (inverse[1:-1, :-2] + inverse[1:-1, 2:]) / 2
    above = (inverse[:-2, 1:-1] + inverse[2:, 1:-1]) / 2
    spacing_m = 1 / (middle * K[0, 0]), 1 / (middle * K[1, 1])
    return (np.abs(middle - beside) / middle**2 < _KINK * spacing_m[0]) & (
        np.abs(middle - above) / middle**2 < _KINK * spacing_m[1]
    )


def _with_border(image: Float[np.ndarray, "h w *n"]) -> Float[np.ndarray, "h2 w2 *n"]:
    """The image with a border of NaN, one pixel wide."""
    return np.pad(image, ((1, 1), (1, 1), *[(0, 0)] * (image.ndim - 2)), constant_values=np.nan)


def _count(
    scene: SceneContent,
    row: Int[np.ndarray, "h w"],
    steps: list[Counter[int]],
    reasons: list[Counter[str]],
    scale_mm: float,
) -> None:
    assert scene.depth is not None and scene.scanner is not None
    ratio = scene.depth_scale_mm / scale_mm
    for k in range(EDGE + 1):
        here = row == k
        counts = np.bincount(scene.reason[here], minlength=256)
        reasons[k].update({n: int(counts[number]) for number, n in scene.reason_name.items()})
        both = here & (scene.scanner > 0)
        error = scene.scanner[both].astype(np.int64) - scene.depth[both]
        value, times = np.unique(np.rint(error * ratio).astype(np.int64), return_counts=True)
        steps[k].update(dict(zip(value.tolist(), times.tolist(), strict=True)))


def _depth_row(k: int, steps: Counter[int], reasons: Counter[str], scale_mm: float) -> DepthRow:
    pixels = sum(reasons.values())
    ends = ANGLE_EDGES_DEG[k : k + 2]
    return DepthRow(
        name="edges" if k == EDGE else f"{ends[0]} to {ends[1]} deg",
        pixels=pixels,
        reason={name: count / max(pixels, 1) for name, count in reasons.items() if count},
        error=error_figures(dict(steps), scale_mm),
    )
