"""From a stack of pictures to projector pixels to depth, with a reason where there is none."""

from dataclasses import dataclass
from enum import IntEnum
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, UInt8

from .frames import inverse, pixel_grid, transform_points
from .optics import project, rays, undistort
from .pattern import Axis, GrayCode
from .rig import Rig
from .sensor import Capture

DISTORTION_ITERATIONS = 5


class Reason(IntEnum):
    """Why a pixel has no depth; 0 is a pixel that has one."""

    DECODED = 0
    TOO_DARK = 1
    SATURATED = 2
    CONTRADICTORY = 3
    OUTSIDE_PROJECTOR = 4
    OUT_OF_RANGE = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeSpec:
    """What a pixel must show to be believed.

    `min_contrast`: brightest minus darkest frame, as a share of the sensor's range. A bit is
    doubtful where its signal is under `doubt` times that contrast. At any place of a Gray code at
    most one bit is changing, so two doubtful bits of an axis contradict each other; its `fine_bits`
    finest bits do not count: there a pixel may see several stripes and still be right.
    """

    min_contrast: float = 0.02
    doubt: float = 0.15
    fine_bits: int = 3

    def __post_init__(self) -> None:
        if not 0 < self.min_contrast < 1:
            raise ValueError(f"min_contrast is {self.min_contrast}; a share between 0 and 1")
        if not 0 <= self.doubt < 1:
            raise ValueError(f"doubt is {self.doubt}; a share from 0 to 1")
        if self.fine_bits < 0:
            raise ValueError(f"fine_bits is {self.fine_bits}; 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeMap:
    """Which projector pixel each camera pixel sees.

    `column` and `row` are NaN where `reason` is not DECODED and where the code has no such axis.
    `modulation` is brightest minus darkest frame, as a share of the sensor's range.
    """

    column: Float[np.ndarray, "h w"]
    row: Float[np.ndarray, "h w"]
    modulation: Float[np.ndarray, "h w"]
    reason: UInt8[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        for array in (self.column, self.row, self.modulation, self.reason):
            array.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMap:
    """What the scanner measured: z of the camera frame [m], NaN where `reason` is not DECODED."""

    depth_m: Float[np.ndarray, "h w"]
    reason: UInt8[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        self.depth_m.flags.writeable = False
        self.reason.flags.writeable = False


# --- pictures to projector pixels --------------------------------------------------------------


def decode(capture: Capture, code: GrayCode, spec: DecodeSpec) -> CodeMap:
    """Read a Gray-code stack, all frames in one pass over the pixels.

    With inverses a bit is the sign of pattern minus inverse; without, it tells whether a pixel is
    above the middle of its own darkest and brightest frame, as in K. Bai et al. 2024.

    Raises:
        ValueError: the stack has another number of frames than the code.
    """
    plan = _plan(capture, code, spec)
    h, w = capture.frames.shape[1:]
    position = np.full((2, h, w), np.nan, dtype=np.float32)
    modulation = np.empty((h, w), dtype=np.float32)
    reason = np.empty((h, w), dtype=np.uint8)
    _decode(capture.frames, *plan, position, modulation, reason)
    return CodeMap(column=position[0], row=position[1], modulation=modulation, reason=reason)


def decode_plain(capture: Capture, code: GrayCode, spec: DecodeSpec) -> CodeMap:
    """The same as `decode` in plain NumPy, frame by frame, for tests to compare."""
    pairs, counted, sizes, dark_dn, saturation_dn, range_dn, doubt = _plan(capture, code, spec)
    stack = capture.frames.astype(np.int32)
    high, low = stack.max(axis=0), stack.min(axis=0)
    doubtful = np.zeros((2, *high.shape), dtype=int)
    position = np.full((2, *high.shape), np.nan, dtype=np.float32)
    outside = np.zeros(high.shape, dtype=bool)
    for axis, size in enumerate(sizes):
        value = np.zeros(high.shape, dtype=int)
        bit = np.zeros(high.shape, dtype=int)
        for (first, second, of_axis), counts in zip(pairs, counted, strict=True):
            if of_axis != axis:
                continue
            margin = 2 * stack[first] - (high + low)
            if second >= 0:
                margin = stack[first] - stack[second]
            bit = bit ^ (margin > 0)
            value = 2 * value + bit
            doubtful[axis] += counts & (
                np.abs(margin) < np.float32(doubt) * (high - low).astype(np.float32)
            )
        if size:
            position[axis] = value
            outside |= value >= size
    reason = np.select(
        [high - low < dark_dn, high >= saturation_dn, (doubtful >= 2).any(axis=0), outside],
        [Reason.TOO_DARK, Reason.SATURATED, Reason.CONTRADICTORY, Reason.OUTSIDE_PROJECTOR],
        Reason.DECODED,
    ).astype(np.uint8)
    position[:, reason != Reason.DECODED] = np.nan
    modulation = ((high - low) / np.float32(range_dn)).astype(np.float32)
    return CodeMap(column=position[0], row=position[1], modulation=modulation, reason=reason)


def _plan(capture: Capture, code: GrayCode, spec: DecodeSpec) -> tuple:
    """The code as numbers: per bit (frame, inverse frame or -1, axis), coarsest first."""
    frames = code.frames
    if len(capture.frames) != len(frames):
        raise ValueError(
            f"the stack has {len(capture.frames)} frames, the code has {len(frames)}: "
            "another projector size, or inverses missing?"
        )
    index = {frame: k for k, frame in enumerate(frames)}
    pairs, counted = [], []
    for k, frame in enumerate(frames):
        if frame.kind == "gray" and not frame.inverse:
            partner = [
                j
                for f, j in index.items()
                if f.inverse and (f.axis, f.bit) == (frame.axis, frame.bit)
            ]
            pairs.append((k, partner[0] if partner else -1, ("column", "row").index(frame.axis)))
            counted.append(frame.bit >= spec.fine_bits)
    sizes = [code.size_px(axis) if axis in code.axes else 0 for axis in ("column", "row")]
    range_dn = capture.sensor.saturation_dn - capture.sensor.offset_dn
    return (
        np.array(pairs),
        np.array(counted),
        np.array(sizes),
        float(spec.min_contrast * range_dn),
        int(np.floor(capture.sensor.saturation_dn + 0.5)),  # as the sensor rounds
        float(range_dn),
        spec.doubt,
    )


@numba.njit(parallel=True, cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _decode(
    stack,
    pairs,
    counted,
    sizes,
    dark_dn,
    saturation_dn,
    range_dn,
    doubt,
    position,
    modulation,
    reason,
):
    """`decode_plain` row by row: a row of all frames fits in the cache, each loop is SIMD."""
    n, h, w = stack.shape
    per_range = np.float32(range_dn)
    threshold = np.float32(doubt)
    for y in numba.prange(h):
        high = stack[0, y].copy()
        low = stack[0, y].copy()
        for k in range(1, n):
            frame = stack[k, y]
            for x in range(w):
                high[x] = max(high[x], frame[x])
                low[x] = min(low[x], frame[x])
        middle = np.empty(w, dtype=np.int32)
        limit = np.empty(w, dtype=np.float32)
        doubtful = np.zeros((2, w), dtype=np.int32)
        value = np.zeros((2, w), dtype=np.int32)
        for x in range(w):
            middle[x] = np.int32(high[x]) + np.int32(low[x])
            limit[x] = threshold * np.float32(np.int32(high[x]) - np.int32(low[x]))
        for k in range(len(pairs)):
            first = stack[pairs[k, 0], y]
            of_axis = value[pairs[k, 2]]
            doubts = doubtful[pairs[k, 2]]
            count = np.int32(counted[k])
            if pairs[k, 1] >= 0:
                second = stack[pairs[k, 1], y]
                for x in range(w):
                    margin = np.int32(first[x]) - np.int32(second[x])
                    of_axis[x] = (of_axis[x] << 1) | np.int32(margin > 0)
                    doubts[x] += count & np.int32(np.float32(abs(margin)) < limit[x])
            else:
                for x in range(w):
                    margin = 2 * np.int32(first[x]) - middle[x]
                    of_axis[x] = (of_axis[x] << 1) | np.int32(margin > 0)
                    doubts[x] += count & np.int32(np.float32(abs(margin)) < limit[x])
        for x in range(w):
            contrast = np.int32(high[x]) - np.int32(low[x])
            modulation[y, x] = np.float32(contrast) / per_range
            column, row = _binary_from_gray(value[0, x]), _binary_from_gray(value[1, x])
            outside = (sizes[0] > 0 and column >= sizes[0]) or (sizes[1] > 0 and row >= sizes[1])
            if contrast < dark_dn:
                why = 1
            elif high[x] >= saturation_dn:
                why = 2
            elif doubtful[0, x] >= 2 or doubtful[1, x] >= 2:
                why = 3
            elif outside:
                why = 4
            else:
                why = 0
                if sizes[0] > 0:
                    position[0, y, x] = column
                if sizes[1] > 0:
                    position[1, y, x] = row
            reason[y, x] = why


@numba.njit(cache=True)
@no_type_check  # the tests' type checker wraps functions, which numba cannot compile
def _binary_from_gray(gray):
    """Prefix exclusive-or of up to 32 bits."""
    gray ^= gray >> 16
    gray ^= gray >> 8
    gray ^= gray >> 4
    gray ^= gray >> 2
    gray ^= gray >> 1
    return gray


# --- projector pixels to depth -----------------------------------------------------------------


def triangulation_axis(rig: Rig) -> Axis:
    """The projector axis that the baseline runs along; only its code tells depth."""
    camera_in_proj = inverse(rig.T_cam_proj)[:3, 3]
    return "column" if abs(camera_in_proj[0]) >= abs(camera_in_proj[1]) else "row"


def triangulate(codes: CodeMap, rig: Rig) -> DepthMap:
    """Depth where each camera ray meets its projector plane.

    The three linear equations of design: two say that the point is on the pixel's ray,
    `X = x Z`, `Y = y Z`; with them the third, the projector's `(P1 - u P3) (X, Y, Z, 1) = 0`, has
    the one unknown Z. docs/derivations.md, "Triangulation". Distortion is taken off first: the
    camera's from its rays, the projector's from (u, v), v decoded or else iterated.

    Raises:
        ValueError: the code lacks the axis along the baseline, or the sizes do not fit.

    Source: K. Bai et al. 2024, equation of its section III, with u_p in the third row.
    """
    camera = rig.camera
    if codes.column.shape != (camera.height_px, camera.width_px):
        h, w = codes.column.shape
        raise ValueError(
            f"the code map is {w} x {h} px, the rig's camera {camera.width_px} x {camera.height_px}"
        )
    axis = triangulation_axis(rig)
    across = codes.column if axis == "column" else codes.row
    along = codes.row if axis == "column" else codes.column
    decoded = codes.reason == Reason.DECODED
    if decoded.any() and np.isnan(across[decoded]).all():
        raise ValueError(f"the baseline needs the {axis} code; the stack has none")
    ray = rays(camera, pixel_grid(camera.height_px, camera.width_px))
    depth_m = _meet(ray, across, along, rig, axis)
    in_range = (depth_m >= rig.near_m) & (depth_m <= rig.far_m)
    reason = np.where(decoded & ~in_range, np.uint8(Reason.OUT_OF_RANGE), codes.reason)
    depth_m = np.where(reason == Reason.DECODED, depth_m, np.nan).astype(np.float32)
    return DepthMap(depth_m=depth_m, reason=reason)


def _meet(ray, across, along, rig: Rig, axis: Axis) -> Float[np.ndarray, "h w"]:
    projector = rig.projector
    T_proj_cam = inverse(rig.T_cam_proj)
    i = 0 if axis == "column" else 1
    focal = (projector.fx_px, projector.fy_px)
    centre = (projector.cx_px, projector.cy_px)
    ideal = (across.astype(np.float64) - centre[i]) / focal[i]
    if not projector.has_distortion:
        return _depth(ray, ideal, T_proj_cam, i)
    # The distorted coordinate along the plane: as decoded, else from the last depth.
    distorted = ideal
    other = (along.astype(np.float64) - centre[1 - i]) / focal[1 - i]
    decoded = np.isfinite(other)
    depth_m = _depth(ray, ideal, T_proj_cam, i)
    for _ in range(DISTORTION_ITERATIONS):
        point = transform_points(T_proj_cam, ray * depth_m[..., None])
        guess = project(projector, point)[..., 1 - i]
        # What is lit lies in the picture; beyond it, where wrong codes lead, a lens may fold over.
        guess = np.clip(guess, -0.5, (projector.width_px, projector.height_px)[1 - i] - 0.5)
        guess = (guess - centre[1 - i]) / focal[1 - i]
        along_now = np.where(decoded, other, guess)
        pair = (distorted, along_now) if i == 0 else (along_now, distorted)
        xy = np.stack(pair, axis=-1)
        known = np.isfinite(xy).all(axis=-1)
        ideal = np.full(distorted.shape, np.nan)
        ideal[known] = undistort(xy[known], projector.distortion)[:, i]
        depth_m = _depth(ray, ideal, T_proj_cam, i)
    return depth_m


def _depth(ray, ideal, T_proj_cam, i: int) -> Float[np.ndarray, "h w"]:
    """Z of `(R_i - ideal R_3) ray Z + (t_i - ideal t_3) = 0`; not positive or NaN if none."""
    rotation, translation = T_proj_cam[:3, :3], T_proj_cam[:3, 3]
    facing = ray @ rotation[i] - ideal * (ray @ rotation[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        return (ideal * translation[2] - translation[i]) / facing
