"""Fit of mottle: reflectance that varies from place to place, such as the grain of cast metal.

The light of a pixel over the median of its neighbourhood is free of slopes and of distance. Its
covariances between neighbours show the spread s and the length L of a field with the correlation
`exp(-(r / L)^2)`, averaged over square pixels of side p:

    cov(i, j) = s^2 h(i) h(j),   h(k) = integral over |t| < 1 of (1 - |t|) exp(-((t + k) p / L)^2).

The sensor's noise adds only to cov(0, 0), from which it is subtracted.

Leaves out: the camera's blur, which makes L longer and s smaller; a laser's speckle, which counts
as mottle finer than a pixel; mottle much longer than the neighbourhood.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ...base.errors import GraycastError
from ...base.public_value import public_value
from ...camera.decode import Levels
from ...world.parts import Material
from ...world.parts.part import MOTTLE_PEAK
from .fitting import FittedValue

MOTTLE_MOST = 0.5  # the largest mottle of a material
AROUND_PX = 15  # side of the neighbourhood
BLOCK_PX = 24  # side of the square blocks that the bootstrap redraws for confidence intervals
LEAST_PX, LEAST_BLOCKS = 400, 8
LIMIT = 0.4  # A pixel whose light differs by a larger share from the local median is at an edge.
DRAWS = 400
FINEST = 0.3  # A finer mottle is averaged by each pixel, so that its length is not determined.
LENGTHS = np.geomspace(FINEST, 4.0, 400)  # L in pixels; the neighbourhood removes a longer mottle.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class MottleFit:
    """The relative spread of the reflectance, and the distance of correlation 1/e [m].

    The length is determined between FINEST pixels and `LENGTHS[-1]` pixels. Of a mottle outside of
    these limits, `length_m` has the nearer limit.
    """

    spread: FittedValue
    length_m: FittedValue
    pixel_m: float

    def on(self, material: Material) -> Material:
        """Return the material with this mottle, reduced if necessary.

        The mottle is limited to MOTTLE_MOST, and so that reflectance exceeds 1 nowhere.
        """
        brightest = max(material.base_color)
        most = min(MOTTLE_MOST, (1 / brightest - 1) / MOTTLE_PEAK if brightest > 0 else MOTTLE_MOST)
        return replace(
            material,
            mottle=min(self.spread.value, math.floor(1e3 * most) / 1e3),
            mottle_length_m=self.length_m.value,
        )

    @property
    def limit(self) -> str:
        """The words "at most" or "at least" if the length is at a limit, else an empty text."""
        length_px = self.length_m.value / self.pixel_m
        if length_px <= FINEST:
            return "at most "
        return "at least " if length_px >= LENGTHS[-1] * (1 - 1e-9) else ""


def fit_mottle(
    direct: Float[np.ndarray, "h w"],
    use: Bool[np.ndarray, "h w"],
    levels: Levels,
    *,
    pixel_m: float,
    seed: int,
) -> MottleFit:
    """Fit the mottle of a smooth surface.

    Args:
        direct: the projector's direct light under a white picture [DN above offset].
        use: the pixels that show the surface, away from its edges.
        levels: the noise of the sensor.
        pixel_m: size of a pixel on the surface.
        seed: seed for the blocks that give the 95 % intervals.

    Raises:
        GraycastError: the pixels are too few.
    """
    if use.sum() < LEAST_PX:
        raise GraycastError(
            f"only {use.sum()} pixels show the surface's mottle, and {LEAST_PX} are needed: mark a "
            "larger area"
        )
    ratio, use = _over_neighbourhood(direct, use)
    noise2 = 2 * (levels.floor_dn2 + levels.slope_dn * np.maximum(direct, 0))
    noise2 = noise2 / np.maximum(direct, 1e-9) ** 2
    blocks = _block_sums(ratio, np.where(use, noise2, 0.0), use)
    return _fitted(blocks, pixel_m, np.random.default_rng(seed))


def _over_neighbourhood(
    direct: Float[np.ndarray, "h w"], use: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return each pixel's light over the median around it, less 1, and the pixels to use."""
    known = ndimage.uniform_filter(use.astype(np.float64), AROUND_PX) > 0.9
    middle = ndimage.median_filter(direct, AROUND_PX)
    ratio = np.divide(direct, middle, out=np.ones(direct.shape), where=middle > 0) - 1
    good = use & known & (np.abs(ratio) < LIMIT)
    return np.where(good, ratio, 0.0), good


