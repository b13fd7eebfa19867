"""Standard deviation of a decoded depth: all of its terms, with their laws and switches.

`TERMS` lists the causes of uncertain depth in the order in which they are added. Terms of a
position are standard deviations of the decoded column or row [projector px]; `triangulate` converts
them to depth by |dz/du|. Terms of a depth are standard deviations of z [m]. Terms are taken as
independent, so their variances add up. Filters are applied between them: smoothing reduces the
noise that is white from pixel to pixel, and comes before the terms `raster` and `bend`. A depth
that `filters.outlier_repair` replaces has the scatter of its neighbours instead of these terms.

The decoder's kernels compute the terms that follow from a pixel's own frames; functions of this
module compute all others.

Leaves out: errors of the calibration, which move many pixels together; interreflected light, which
makes depth wrong rather than uncertain; correlation between terms.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numba
import numpy as np
from jaxtyping import Float
from scipy import special

from ..base.kernels import kernel
from ..rendering import PathNoise
from ..rig.pair import Rig
from ..rig.pattern import AXES, Axis, Code
from .decode import CodeMap, DepthMap, Reason, triangulation_axis
from .decode.plan import AxisPlan, plan_axes


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One cause of uncertain depth.

    `law` is its standard deviation in the symbols of `docs/explanation`, `source` the function that
    computes it, and `zero` the cases or the setting for which it is zero.
    """

    name: str
    of: Literal["position", "depth"]
    law: str
    source: str
    zero: str


TERMS = (
    Term(
        name="sensor noise",
        of="position",
        law="1/sqrt(sum w_g) of periods, c sqrt(sum Q(t_b) D_b^2) of bits",
        source="decode.phases.fuse, decode.bits.read_gray",
        zero="nowhere",
    ),
    Term(
        name="cell",
        of="position",
        law="c/sqrt(12)",
        source="decode.positions.decode",
        zero="in codes with phases",
    ),
    Term(
        name="fine bits",
        of="position",
        law="noise of a bit widened by beta C",
        source="decode.bits.read_gray",
        zero="in codes with phases, and with fine_error 0",
    ),
    Term(
        name="disagreement",
        of="position",
        law="(u_g - u_0) P_0 / sqrt(P_0^2 + P_g^2) beyond 2 sigma of noise",
        source="decode.phases.fuse",
        zero="in codes of one period",
    ),
    Term(
        name="ripple",
        of="position",
        law="P/(2 pi) a/sqrt(2), with J_1(N a) = |mean of exp(i N phi)|",
        source="sigma.ripple_px",
        zero="in codes of several periods, and where light is linear in the grey level",
    ),
    Term(
        name="light paths",
        of="position",
        law="sqrt(place^2 + P^2/(8 pi^2) min(stray, 1)^2)",
        source="sigma.light_path_px",
        zero="in real pictures, and with path_noise None",
    ),
    Term(
        name="line noise",
        of="position",
        law="P/(2 pi) e sqrt(5/(2 N))",
        source="sigma.line_noise_px",
        zero="in real pictures, and with rig.line_noise 0",
    ),
    Term(
        name="speckle",
        of="depth",
        law="C w |grad u| dz/du",
        source="sigma.speckle_m",
        zero="in real pictures, and with rig.speckle_contrast 0",
    ),
    Term(
        name="raster",
        of="depth",
        law="j |grad z|, at most raster_limit_m",
        source="faults.with_faults",
        zero="in real pictures, and with faults.raster_px 0",
    ),
    Term(
        name="bend",
        of="depth",
        law="z^2/4 sqrt(k^2 - 4 sigma_k^2)",
        source="sigma.bend_m",
        zero="on planes, beside gaps and at steps",
    ),
)

RIPPLE_OVER_FLOOR = 2.0  # A ripple below this many times its background counts as chance.
_MOST_RIPPLE = 1.84  # The Bessel function J_1 has its maximum here.
_PHASES = 4096  # The number of bins in the histogram of phases.
BEND_SIGMAS = 2.0  # A bend of less than this many standard deviations may be noise.
# If a step divides a pixel at random, the error has a root mean square of 0.29 of the step, and the
# largest bend at the pixel or its neighbours is 0.75 of the step. A fold makes an error of at most
# 1/8 of the bend. This share is between the two; see docs/measurements/materials.md.
BEND_SHARE = 0.25
# Between points whose slope is steeper, two surfaces meet: a pixel is on one of them, or is wrong.
BEND_STEEPEST_DEG = 75.0
STEP_RATIO = 4.0  # A change of position this many times that on a facing surface is a step.


def with_position_term(
    codes: CodeMap, sigma_px: Mapping[Axis, Float[np.ndarray, "h w"] | float]
) -> CodeMap:
    """Return the same positions, with a term [projector px] added to the sigma of given axes."""
    sums = {
        f"sigma_{axis}": np.hypot(getattr(codes, f"sigma_{axis}"), np.float32(own))
        for axis, own in sigma_px.items()
        if np.ndim(own) or own
    }
    return replace(codes, **sums) if sums else codes


