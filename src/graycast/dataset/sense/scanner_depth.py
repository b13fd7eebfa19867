"""The scanner's depth against the perfect one: it errs to both sides.

Errors are counted in projector pixels along the epipolar line, where they have one size for all
rigs and distances: a code without phases is wrong by up to half a pixel either way, and the middle
of many such errors is none.

Leaves out: a shift of one part alone by less than `PART_PX` and half the spread of its errors, 2 mm
for the paper's rig at 0.9 m; noise that is stronger than it should be.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...base.frames import transform_points
from ...rig.optics import project
from .evidence import Evidence

# Sound pictures have medians up to 0.04, one of dark walls alone has 0.07.
PICTURE_PX, PICTURE_LEAST = 0.15, 500
# A part that was moved is off by the same everywhere: the middle half of its errors is as narrow as
# ever, 0.5 for Gray codes. Light that goes astray between parts makes hundreds of pixels wrong to
# one side, too, each otherwise: over 34 pixels in a white bin.
PART_PX, PART_SPREAD_PX, PART_LEAST, PART_SHARE = 0.6, 1.2, 100, 0.5
# A lens of the projector that is bent has an end; a step in depth is measured close to the point.
_NUDGE = 1e-4


def scanner_problems(scene: Evidence) -> Iterator[str]:
    """Scanner depth that lies to one side of the perfect depth."""
    there = (scene.image["depth"] > 0) & (scene.image["depth_sl"] > 0)
    both = there & (scene.sampled | scene.on_part)
    error_px, mm_per_px = _errors(scene, both)
    known = np.isfinite(error_px) & np.isfinite(mm_per_px)
    over_all = known & scene.sampled[both]
    if over_all.sum() < PICTURE_LEAST:
        return
    if not np.any(error_px):
        yield "depth_sl is depth in every pixel: no scanner measures without any error"
    middle = float(np.median(error_px[over_all]))
    if abs(middle) > PICTURE_PX:
        off_mm = middle * float(np.median(mm_per_px[over_all]))
        yield (
            f"depth_sl lies {off_mm:+.2f} mm off depth in the middle of the picture's errors, "
            f"{middle:+.2f} projector pixels; {PICTURE_PX} are allowed"
        )
    instance = scene.instance[both]
    for i in range(len(scene.plain.poses)):
        own = error_px[known & (instance == i)]
        if len(own) < max(PART_LEAST, PART_SHARE * (scene.instance == i).sum()):
            continue
        low, high = np.percentile(own, [25, 75])
        if high - low < PART_SPREAD_PX and (low > PART_PX or high < -PART_PX):
            yield (
                f"instance {i}: depth_sl lies off depth by {low:+.2f} to {high:+.2f} projector "
                f"pixels in the middle half of {len(own)}; {PART_PX} to one side are allowed"
            )


def _errors(
    scene: Evidence, both: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Of each pixel: error along its epipolar line [projector px], and how deep one px is [mm]."""
    scale_m = scene.plain.view.depth_scale / 1e3
    z_m, measured_m = (scene.image[name][both] * scale_m for name in ("depth", "depth_sl"))
    T_proj_cam, ray = scene.rig.T_proj_cam, scene.ray[both]

    def place_at(z: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        return project(scene.rig.projector, transform_points(T_proj_cam, ray * z[:, None]))

    true_px = place_at(z_m)
    along = place_at(z_m * (1 + _NUDGE)) - true_px
    length = np.linalg.norm(along, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        error_px = np.einsum("ni,ni->n", place_at(measured_m) - true_px, along) / length
        return error_px, z_m * _NUDGE * 1e3 / length