def _block_sums(
    ratio: Float[np.ndarray, "h w"],
    noise2: Float[np.ndarray, "h w"],
    use: Bool[np.ndarray, "h w"],
) -> Float[np.ndarray, "b 6"]:
    """Return, for each block, sum and count of squares less noise, and of both lags' products."""
    kinds = []
    for step in ((0, 0), (0, 1), (1, 0)):
        rows, columns = (slice(None, -n or None) for n in step)
        other = tuple(slice(n, None) for n in step)
        both = use[rows, columns] & use[other]
        product = ratio[rows, columns] * ratio[other]
        if step == (0, 0):
            product = product - noise2
        kinds += [np.where(both, product, 0.0), both.astype(np.float64)]
    height, width = (n // BLOCK_PX for n in use.shape)
    sums = np.stack(
        [
            np.pad(kind, [(0, 1), (0, 1)])[: height * BLOCK_PX, : width * BLOCK_PX]
            .reshape(height, BLOCK_PX, width, BLOCK_PX)
            .sum(axis=(1, 3))
            .ravel()
            for kind in kinds
        ],
        axis=-1,
    )
    return sums[sums[:, 1] > 0]


def _fitted(
    blocks: Float[np.ndarray, "b 6"], pixel_m: float, rng: np.random.Generator
) -> MottleFit:
    """Return spread and length from the covariances, with intervals from redrawn blocks.

    Raises:
        GraycastError: the blocks are too few.
    """
    if len(blocks) < LEAST_BLOCKS:
        raise GraycastError(
            f"the surface's mottle needs {LEAST_BLOCKS} areas of {BLOCK_PX} x {BLOCK_PX} px, and "
            f"the mask has {len(blocks)}: mark a larger area"
        )
    value = _solved(blocks.sum(axis=0), pixel_m)
    picks = rng.integers(len(blocks), size=(DRAWS, len(blocks)))
    redone = np.array([_solved(blocks[pick].sum(axis=0), pixel_m) for pick in picks])
    low, high = np.percentile(redone, [2.5, 97.5], axis=0)
    spread, length = (
        FittedValue(
            value=value[k], low=min(value[k], float(low[k])), high=max(value[k], float(high[k]))
        )
        for k in (0, 1)
    )
    return MottleFit(spread=spread, length_m=length, pixel_m=pixel_m)


def _solved(sums: Float[np.ndarray, " 6"], pixel_m: float) -> tuple[float, float]:
    """Return spread and length [m]."""
    variance = max(float(sums[0] / max(sums[1], 1.0)), 1e-12)
    neighbour = float((sums[2] + sums[4]) / max(sums[3] + sums[5], 1.0))
    own, next_to = _shared(0), _shared(1)
    length_px = float(np.interp(neighbour / variance, next_to / own, LENGTHS))
    spread = (variance / float(np.interp(length_px, LENGTHS, own**2))) ** 0.5
    return spread, length_px * pixel_m


@cache
def _shared(lag: int) -> Float[np.ndarray, " n"]:
    """Return h(lag) of LENGTHS, by the trapezoidal rule."""
    t = np.linspace(-1, 1, 401)
    values = (1 - np.abs(t)) * np.exp(-(((t + lag) / LENGTHS[:, None]) ** 2))
    return np.trapezoid(values, t, axis=1)