def with_depth_term(depth: DepthMap, sigma_m: Float[np.ndarray, "h w"]) -> DepthMap:
    """Return the same depth with a term [m] added to its sigma."""
    return replace(depth, sigma_m=np.hypot(depth.sigma_m, sigma_m).astype(np.float32))


# --- terms of a position -----------------------------------------------------------------------


def with_ripple(codes: CodeMap, code: Code) -> CodeMap:
    """Return the same positions with the term `ripple`, see `ripple_px`."""
    return with_position_term(codes, ripple_px(codes, code))


def ripple_px(codes: CodeMap, code: Code) -> dict[Axis, float]:
    """Return the ripple of phases in codes with one period, caused by a non-linear projector.

    Light that is not linear in the grey level moves a phase by `a sin(N phi + b)` with N steps. In
    a picture of many periods all true phases are equally frequent, so the histogram of the decoded
    phases shows the ripple: the mean of `exp(i N phi)` has the absolute value `J_1(N a)`. A ripple
    does not affect the means for N - 1 and N + 1, which serve as background; a value that is not
    clearly above it is taken for chance. With several periods, `disagreement` includes this error.

    Leaves out: pictures of about one period, where the background hides a ripple.

    Returns:
        One standard deviation [projector px] for each axis that has exactly one full period.
    """
    return {
        axis: _ripple_px(codes, code, axis, plan)
        for axis, plan in plan_axes(code, fine_bits=0).items()
        if sum(period.full for period in plan.periods) == 1
    }


def _ripple_px(codes: CodeMap, code: Code, axis: Axis, plan: AxisPlan) -> float:
    period = next(period for period in plan.periods if period.full)
    steps = len(period.frames)
    place_px = (codes.column if axis == "column" else codes.row)[codes.reason == Reason.DECODED]
    if code.frames[period.frames[0]].kind != "phase" or not len(place_px):
        return 0.0
    bins = (np.mod(place_px / np.float32(period.period_px), 1) * _PHASES).astype(np.int64) % _PHASES
    occurrence = np.bincount(bins, minlength=_PHASES) / len(place_px)
    below, ripple, above = np.abs(np.fft.rfft(occurrence))[steps - 1 : steps + 2]
    floor = math.hypot(below, above) / math.sqrt(2)
    if ripple <= RIPPLE_OVER_FLOOR * floor:
        return 0.0
    argument = np.linspace(0, _MOST_RIPPLE, 200)
    share = math.sqrt(ripple**2 - floor**2)
    amplitude_rad = np.interp(share, special.j1(argument), argument) / steps
    return float(period.period_px / (2 * math.pi) * amplitude_rad / math.sqrt(2))


def light_path_px(code: Code, noise: PathNoise) -> dict[Axis, Float[np.ndarray, "h w"]]:
    """Return the standard deviation of positions from the noise of rendered light [projector px].

    A phase has the error of the mean position of the direct light. A share s of stray light turns a
    phase by up to s at random, which is `s / sqrt(2) * period / (2 pi)` as a position. A share
    above 1 counts as 1, because such a position is wrong rather than uncertain. Stray light from
    near positions affects all periods equally, but that from distant ones does not: half of the
    variance is taken as common, and half as independent and reduced by averaging. The sigma of a
    Gray code already contains the width of a cell, so the width is subtracted here.
    """
    sigma_px = {}
    for axis, plan in plan_axes(code, fine_bits=0).items():
        i = AXES.index(axis)
        place_px, stray = noise.place_sigma_px[i], np.minimum(noise.stray[i], 1)
        if plan.periods:
            lengths_px = [period.period_px for period in plan.periods if period.full]
            weight = sum(1 / length_px**2 for length_px in lengths_px)
            per_share2 = (min(lengths_px) ** 2 + 1 / weight) / 2 / (8 * math.pi**2)
            variance = place_px**2 + np.float32(per_share2) * stray**2
        else:
            variance = np.maximum(place_px**2 - np.float32(plan.cell_px**2 / 12), 0)
        sigma_px[axis] = np.sqrt(variance)
    return sigma_px


def line_noise_px(code: Code, axis: Axis, share: float) -> float:
    """Return the standard deviation of positions from uneven projector lines [projector px].

    With N steps of a period p, line errors e_k change the phase by
    `-2/N sum e_k (1 + cos t_k) sin t_k` with evenly spaced t_k, so the standard deviation is
    `(p / 2 pi) share sqrt(5 / (2 N))`. Periods are averaged by inverse variance. Without phases: 0.

    Leaves out: combs of lines, which also have a small error.
    """
    plan = plan_axes(code, fine_bits=0).get(axis)
    precision = sum(
        len(period.frames) / period.period_px**2
        for period in (plan.periods if plan else ())
        if period.full and code.frames[period.frames[0]].kind == "phase"
    )
    return share / (2 * math.pi) * math.sqrt(5 / (2 * precision)) if precision else 0.0


