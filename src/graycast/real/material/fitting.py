"""Fit of base colour and roughness to the light that a surface reflects at many angles.

The model is the renderer's own BSDF. Its value at a pixel is the mean over the uncertain normal, so
that noise of the normals is not mistaken for roughness. Residuals follow Student's t distribution,
because some pixels have interreflected light or a wrong normal:

    (light - k m) / sqrt(sigma^2 + k^2 (s^2 m^2 + v)) ~ t(4),

with the mean m and the variance v over the normals, the scale k between light and BSDF, and the
relative scatter s. A clipped pixel counts with the probability of being at least as bright.
Intervals are those of the profile likelihood. The likelihood counts windows of normals, not pixels,
because pixels that share a normal err together.

Leaves out: grooves, films, glass, and stripes reflected by mirrors, which count as direct light.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy import optimize

from ...base.errors import GraycastError
from ...base.public_value import public_value
from ...world.parts import Material
from .observing import Reflections
from .surface_model import (
    KINDS,
    METAL_COLOR,
    SCALE_SIGMA,
    Kind,
    SurfaceModel,
    color_weights,
    surface,
)

MOST_PIXELS = 1500  # More pixels do not narrow the intervals, because they share normals.
BINS = 12  # Pixels are drawn evenly from this many bins of half angle.
COARSE = (0.05, 0.1, 0.175, 0.25, 0.325, 0.4, 0.475, 0.55, 0.625, 0.7, 0.775, 0.85, 0.925, 1.0)
FINE_STEPS, FINE_SPAN = (0.025, 0.01, 0.0025), 4  # Steps of roughness, and their number
LIKELY = 7  # This many likely values of roughness give a smooth profile.
LEAST = 0.03  # Smaller values of roughness look equal with the normals of a scan.
# Limits of the base colour. No bare metal reflects less than 0.2, as black plastic does.
DARKEST: Mapping[Kind, float] = {"metal": 0.2, "plastic": 0.002, "scattering metal": 0.002}
BRIGHTEST = 0.998
LIMIT = 1.92  # Half of the 95 % quantile of chi squared with one degree of freedom.
FEWEST = 100
MOST_SCATTER = 0.5  # No opaque material alone has a larger relative scatter.
# At this many times the width alpha, GGX has 4 % of its peak, and indirect light is as strong.
TAIL = 2.0
BRIGHT_SHARE = 0.05  # As large a share of saturated pixels shows that there is a highlight.
WIDE = 0.3  # A wider interval of roughness is no result.
# A smooth surface with larger shares of dark and of saturated pixels mirrors like polished metal.
MIRROR_DARK, MIRROR_SATURATED, MIRROR_ROUGHNESS = 0.05, 0.01, 0.375


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class FittedValue:
    """A value with the limits of its 95 % interval."""

    value: float
    low: float
    high: float


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialFit:
    """A fitted surface.

    `color` is the base colour at the projector's wavelength. `scale` is the light of a BSDF of 1
    per steradian; it is `known` from a reference, or fitted. `scatter` is the relative spread of
    the light of single pixels: grain, speckle and uneven normals. `lead` is the difference of log
    likelihoods by which `kind` is preferred to the other kind; it is infinite for a known kind.
    `diffuse` is the share of the light that a metal scatters in all directions, if it was fitted.
    """

    kind: Kind
    color: FittedValue
    roughness: FittedValue
    scale: float
    known: bool
    scatter: float
    lead: float
    pixels: int
    angles_rad: tuple[float, float]  # 2nd and 98th percentile of the half angle
    diffuse: FittedValue | None = None

    @property
    def material(self) -> Material:
        own = surface(self.kind, self.color.value, self.roughness.value)
        return own if self.diffuse is None else replace(own, diffuse=self.diffuse.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Curve:
    """The best fit at one roughness."""

    roughness: float
    score: float  # Log likelihood
    color: float
    scale: float
    scatter: float


def fit_material(
    observations: Reflections,
    *,
    scale: float | None = None,
    metal: bool = False,
    seed: int,
) -> MaterialFit:
    """Fit kind, base colour and roughness to the observations of one surface.

    Args:
        scale: see `MaterialFit.scale` and `scale_of`; None fits the scale as well.
        metal: whether the surface is known to be metal. Only then is its scattered share fitted,
            because without a known scale the light of plastic has the same shape.
        seed: seed for the choice of pixels.

    Raises:
        GraycastError: the pixels are too few, show no highlight, or fit no opaque material.
    """
    if len(observations) < FEWEST:
        raise GraycastError(
            f"only {len(observations)} pixels have a depth, a normal and enough light, and a fit "
            f"needs {FEWEST}: take a longer exposure; a mirror and clear glass cannot be fitted"
        )
    subset, windows = _choose(observations, np.random.default_rng(seed))
    weight = min(1.0, windows / len(subset))
    if metal:
        return _scattering(SurfaceModel(subset, None, weight), observations, scale)
    model = SurfaceModel(subset, scale, weight)
    fits = {kind: _search(model, kind) for kind in KINDS}
    best = {kind: max(curves, key=lambda one: one.score) for kind, curves in fits.items()}
    kind = max(KINDS, key=lambda one: best[one].score)
    other = next(one for one in KINDS if one != kind)
    curves, top = fits[kind], best[kind]
    return MaterialFit(
        kind=kind,
        color=_color_interval(model, kind, curves),
        roughness=_interval([c.roughness for c in curves], [c.score for c in curves]),
        scale=top.scale,
        known=scale is not None,
        scatter=top.scatter,
        lead=top.score - best[other].score,
        pixels=len(observations),
        angles_rad=_angle_range(observations, top),
    )


def _scattering(model: SurfaceModel, observations: Reflections, scale: float | None) -> MaterialFit:
    """Fit roughness and scattered share of a metal; a known scale gives the base colour.

    The base colour multiplies the light, and follows from the fitted scale over the known one.
    """
    curves = _search(model, "scattering metal")
    top = max(curves, key=lambda one: one.score)
    likely = [one.scale for one in curves if one.score > top.score - LIMIT]
    color = FittedValue(value=METAL_COLOR, low=DARKEST["metal"], high=1.0)
    if scale is not None:
        value, low, high = (
            METAL_COLOR * one / scale for one in (top.scale, min(likely), max(likely))
        )
        sure = 1.96 * SCALE_SIGMA
        color = FittedValue(
            value=min(value, BRIGHTEST),
            low=min(low * (1 - sure), 1.0),
            high=min(high * (1 + sure), 1.0),
        )
    return MaterialFit(
        kind="metal",
        color=color,
        roughness=_interval([c.roughness for c in curves], [c.score for c in curves]),
        scale=top.scale if scale is None else scale,
        known=scale is not None,
        scatter=top.scatter,
        lead=math.inf,
        pixels=len(observations),
        angles_rad=_angle_range(observations, top),
        diffuse=_color_interval(model, "scattering metal", curves),
    )


def _angle_range(observations: Reflections, top: _Curve) -> tuple[float, float]:
    """Return the 2nd and 98th percentile of the half angle, if they determine the best fit.

    Raises:
        GraycastError: no pixel shows the highlight, the surface is polished, or the light is that
            of no opaque material.
    """
    dark, saturated = observations.dark_share, observations.saturated_share
    if top.roughness < MIRROR_ROUGHNESS and dark > MIRROR_DARK and saturated > MIRROR_SATURATED:
        raise GraycastError(
            f"{dark:.0%} of the pixels return no light and {saturated:.0%} are saturated, as on "
            "polished metal, whose highlight a scan does not show: choose a material by name; or "
            "mark only pixels that the projector reaches, if shadows are the cause"
        )
    if top.scatter > MOST_SCATTER:
        raise GraycastError(
            f"the light of the pixels scatters by {top.scatter:.0%} about any opaque material: "
            "they may show several materials, glass, grooves or a mirror; mark one with a mask"
        )
    low, high = np.percentile(observations.half_angle_rad, [2, 98])
    if low > TAIL * top.roughness**2 and observations.clipped.mean() < BRIGHT_SHARE:
        raise GraycastError(
            f"no pixel shows the highlight: half angles begin at {math.degrees(low):.0f} degrees, "
            "and the surface is polished like a mirror: scan parts that lie in more directions"
        )
    return float(low), float(high)


def scale_of(white: Reflections, reflectance: float) -> float:
    """Return the scale from pixels of a matt surface with a known reflectance.

    Raises:
        GraycastError: the pixels are too few.
    """
    white = white.part(np.flatnonzero(~white.clipped))
    if len(white) < FEWEST:
        raise GraycastError(
            f"only {len(white)} pixels of the white reference are decoded and not saturated, and "
            f"{FEWEST} are needed: mark a larger area, or shorten the exposure"
        )
    return float(np.median(white.light / white.light_cosine) * math.pi / reflectance)


def _choose(observations: Reflections, rng: np.random.Generator) -> tuple[Reflections, float]:
    """Return at most MOST_PIXELS pixels, spread evenly over half angles, and the number of windows.

    A window is the set of pixels from which one normal was fitted, so the number of windows, the
    sum of `1 / area_px` over all observations, estimates how many of them are independent.
    """
    angle = observations.half_angle_rad
    place = (angle / (angle.max() + 1e-9) * BINS).astype(int)
    members = [rng.permutation(np.flatnonzero(place == b)) for b in range(BINS)]
    most = MOST_PIXELS // BINS
    left = MOST_PIXELS
    index = []
    for number, group in enumerate(sorted(members, key=len)):
        most = left // (BINS - number)
        index.append(group[:most])
        left -= len(index[-1])
    subset = observations.part(np.concatenate(index))
    return subset, float((1 / observations.area_px).sum())


def _search(model: SurfaceModel, kind: Kind) -> list[_Curve]:
    """Return the best fits at many values of roughness, in rising order.

    The steps become finer around the best value, until several values are likely.
    """
    curves = {value: _best_at(model, kind, value) for value in COARSE}
    for step in FINE_STEPS:
        best = max(curves.values(), key=lambda one: one.score)
        likely = [one for one in curves.values() if one.score > best.score - 2 * LIMIT]
        if len(likely) >= LIKELY:
            break
        around = best.roughness + step * np.arange(-FINE_SPAN, FINE_SPAN + 1)
        for value in np.round(around, 6).tolist():
            if LEAST <= value <= 1 and value not in curves:
                curves[value] = _best_at(model, kind, value)
    return [curves[value] for value in sorted(curves)]


def _best_at(
    model: SurfaceModel, kind: Kind, roughness: float, color: float | None = None
) -> _Curve:
    """Fit scatter and scale at one roughness, and the colour if `color` is None."""
    nodes, light = model.nodes(kind, roughness), model.observations.light
    bounds = [(-5.0, 1.0), (-25.0, 40.0)]
    bounds += [] if color is not None else [(_logit(DARKEST[kind]), _logit(BRIGHTEST))]

    def curve(x: Float[np.ndarray, " n"]) -> _Curve:
        own = color if color is not None else 1 / (1 + math.exp(-x[2]))
        scatter, scale = math.exp(x[0]), math.exp(x[1])
        score = model.score(nodes, own, scale, scatter)
        return _Curve(roughness=roughness, score=score, color=own, scale=scale, scatter=scatter)

    def loss(x: Float[np.ndarray, " n"]) -> float:
        return -curve(x).score

    results = []
    for first in (color,) if color is not None else (DARKEST[kind] + 0.1, 0.7):
        mean = np.maximum(np.tensordot(color_weights(first), nodes, axes=1)[0], 1e-9)
        scale = model.scale or float(np.median(light / mean))
        start = [math.log(0.15), math.log(scale)]
        start += [] if color is not None else [_logit(first)]
        # Nelder and Mead's method is faster here than any that uses the threads of BLAS.
        result = optimize.minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": 2e-3, "fatol": 0.01, "initial_simplex": _simplex(start)},
        )
        results.append(curve(result.x))
    return max(results, key=lambda one: one.score)


def _logit(share: float) -> float:
    return math.log(share / (1 - share))


def _simplex(start: Sequence[float]) -> Float[np.ndarray, "points n"]:
    """Return a start and, for each of its numbers, a point at a distance that suits logarithms."""
    return np.vstack([start, start + 0.2 * np.eye(len(start))])


# --- intervals ---------------------------------------------------------------------------------


def _interval(values: Sequence[float], scores: Sequence[float]) -> FittedValue:
    """Return the value with the highest score, and the values at which scores cross the limit.

    Values must rise. The peak is that of a parabola through the best point and its neighbours.
    """
    x, y = np.array(values), np.array(scores)
    top = int(y.argmax())
    value, peak = float(x[top]), float(y[top])
    if 0 < top < len(x) - 1:
        near = slice(top - 1, top + 2)
        bend, slope, _ = np.polyfit(x[near] - x[top], y[near] - y[top], 2)
        if bend < 0:
            off = float(np.clip(-slope / (2 * bend), x[top - 1] - x[top], x[top + 1] - x[top]))
            value, peak = value + off, peak + slope * off + bend * off**2
    limit = peak - LIMIT
    below, above = np.flatnonzero(y[:top] < limit), np.flatnonzero(y[top + 1 :] < limit)
    low, high = float(x[0]), float(x[-1])
    if len(below):
        k = below[-1]
        low = float(np.interp(limit, y[k : k + 2], x[k : k + 2]))
    if len(above):
        k = top + 1 + above[0]
        high = float(np.interp(limit, y[[k, k - 1]], x[[k, k - 1]]))
    return FittedValue(value=value, low=min(low, value), high=max(high, value))


def _color_interval(model: SurfaceModel, kind: Kind, curves: Sequence[_Curve]) -> FittedValue:
    """Return the interval of the base colour over all values of roughness that are likely.

    At the best roughness, the profile over the base colour gives the interval. At another
    roughness, the best colour differs, and the interval is narrower in proportion to the root of
    the score's height above the limit.
    """
    top = max(curves, key=lambda one: one.score)
    colors, scores = [top.color], [top.score]
    limits = DARKEST[kind], BRIGHTEST
    for side in (-1, 1):
        color, step, score = top.color, 0.01, top.score
        while score > top.score - LIMIT and color not in limits:
            color = min(max(color + side * step, limits[0]), limits[1])
            score = _best_at(model, kind, top.roughness, color).score
            colors.append(color)
            scores.append(score)
            step *= 1.5
    order = np.argsort(colors)
    own = _interval(np.array(colors)[order].tolist(), np.array(scores)[order].tolist())
    roughness = [one.roughness for one in curves]
    dense = np.union1d(np.linspace(roughness[0], roughness[-1], 800), roughness)
    best = np.interp(dense, roughness, [one.color for one in curves])
    left = np.interp(dense, roughness, [one.score for one in curves]) - (top.score - LIMIT)
    share = np.sqrt(np.clip(left / LIMIT, 0, 1))
    low = best * (1 - share * (1 - own.low / top.color))
    high = best * (1 + share * (own.high / top.color - 1))
    likely = left >= 0
    return FittedValue(
        value=top.color,
        low=max(min(own.low, top.color, float(low[likely].min())), limits[0]),
        high=min(max(own.high, top.color, float(high[likely].max())), 1.0),
    )
