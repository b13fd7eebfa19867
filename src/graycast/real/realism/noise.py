"""Noise of depth about planes in small patches: standard deviation and autocorrelation.

The inverse depth of a plane is an affine function of the pixel, and triangulation noise is nearly
uniform in inverse depth. So planes are fitted to 1/z by least squares, and residuals are converted
to z by dz = z^2 d(1/z). Variance and autocorrelation are corrected for the part of the noise that a
fit absorbs. This assumes that noise is not correlated over more than `REACH_PX` pixels along rows
or columns.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from ...base.robust import robust_sigma
from .scan import DepthScan, tiles

PATCH_PX = 15
REACH_PX = 4
_LEAST_VALID = 0.9  # A patch must have this share of valid pixels.
_MOST_OUTLIERS = 0.05  # A patch with a larger share of outliers is an edge.
_OUTLIER_SIGMAS = 5.0
_DEGREE = 5
_TERMS = (_DEGREE + 1) * (_DEGREE + 2) // 2
_PLANE = 3  # The first three terms of the basis are a plane; the other terms describe bending.
_CERTAINTY = 0.999  # confidence level of the test for bent patches
_ROUNDS = 4
_LEAST_PATCHES = 5  # Fewer patches do not determine an autocorrelation.

# Lags (dx, dy) between two pixels, zero first: half of the plane, because the other is symmetric.
LAGS = [(dx, dy) for dy in range(REACH_PX + 1) for dx in range(-REACH_PX, REACH_PX + 1)
        if dy > 0 or dx >= 0]  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchNoise:
    """Noise and depth of the flat patches of one map, and counts of candidates and outliers."""

    candidates: int
    outliers: int
    pixels: int  # number of pixels in flat patches
    sigma_m: Float[np.ndarray, " n"]
    depth_m: Float[np.ndarray, " n"]  # in the middle of each flat patch
    whole: int  # number of flat patches without a hole
    products: Float[np.ndarray, " lags"]  # sums of products of residuals over these patches


def measure_noise(scan: DepthScan) -> PatchNoise:
    """Fit planes to the patches of a map that have few holes, and measure the flat patches.

    A patch is bent, and left out, if the terms of second to fifth degree of a polynomial fit reduce
    the residuals more than noise with the map's own autocorrelation does in 99.9 % of patches. The
    autocorrelation comes from the residuals of the polynomial fit, first in the half of the patches
    that bends least, then in the flat patches. So the test does not depend on the noise level.
    """
    inverse = tiles(1.0 / scan.depth_m, PATCH_PX).reshape(-1, PATCH_PX**2).astype(np.float64)
    inverse = inverse[(~np.isnan(inverse)).mean(axis=1) >= _LEAST_VALID]
    fit = _fit(inverse)
    flat, correlation = _flat(fit)
    clean = fit.used.all(axis=1) & flat
    count, loss = fit.used.sum(axis=1)[flat], _fit_loss(correlation, _PLANE)
    # Holes reduce the number of pixels, but not the degrees of freedom that the fit absorbs.
    variance = fit.plane_power[flat] / (count - loss)
    depth_m = 1.0 / (fit.plane[flat, 0] / PATCH_PX)
    return PatchNoise(
        candidates=len(inverse),
        outliers=int(fit.outliers[flat].sum()),
        pixels=int(count.sum() + fit.outliers[flat].sum()),
        sigma_m=np.sqrt(variance) * depth_m**2,
        depth_m=depth_m,
        whole=int(clean.sum()),
        products=_lag_products(fit.plane_rest[clean]),
    )


def autocorrelation(
    products: Float[np.ndarray, " lags"], terms: int = _PLANE
) -> Float[np.ndarray, " lags"]:
    """Return the autocorrelation of noise at `LAGS` from the mean products of a fit's residuals.

    A fit with hat matrix H leaves the residuals r = M n of the noise n, with M = 1 - H. Their
    covariance is M C M, so the mean products are linear in the autocovariance C at all lags.
    """
    covariance = np.linalg.solve(_lag_matrix(terms), products)
    return covariance / covariance[0]


# --- fits ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Least-squares fits to n patches of inverse depth [1/m]."""

    used: Bool[np.ndarray, "n pixels"]  # valid and not an outlier
    outliers: Float[np.ndarray, " n"]
    plane: Float[np.ndarray, "n 3"]  # coefficients of the first three terms
    plane_power: Float[np.ndarray, " n"]  # sum of squared residuals of the plane
    rest_power: Float[np.ndarray, " n"]  # sum of squared residuals of the full fit
    plane_rest: Float[np.ndarray, "n pixels"]
    rest: Float[np.ndarray, "n pixels"]  # residuals of the full fit


def _fit(inverse: Float[np.ndarray, "n pixels"]) -> _Fit:
    """Fit planes and full polynomials; repeat twice without the outliers of the polynomials."""
    valid = ~np.isnan(inverse)
    value = np.where(valid, inverse, 0.0)
    used = valid
    for _ in range(3):
        plane, _ = _least_squares(value, used, _basis()[:, :_PLANE])
        _, rest = _least_squares(value, used, _basis())
        spread = robust_sigma(np.where(valid, rest, np.nan), axis=1, keepdims=True)
        previous, used = used, valid & (np.abs(rest) <= _OUTLIER_SIGMAS * spread)
    used = previous
    plane_rest = np.where(used, value - plane @ _basis()[:, :_PLANE].T, 0.0)
    rest = np.where(used, rest, 0.0)
    return _Fit(
        used=used,
        outliers=(valid & ~used).sum(axis=1).astype(float),
        plane=plane,
        plane_power=(plane_rest**2).sum(axis=1),
        rest_power=(rest**2).sum(axis=1),
        plane_rest=plane_rest,
        rest=rest,
    )


