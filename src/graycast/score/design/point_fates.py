"""Find, for each surface point of a heap, whether a scanner setting measures it, and why not.

The result for a point is its `Fate`; measured points also have a depth error.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ...base.color import srgb_of_bytes
from ...base.frames import inverse, transform_points
from ...camera.decode import DepthMap, Reason
from ...rendering import GroundTruth
from ...rig.optics import project
from ...world.scene import Layout, Scene
from .heap_surface import HeapSurface, Visibility, obstacles_of, sight

FEATURE_PX = 3
FEATURE_SIGMAS = 3
_DIM = 0.5  # The white frame behind the colours is dimmed by this factor.
_LEGEND_PX = 168


class Fate(StrEnum):
    """The fate of a point on the open surface.

    A point that the camera sees and that has depth is `MEASURED` or `WRONG`. A point without depth
    has a geometric fate if it is hidden or unlit, else the fate of the decoder's reason.
    """

    MEASURED = "measured"
    OUTSIDE_PICTURE = "outside_picture"  # The point is outside the camera's picture.
    HIDDEN_BY_WALL = "hidden_by_wall"  # The bin hides the point from the camera.
    HIDDEN_BY_PARTS = "hidden_by_parts"  # Parts hide the point from the camera, or it faces away.
    OUTSIDE_PROJECTOR = "outside_projector"
    WALL_SHADOW = "wall_shadow"  # The camera sees the point, but the bin blocks the projector.
    PART_SHADOW = "part_shadow"
    EDGE = "edge"  # The centre of the point's pixel shows another surface.
    DARK = "dark"  # The point returns too little light, because it is dark, or glossy and tilted.
    GLARE = "glare"  # The pixel is saturated.
    INTERREFLECTION = "interreflection"  # Light from other surfaces contradicts the code.
    FILTERED = "filtered"  # A filter removed the pixel as an outlier.
    OUT_OF_RANGE = "out_of_range"
    WRONG = "wrong"  # The depth is farther from the truth than the study allows.


FATE_COLOR = {
    Fate.MEASURED: "#dcdad2",
    Fate.OUTSIDE_PICTURE: "#1d6f42",
    Fate.HIDDEN_BY_WALL: "#9aa5b1",
    Fate.HIDDEN_BY_PARTS: "#c8ced6",
    Fate.OUTSIDE_PROJECTOR: "#3b8ea5",
    Fate.WALL_SHADOW: "#25283d",
    Fate.PART_SHADOW: "#565a7a",
    Fate.EDGE: "#d4b483",
    Fate.DARK: "#6b4226",
    Fate.GLARE: "#f2b134",
    Fate.INTERREFLECTION: "#c8385a",
    Fate.FILTERED: "#4f9d69",
    Fate.OUT_OF_RANGE: "#7d5ba6",
    Fate.WRONG: "#e8590c",
}
_OF_REASON = {
    Reason.SHADOW: Fate.DARK,
    Reason.LOW_MODULATION: Fate.DARK,
    Reason.SATURATED: Fate.GLARE,
    Reason.CONTRADICTORY: Fate.INTERREFLECTION,
    Reason.INTERREFLECTION: Fate.INTERREFLECTION,
    Reason.OUTSIDE_PROJECTOR: Fate.OUTSIDE_PROJECTOR,
    Reason.OUT_OF_RANGE: Fate.OUT_OF_RANGE,
    Reason.OUTLIER: Fate.FILTERED,
}
FATES = tuple(Fate)
_NUMBER = {fate: number for number, fate in enumerate(FATES)}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceView:
    """Visibility of a heap's points to camera and projector; it does not depend on the code."""

    camera: Int[np.ndarray, " n"]  # a `Visibility` for each point
    projector: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]  # row of the camera's pixel; 0 for points outside the picture
    column: Int[np.ndarray, " n"]
    z_m: Float[np.ndarray, " n"]  # z in the camera's frame
    z_projector_m: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            getattr(self, name).flags.writeable = False


