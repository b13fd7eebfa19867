"""Compute the figures of one scene, which are small and can be stored as JSON."""

import numpy as np
from jaxtyping import Bool, Int, UInt8
from pydantic import BaseModel, ConfigDict

from ...camera.decode import pooled_shares
from ..read.scene_content import SceneContent

DEPTH_BIN_MM = 10.0
_LUMA = np.array([0.2126, 0.7152, 0.0722])
ERROR_LIMIT_STEPS = 20000  # Larger errors are clipped: 20000 steps of 0.1 mm are 2 m.


class SceneFigures(BaseModel):
    """Counts of one picture; dictionaries are histograms without empty bins.

    `picture` is the picture's name in its scene, or empty if the scene has only one picture.

    Four lists have an entry per instance, in the order of `scene_gt.json`: `obj_id`, `visib_fract`
    (None if unknown), `area_px` of the visible mask, and `box_px` (columns and rows of the visible
    box, 0 if nothing is visible). `depth_bin` counts pixels by perfect depth in bins of 10 mm.
    `error_step` counts scanner minus perfect depth in steps of `depth_scale_mm`, over pixels with
    both; `part_` means over visible parts only. `gray` is the white frame and `luma` the colour
    picture (Rec. 709 weights on sRGB), both from 0 to 255.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    split: str
    scene_id: int
    picture: str = ""
    width_px: int
    height_px: int
    depth_scale_mm: float
    obj_id: tuple[int, ...]
    visib_fract: tuple[float | None, ...]
    area_px: tuple[int, ...]
    box_px: tuple[tuple[int, int], ...]
    depth_bin: dict[int, int]
    reason_px: dict[str, int]
    part_reason_px: dict[str, int]
    error_step: dict[int, int]
    part_error_step: dict[int, int]
    gray: dict[int, int]
    luma: dict[int, int]

    @property
    def pixels(self) -> int:
        return self.width_px * self.height_px

    @property
    def reasons(self) -> dict[str, float]:
        """Share of all pixels with each reason."""
        return pooled_shares([self.reason_px])

    @property
    def part_reasons(self) -> dict[str, float]:
        """Share of the parts' visible pixels with each reason; empty if no part is visible."""
        return pooled_shares([self.part_reason_px])


def scene_figures(scene: SceneContent) -> SceneFigures:
    """Return the counts of one scene."""
    on_part = scene.label >= 0
    height_px, width_px = on_part.shape
    error_step, part_error_step = _error_counts(scene, on_part)
    return SceneFigures(
        split=scene.stored.split,
        scene_id=scene.stored.scene_id,
        picture=scene.stored.image_name if scene.stored.of > 1 else "",
        width_px=width_px,
        height_px=height_px,
        depth_scale_mm=scene.depth_scale_mm,
        obj_id=tuple(one.obj_id for one in scene.instances),
        visib_fract=tuple(one.visib_fract for one in scene.instances),
        area_px=tuple(one.area_px for one in scene.instances),
        box_px=tuple((one.box[2] + 1, one.box[3] + 1) for one in scene.instances),
        depth_bin=_depth_counts(scene),
        reason_px=_reason_counts(scene, scene.reason.ravel()),
        part_reason_px=_reason_counts(scene, scene.reason[on_part]),
        error_step=error_step,
        part_error_step=part_error_step,
        gray={} if scene.gray is None else _counts(np.bincount(scene.gray.ravel())),
        luma={} if scene.rgb is None else _counts(np.bincount(_luma(scene.rgb).ravel())),
    )


def _counts(counts: Int[np.ndarray, " n"], low: int = 0) -> dict[int, int]:
    """Return a histogram without its empty bins; `low` is the value of the first bin."""
    used = np.flatnonzero(counts)
    return dict(zip((used + low).tolist(), counts[used].tolist(), strict=True))


def _luma(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    return np.rint(rgb @ _LUMA).astype(np.uint8)


def _depth_counts(scene: SceneContent) -> dict[int, int]:
    if scene.depth is None:
        return {}
    of_step = np.bincount(scene.depth.ravel())
    step = np.flatnonzero(of_step[1:]) + 1
    depth_bin = (step * (scene.depth_scale_mm / DEPTH_BIN_MM)).astype(np.int64)
    return _counts(np.bincount(depth_bin, of_step[step]).astype(np.int64))


def _reason_counts(scene: SceneContent, reason: UInt8[np.ndarray, " n"]) -> dict[str, int]:
    counts = np.bincount(reason, minlength=256)
    return {name: int(counts[number]) for number, name in sorted(scene.reason_name.items())}


def _error_counts(
    scene: SceneContent, on_part: Bool[np.ndarray, "h w"]
) -> tuple[dict[int, int], dict[int, int]]:
    """Return the histogram of the errors of all pixels, and that of the parts' pixels."""
    if scene.depth is None or scene.scanner is None:
        return {}, {}
    both = np.flatnonzero((scene.depth > 0) & (scene.scanner > 0))
    step = scene.scanner.take(both).astype(np.int32) - scene.depth.take(both)
    low = -ERROR_LIMIT_STEPS
    bins = step.clip(low, ERROR_LIMIT_STEPS) - low
    of_parts = bins[on_part.take(both)]
    return _counts(np.bincount(bins), low), _counts(np.bincount(of_parts), low)
