"""Standard deviation of a decoded depth: all of its terms, each with its law and its switch.

A depth is uncertain for the reasons in `TERMS`, in the order in which they are added. Terms of a
position are standard deviations of the decoded column or row [projector px]; `triangulate` carries
them to depth by |dz/du|. Terms of a depth are standard deviations of z [m]. Terms are independent,
so their variances add. Filters act between them: smoothing lowers what is white from pixel to
pixel, and is applied before the terms `raster` and `bend`.

The decoder has the terms that follow from a pixel's own frames in its kernels; all others are
functions of this module.

Leaves out: errors of the calibration, which move many pixels alike; interreflected light, which
makes wrong depth rather than uncertain depth; errors of two terms that are not independent.
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
    """One reason for which a depth is uncertain.

    `law` is its standard deviation in the symbols of `docs/explanation`, `source` the function that
    computes it, and `zero` says where, or by which setting, it is zero.
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
        law="sqrt(place^2 + P^2/(8 pi^2) stray^2)",
        source="sigma.light_path_px",
        zero="in real pictures, and with path_noise None",
    ),
    Term(
        name="line noise",
        of="position",
        law="P/(2 pi) e sqrt(5/(2 N))",
        source="sigma.line_noise_px",
        zero="with rig.line_noise 0",
    ),
    Term(
        name="speckle",
        of="depth",
        law="C w |grad u| dz/du",
        source="sigma.speckle_m",
        zero="with rig.speckle_contrast 0",
    ),
    Term(
        name="raster",
        of="depth",
        law="j |grad z|, at most raster_limit_m",
        source="faults.with_faults",
        zero="with faults.raster_px 0",
    ),
    Term(
        name="bend",
        of="depth",
        law="z^2/4 sqrt(k^2 - 4 sigma_k^2)",
        source="sigma.bend_m",
        zero="on planes and beside gaps",
    ),
)

RIPPLE_OVER_FLOOR = 2.0  # A ripple of less than this many times its background is chance.
_MOST_RIPPLE = 1.84  # The Bessel function J_1 rises up to here.
_PHASES = 4096  # So many phases are told apart in their histogram.
BEND_SIGMAS = 2.0  # A bend of less than this many standard deviations may be noise.
# A pixel that a step divides at random is off by a root mean square of 0.29 of the step, of which
# the largest of the bends at it and beside it is 0.75; a fold through it is off by an eighth at
# most. This share is between the two. docs/measurements/materials.md has what it makes of sigma.
BEND_SHARE = 0.25
STEP_RATIO = 4.0  # A position that rises this much faster than on a facing surface is a step.


def with_position_term(
    codes: CodeMap, sigma_px: Mapping[Axis, Float[np.ndarray, "h w"] | float]
) -> CodeMap:
    """Return the same positions with one more term [projector px] in the sigma of some axes."""
    sums = {
        f"sigma_{axis}": np.hypot(getattr(codes, f"sigma_{axis}"), np.float32(own))
        for axis, own in sigma_px.items()
        if np.ndim(own) or own
    }
    return replace(codes, **sums) if sums else codes


def with_depth_term(depth: DepthMap, sigma_m: Float[np.ndarray, "h w"]) -> DepthMap:
    """Return the same depth with one more term [m] in its sigma."""
    return replace(depth, sigma_m=np.hypot(depth.sigma_m, sigma_m).astype(np.float32))


# --- terms of a position -----------------------------------------------------------------------


def with_ripple(codes: CodeMap, code: Code) -> CodeMap:
    """Return the same positions with the term `ripple`, see `ripple_px`."""
    return with_position_term(codes, ripple_px(codes, code))