def view_of(scene: Scene, layout: Layout, surface: HeapSurface) -> SurfaceView:
    """Return the visibility of the surface's points to the scene's camera and projector."""
    obstacles, rig = obstacles_of(scene, layout), scene.rig
    T_world_proj = scene.T_world_cam @ rig.T_cam_proj
    at = transform_points(inverse(scene.T_world_cam), surface.point_m)
    to_projector = transform_points(inverse(T_world_proj), surface.point_m)
    camera = sight(obstacles, rig.camera, scene.T_world_cam, surface.point_m, surface.normal)
    pixel = np.rint(project(rig.camera, at))
    inside = camera != Visibility.OUTSIDE
    # `sight` uses an enlarged picture, whose borders are the same but whose rounding differs.
    last = np.array([rig.camera.width_px - 1, rig.camera.height_px - 1])
    column, row = np.where(inside[:, None], pixel, 0.0).clip(0, last).astype(np.int64).T
    return SurfaceView(
        camera=camera,
        projector=sight(obstacles, rig.projector, T_world_proj, surface.point_m, surface.normal),
        row=row,
        column=column,
        z_m=at[:, 2],
        z_projector_m=to_projector[:, 2],
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PointFates:
    """The fate of each point (an index in `FATES`), and the depth error of measured points [m]."""

    fate: Int[np.ndarray, " n"]
    error_m: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        self.fate.flags.writeable = False
        self.error_m.flags.writeable = False


def judge(
    view: SurfaceView, surface: HeapSurface, truth: GroundTruth, depth: DepthMap, *, wrong_m: float
) -> PointFates:
    """Return the fate and the error of each surface point, from the pixel that sees the point."""
    pixel = (view.row, view.column)
    own = truth.instance[pixel] == surface.instance
    error_m = np.where(own, depth.depth_m[pixel] - truth.depth_m[pixel], np.nan)
    measured = own & (np.abs(error_m) <= wrong_m)
    reason = depth.reason[pixel]
    decided: list[tuple[Fate, Bool[np.ndarray, " n"]]] = [
        (Fate.OUTSIDE_PICTURE, view.camera == Visibility.OUTSIDE),
        (Fate.HIDDEN_BY_WALL, view.camera == Visibility.BY_BIN),
        (Fate.HIDDEN_BY_PARTS, view.camera == Visibility.BY_PARTS),
        (Fate.MEASURED, measured),
        (Fate.OUTSIDE_PROJECTOR, view.projector == Visibility.OUTSIDE),
        (Fate.WALL_SHADOW, view.projector == Visibility.BY_BIN),
        (Fate.PART_SHADOW, view.projector == Visibility.BY_PARTS),
        (Fate.EDGE, ~own),
        *((fate, reason == number) for number, fate in _OF_REASON.items()),
    ]
    fate = np.select(
        [where for _, where in decided],
        [_NUMBER[fate] for fate, _ in decided],
        default=_NUMBER[Fate.WRONG],
    )
    return PointFates(fate=fate, error_m=np.where(fate == _NUMBER[Fate.MEASURED], error_m, np.nan))


def figures(
    scene: Scene, view: SurfaceView, surface: HeapSurface, fates: PointFates, *, seconds: float
) -> dict[str, Any]:
    """Return a setting's figures over a heap's open surface.

    Points are weighted by their `weight`. The following figures are None if nothing was measured.

    `sigma_m` is half the range of the middle 68.3 % of the errors, which ignores a few wrong
    depths, and `bias_m` is their median. `pixel_m` is the median size on the measured surface of a
    pixel of the coarser device. `feature_m` is the side of the smallest cube that is visible on a
    flat surface: it is at least `FEATURE_PX` pixels wide and `FEATURE_SIGMAS` sigma high.
    """
    weight = surface.weight / surface.weight.sum()
    share = dict(zip(FATES, np.bincount(fates.fate, weight, len(FATES)).tolist(), strict=True))
    hidden = (Fate.OUTSIDE_PICTURE, Fate.HIDDEN_BY_WALL, Fate.HIDDEN_BY_PARTS)
    visible = 1 - sum(share[fate] for fate in hidden)
    record: dict[str, Any] = {
        "points": int(surface.opened.sum()),
        "share": {str(name): value for name, value in share.items()},
        "measured": share[Fate.MEASURED],
        "of_seen": share[Fate.MEASURED] / visible if visible > 0 else None,
        "seconds": seconds,
    }
    here = surface.opened & np.isfinite(fates.error_m)
    if not here.any():
        return record | dict.fromkeys(("sigma_m", "bias_m", "pixel_m", "feature_m"))
    low, bias_m, high = _quantiles(fates.error_m[here], weight[here], (0.1587, 0.5, 0.8413))
    sigma_m = (high - low) / 2
    camera, projector = scene.rig.camera, scene.rig.projector
    pixel_m = max(
        _quantiles(z_m[here], weight[here], (0.5,))[0] / min(device.fx_px, device.fy_px)
        for device, z_m in ((camera, view.z_m), (projector, view.z_projector_m))
    )
    return record | {
        "sigma_m": sigma_m,
        "bias_m": bias_m,
        "pixel_m": pixel_m,
        "feature_m": max(FEATURE_PX * pixel_m, FEATURE_SIGMAS * sigma_m),
    }


def _quantiles(
    value: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], shares: tuple[float, ...]
) -> list[float]:
    return np.quantile(value, shares, weights=weight, method="inverted_cdf").tolist()


def picture_png(
    gray: UInt8[np.ndarray, "h w"], view: SurfaceView, surface: HeapSurface, fates: PointFates
) -> bytes:
    """Return a PNG file with the white frame, and with the points of the open surface by fate.

    A point colours 3 x 3 pixels; unmeasured points are drawn over measured ones.
    """
    gray, fate = srgb_of_bytes(gray), fates.fate
    visible = surface.opened & (view.camera == Visibility.VISIBLE)
    order = np.flatnonzero(visible)
    order = order[np.argsort(fate[order] != FATES.index(Fate.MEASURED), kind="stable")]
    ink = np.array([_rgb(FATE_COLOR[name]) for name in FATES], dtype=np.uint8)
    image = np.repeat((gray * _DIM).astype(np.uint8)[..., None], 3, axis=-1)
    for down in (-1, 0, 1):
        for aside in (-1, 0, 1):
            row = (view.row[order] + down).clip(0, gray.shape[0] - 1)
            column = (view.column[order] + aside).clip(0, gray.shape[1] - 1)
            image[row, column] = ink[fate[order]]
    white = np.repeat(gray[..., None], 3, axis=-1)
    whole = np.hstack([white, image, _legend(gray.shape[0], fate[order])])
    return cv2.imencode(".png", np.ascontiguousarray(whole[..., ::-1]))[1].tobytes()


def _legend(height_px: int, fate: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """Return an image of the legend: the fates that occur, with their colours."""
    image = np.full((height_px, _LEGEND_PX, 3), 255, dtype=np.uint8)
    row = 20
    for number in np.unique(fate).tolist():
        name = FATES[number]
        cv2.rectangle(image, (8, row - 10), (20, row + 2), _rgb(FATE_COLOR[name]), -1)
        text = name.replace("_", " ")
        cv2.putText(
            image, text, (28, row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (31, 41, 51), 1, cv2.LINE_AA
        )
        row += 20
    return image


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