# --- terms of a depth --------------------------------------------------------------------------


def speckle_m(
    depth: DepthMap, codes: CodeMap, rig: Rig, off_px: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return the standard deviation of depth [m] from light that is off the centre of its pixel.

    If the centre of light is `off_px` away (one sigma along each axis), the decoded position is
    wrong by `grad u . off`, and depth by `dz/du` times that. The gradient is taken between
    both neighbours; next to steps and holes, it is the gradient of a surface that faces the rig.
    """
    column = triangulation_axis(rig) == "column"
    u, sigma_px = (codes.column, codes.sigma_column) if column else (codes.row, codes.sigma_row)
    lens, other = rig.camera, rig.projector
    facing = other.fx_px / lens.fx_px if column else other.fy_px / lens.fy_px
    along = _gradient(u, 1, facing if column else 0.0, STEP_RATIO * facing)
    across = _gradient(u, 0, 0.0 if column else facing, STEP_RATIO * facing)
    with np.errstate(divide="ignore", invalid="ignore"):
        metres_per_px = depth.sigma_m / sigma_px
        return off_px * np.hypot(along, across) * metres_per_px


def _gradient(
    u: Float[np.ndarray, "h w"], axis: int, facing: float, most: float
) -> Float[np.ndarray, "h w"]:
    """Return the change of a position per pixel along one axis.

    It is `facing` where a neighbour has no position or is on another surface.
    """
    slope = np.full(u.shape, facing, dtype=np.float32)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    middle = 0.5 * (np.roll(u, -1, axis) - np.roll(u, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        slope[inner] = np.where(np.abs(middle) <= most, middle, slope[inner])  # False for NaN
    return slope


def bend_m(depth: DepthMap) -> Float[np.ndarray, "h w"]:
    """Return the standard deviation of depth [m] from a surface that bends within a pixel.

    A pixel sees an area. If a fold or small step crosses this area, the measured depth differs from
    the depth at its centre. A bend is the second difference of inverse depth along a row or column,
    which is 0 on a plane. The largest bend of the pixel and its neighbours counts, less the noise.
    Next to a pixel without depth the bend is unknown and adds nothing. A slope of more than
    `BEND_STEEPEST_DEG` is a step between two surfaces, which is no bend either.
    """
    inverse = 1 / depth.depth_m
    noise2 = np.square(depth.sigma_m * np.square(inverse))
    # Between pixels at the slope t, inverse depth changes by t / (f z).
    steepest = math.tan(math.radians(BEND_STEEPEST_DEG))
    focal_px = np.array([depth.camera.fy_px, depth.camera.fx_px], dtype=np.float32)
    rises = np.float32(steepest) / focal_px
    bend2 = np.zeros((2, *inverse.shape), dtype=np.float32)
    _find_bends(inverse, noise2, np.float32(BEND_SIGMAS**2), rises, bend2)
    sigma_m = np.zeros_like(depth.depth_m)
    _share_of_bends(bend2, depth.depth_m, BEND_SHARE, sigma_m)
    return sigma_m


@kernel(parallel=True)
def _find_bends(inverse, noise2, sigmas2, rises, bend2):
    """Write the squared bend along the column and the row at each pixel, minus the noise.

    Args:
        rises: the largest changes of inverse depth to the next pixel below and to the right, as
            shares of inverse depth.
    """
    h, w = inverse.shape
    for y in numba.prange(h):
        for axis, down, right in ((0, 1, 0), (1, 0, 1)):
            if down <= y < h - down:
                for x in range(right, w - right):
                    own, own2 = inverse[y, x], noise2[y, x]
                    before, after = inverse[y - down, x - right], inverse[y + down, x + right]
                    before2, after2 = noise2[y - down, x - right], noise2[y + down, x + right]
                    bend = before + after - 2 * own
                    beyond = bend * bend - sigmas2 * (before2 + after2 + 4 * own2)
                    if not beyond > 0:  # True for NaN
                        continue
                    rise = rises[axis] * own
                    first, second = abs(before - own) - rise, abs(after - own) - rise
                    if (first > 0 and first * first > sigmas2 * (before2 + own2)) or (
                        second > 0 and second * second > sigmas2 * (after2 + own2)
                    ):
                        continue
                    bend2[axis, y, x] = beyond


@kernel(parallel=True)
def _share_of_bends(bend2, depth, share, sigma):
    h, w = depth.shape
    for y in numba.prange(h):
        above, below = max(y - 1, 0), min(y + 1, h - 1)
        for x in range(w):
            left, right = max(x - 1, 0), min(x + 1, w - 1)
            largest2 = max(bend2[1, y, left], bend2[1, y, x], bend2[1, y, right])
            largest2 = max(largest2, bend2[0, above, x], bend2[0, y, x], bend2[0, below, x])
            if largest2 > 0:
                sigma[y, x] = share * math.sqrt(largest2) * depth[y, x] * depth[y, x]