def _least_squares(
    value: Float[np.ndarray, "n pixels"],
    used: Bool[np.ndarray, "n pixels"],
    basis: Float[np.ndarray, "pixels terms"],
) -> tuple[Float[np.ndarray, "n terms"], Float[np.ndarray, "n pixels"]]:
    """Fit the used pixels of each patch; return coefficients, and residuals of all pixels."""
    terms = basis.shape[1]
    squares = (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
    normal = (used.astype(float) @ squares).reshape(-1, terms, terms)
    # If too few pixels are inliers, this avoids a singular matrix; the patch is refused later.
    normal = normal + 1e-9 * np.eye(terms)
    coefficient = np.linalg.solve(normal, ((value * used) @ basis)[..., None])[..., 0]
    return coefficient, value - coefficient @ basis.T


@cache
def _basis() -> Float[np.ndarray, "pixels terms"]:
    """Return orthonormal polynomials on a patch: 1, x, y, and terms up to degree `_DEGREE`."""
    t = np.arange(PATCH_PX) - (PATCH_PX - 1) / 2
    x, y = (c.ravel() for c in np.meshgrid(t, t))
    powers = [(d - j, j) for d in range(_DEGREE + 1) for j in range(d + 1)]
    q, r = np.linalg.qr(np.stack([x**i * y**j for i, j in powers], axis=1))
    return q * np.sign(np.diag(r))


def _flat(fit: _Fit) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " lags"]]:
    """Return a mask of the flat patches, and the autocorrelation of the noise."""
    smooth = (fit.outliers <= _MOST_OUTLIERS * PATCH_PX**2) & (fit.rest_power > 0)
    bend = (fit.plane_power - fit.rest_power) / np.where(smooth, fit.rest_power, np.nan)
    flat = smooth & (bend <= (np.median(bend[smooth]) if smooth.any() else 0.0))
    for _ in range(_ROUNDS):
        whole = fit.used.all(axis=1) & flat
        correlation = np.eye(len(LAGS))[0]
        if whole.sum() >= _LEAST_PATCHES:
            correlation = autocorrelation(_lag_products(fit.rest[whole]) / whole.sum(), _TERMS)
        with np.errstate(invalid="ignore"):
            flat = smooth & (bend <= _most_bend(correlation))
    return flat, correlation


def _most_bend(correlation: Float[np.ndarray, " lags"]) -> float:
    """Return the bend of a plane that noise hardly exceeds, relative to the full fit's residuals.

    The power of the bending terms is a sum of chi-squares, weighted by the eigenvalues of their
    covariance. It is approximated by a chi-square of equal mean and variance (Satterthwaite).
    """
    bending = _coefficient_covariance(correlation)[_PLANE:, _PLANE:]
    weight = np.linalg.eigvalsh(bending).clip(min=0)
    freedom = weight.sum() ** 2 / (weight**2).sum()
    most = weight.sum() * chi2.ppf(_CERTAINTY, freedom) / freedom
    return float(most / (PATCH_PX**2 - _fit_loss(correlation, _TERMS)))


def _fit_loss(correlation: Float[np.ndarray, " lags"], terms: int) -> float:
    """Return the noise power that a fit absorbs, in pixels: 3 for a plane in white noise."""
    return float(np.trace(_coefficient_covariance(correlation)[:terms, :terms]))


def _coefficient_covariance(
    correlation: Float[np.ndarray, " lags"],
) -> Float[np.ndarray, "terms terms"]:
    """Return the covariance of the coefficients of a fit to noise of unit variance."""
    return np.tensordot(correlation, _lags_in_basis(), axes=1)


@cache
def _lags_in_basis() -> Float[np.ndarray, "lags terms terms"]:
    return _basis().T @ _lag_indicators() @ _basis()


# --- autocorrelation -----------------------------------------------------------------------------


@cache
def _lag_indicators() -> Float[np.ndarray, "lags pixels pixels"]:
    """Return a matrix per lag, which is 1 for each pair of pixels at this lag, in either order."""
    y, x = np.divmod(np.arange(PATCH_PX**2), PATCH_PX)
    dx, dy = x[None, :] - x[:, None], y[None, :] - y[:, None]
    return np.stack([((dx == a) & (dy == b)) | ((dx == -a) & (dy == -b)) for a, b in LAGS]).astype(
        float
    )


@cache
def _lag_matrix(terms: int) -> Float[np.ndarray, "lags lags"]:
    """Return the matrix that maps the autocovariance of noise to the mean products of residuals.

    With the indicators E and H = B B^T, the trace of E_k (1 - H) E_l (1 - H) is computed from E B
    and B^T E B, which are small.
    """
    indicator, basis = _lag_indicators(), _basis()[:, :terms]
    through = (indicator @ basis).reshape(len(LAGS), -1)
    within = _lags_in_basis()[:, :terms, :terms].reshape(len(LAGS), -1)
    pairs = indicator.sum(axis=(1, 2))
    sums = np.diag(pairs) - 2 * through @ through.T + within @ within.T
    return sums / pairs[:, None]


def _lag_products(rest: Float[np.ndarray, "n pixels"]) -> Float[np.ndarray, " lags"]:
    """Sum the mean products of residuals at `LAGS` over patches, each scaled to unit power."""
    power = (rest**2).mean(axis=1, keepdims=True)
    r = (rest / np.sqrt(power)).reshape(-1, PATCH_PX, PATCH_PX)
    sums = []
    for dx, dy in LAGS:
        a = r[:, : PATCH_PX - dy, max(0, -dx) : PATCH_PX - max(0, dx)]
        b = r[:, dy:, max(0, dx) : PATCH_PX - max(0, -dx)]
        sums.append((a * b).sum() / (a.shape[1] * a.shape[2]))
    return np.array(sums)