def ripple_px(codes: CodeMap, code: Code) -> dict[Axis, float]:
    """Return the ripple of codes of one period: light that is not linear in the grey level.

    Such light moves a phase by `a sin(N phi + b)` with N steps. A picture of many periods shows all
    phases equally often, so the ripple is seen in how often the decoded ones occur: the mean of
    `exp(i N phi)` has the absolute value `J_1(N a)`. The means for N - 1 and N + 1, which no ripple
    makes, are its background: what is not clearly above it is taken for chance. Codes of several
    periods have this error in the term `disagreement`.

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
    """Return what a finite number of paths makes of decoded positions, one sigma [projector px].

    A phase has the error of the mean place of straight light. Stray stripes of a share s turn it by
    up to s, at random, which is `s / sqrt(2) * period / (2 pi)` of place. Several periods share
    the stray light of near places and not that of distant ones: half of its variance is taken as
    common to them, and of the other half their mean has what independent ones leave. A Gray code's
    own sigma has the width of a cell, which the mean place has, too.
    """
    sigma_px = {}
    for axis, plan in plan_axes(code, fine_bits=0).items():
        i = AXES.index(axis)
        place_px, stray = noise.place_sigma_px[i], noise.stray[i]
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
    """Return what uneven projector lines make of a decoded position, one sigma [projector px].

    With N steps of a period p the phase is off by `-2/N sum e_k (1 + cos t_k) sin t_k`, t_k evenly
    spread and e_k the errors: `(p / 2 pi) share sqrt(5 / (2 N))`. Several periods are averaged,
    each with a weight of one over this squared. Codes without phases have 0.

    Leaves out: combs of lines, which lose a little, too.
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
    """Return the standard deviation of depth [m] by light that is off the centre of its pixel.

    A centre that lies `off_px` aside (one sigma along either axis) shows the position decoded
    there, `grad u . off`, and depth is wrong by `dz/du` times that. The gradient is taken between
    both neighbours; beside steps and holes it is that of a surface that faces the rig.
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
    """Return a position's change per pixel along one axis.

    It is `facing` where the neighbours have no position or lie on another surface.
    """
    slope = np.full(u.shape, facing, dtype=np.float32)
    inner = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
    middle = 0.5 * (np.roll(u, -1, axis) - np.roll(u, 1, axis))[inner]
    with np.errstate(invalid="ignore"):
        slope[inner] = np.where(np.abs(middle) <= most, middle, slope[inner])  # NaN is not <=
    return slope


def bend_m(depth: DepthMap) -> Float[np.ndarray, "h w"]:
    """Return the standard deviation of depth [m] by a surface that bends within a pixel.

    A pixel sees an area, and the depth at its centre differs from what it sees where a fold or a
    small step crosses it. The bend is the second difference of inverse depth along a row or column,
    which is 0 on a plane: the largest one of the pixel and its two neighbours, beyond noise.
    Beside a pixel without depth the bend is not known and adds nothing.
    """
    inverse = 1 / depth.depth_m
    noise2 = np.square(depth.sigma_m * np.square(inverse))
    bend2 = np.zeros((2, *inverse.shape), dtype=np.float32)
    _find_bends(inverse, noise2, BEND_SIGMAS**2, bend2)
    sigma_m = np.zeros_like(depth.depth_m)
    _share_of_bends(bend2, depth.depth_m, BEND_SHARE, sigma_m)
    return sigma_m


@kernel(parallel=True)
def _find_bends(inverse, noise2, sigmas2, bend2):
    """Write the square of the bend along the row and the column at each pixel, less noise."""
    h, w = inverse.shape
    for y in numba.prange(h):
        for axis, down, right in ((0, 0, 1), (1, 1, 0)):
            if down <= y < h - down:
                for x in range(right, w - right):
                    before, after = (y - down, x - right), (y + down, x + right)
                    bend = inverse[before] + inverse[after] - 2 * inverse[y, x]
                    noise = noise2[before] + noise2[after] + 4 * noise2[y, x]
                    beyond = bend * bend - sigmas2 * noise
                    bend2[axis, y, x] = beyond if beyond > 0 else 0  # 0 for NaN


@kernel(parallel=True)
def _share_of_bends(bend2, depth, share, sigma):
    h, w = depth.shape
    for y in numba.prange(h):
        above, below = max(y - 1, 0), min(y + 1, h - 1)
        for x in range(w):
            left, right = max(x - 1, 0), min(x + 1, w - 1)
            largest2 = max(bend2[0, y, left], bend2[0, y, x], bend2[0, y, right])
            largest2 = max(largest2, bend2[1, above, x], bend2[1, y, x], bend2[1, below, x])
            if largest2 > 0:
                sigma[y, x] = share * math.sqrt(largest2) * depth[y, x] * depth[y, x]
