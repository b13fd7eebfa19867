"""Camera frames of a projected code, computed in one dimension in closed form, with noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import fftconvolve

from graycast.camera.decode import Levels
from graycast.rig.pattern import AXES, Axis, Code, Frame, level_share

LEVELS = Levels(offset_dn=64.0, saturation_dn=4000.0, floor_dn2=1.2**2 + 1 / 12, slope_dn=0.39)
FINE = 32  # samples per projector pixel


def two_phases(
    width_px: int,
    height_px: int,
    *,
    gray_cell_px: float,
    periods_px: Sequence[float],
    steps: int = 3,
    bits: int | None = None,
) -> Code:
    """Return a code of columns: phases of the given periods, and coarse Gray bits with inverses."""
    if bits is None:
        bits = int(np.ceil(np.log2(width_px / gray_cell_px)))
    phases = [
        Frame(kind="phase", axis="column", period_px=period_px, step=step, steps=steps)
        for period_px in periods_px
        for step in range(steps)
    ]
    gray = [
        Frame(kind="gray", axis="column", bit=bit, inverse=inverse)
        for bit in reversed(range(bits))
        for inverse in (False, True)
    ]
    return Code(
        width_px=width_px,
        height_px=height_px,
        frames=(*phases, *gray),
        stride_px=(gray_cell_px, gray_cell_px),
    )


def share_of_white(
    code: Code,
    column: Float[np.ndarray, "h w"],
    row: Float[np.ndarray, "h w"] | None = None,
    *,
    camera_px: float = 1.5,
    disc_px: float = 1.0,
) -> Float[np.ndarray, "n h w"]:
    """Return the light of each frame at projector positions (h, w), as a share of white light.

    Without `row`, `column` is the position along the code's only axis.

    A camera pixel covers `camera_px` of the projector's square pixels, and the projector blurs to
    discs of radius `disc_px`; a value of 0 turns either effect off. There is no light beyond the
    projector's first and last pixel.
    """
    kernel = _blur(camera_px, disc_px)
    places: dict[Axis, Float[np.ndarray, "h w"]] = {"column": column}
    if row is not None:
        places["row"] = row
    if row is None and code.axes == ("row",):
        places = {"row": column}

    margin = 4 + len(kernel) // FINE
    between = {}  # Sample and fraction of each place, computed once for the interpolation.
    for axis, place_px in places.items():
        last = FINE * (code.size_px(axis) + 2 * margin) - 1
        at = np.clip(FINE * (place_px + margin + 0.5) - 0.5, 0, last)
        left = np.minimum(at.astype(np.int64), last - 1)
        between[axis] = left, at - left

    def image_of(axis: Axis, share: float | Float[np.ndarray, " size"]) -> Float[np.ndarray, "h w"]:
        fine = np.repeat(np.pad(np.broadcast_to(share, code.size_px(axis)), margin), FINE)
        curve = fftconvolve(fine, kernel, mode="same")
        left, rest = between[axis]
        return curve[left] + rest * (curve[left + 1] - curve[left])

    lit = {axis: image_of(axis, 1.0) for axis in places}
    out = []
    for frame in code.frames:
        total = np.full(column.shape, float(frame.kind != "black"))
        for axis, i in zip(AXES, (0, 1), strict=True):
            if axis in places and frame.axis != axis:
                total = total * lit[axis]
            elif axis in places:
                place = {"offset_px": code.offset_px[i], "stride_px": code.stride_px[i]}
                total = total * image_of(axis, level_share(frame, code.size_px(axis), **place))
        out.append(total)
    return np.clip(np.array(out), 0, 1)


def _blur(camera_px: float, disc_px: float) -> Float[np.ndarray, " n"]:
    reach = FINE * int(np.ceil(camera_px / 2 + disc_px + 1))
    t = np.arange(-reach, reach + 1) / FINE
    spike = (t == 0).astype(float)
    box = (np.abs(t) <= camera_px / 2).astype(float) if camera_px else spike
    disc = np.sqrt(np.maximum(disc_px**2 - t**2, 0)) if disc_px else spike
    kernel = fftconvolve(box / box.sum(), disc / disc.sum(), mode="same")
    return kernel / kernel.sum()


def frames_of(
    light_dn: Float[np.ndarray, "n h w"],
    rng: np.random.Generator | None = None,
    *,
    levels: Levels = LEVELS,
    dtype: type[np.unsignedinteger] = np.uint16,
) -> np.ndarray:
    """Return camera frames for light [DN above offset], rounded, with the noise of `levels`."""
    mean = levels.offset_dn + light_dn
    if rng is not None:
        variance = levels.floor_dn2 - 1 / 12 + levels.slope_dn * light_dn
        mean = mean + rng.normal(size=mean.shape) * np.sqrt(np.maximum(variance, 0))
    return np.clip(np.round(mean), 0, np.iinfo(dtype).max).astype(dtype)


def crisp(
    code: Code,
    column: Int[np.ndarray, "h w"],
    row: Int[np.ndarray, "h w"] | None = None,
    *,
    dark: float = 20,
    bright: float = 200,
    dtype: type[np.unsignedinteger] = np.uint8,
) -> np.ndarray:
    """Return a stack without noise; each camera pixel sees exactly one projector pixel."""
    row = np.zeros(column.shape, dtype=int) if row is None else row
    share = code.render()[:, row, column] / 255
    return np.ascontiguousarray(np.round(dark + (bright - dark) * share)).astype(dtype)
