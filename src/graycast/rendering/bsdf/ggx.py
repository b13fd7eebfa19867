"""The GGX distribution of microfacets with Smith's height-correlated shadowing, for our BSDFs.

All directions are unit vectors in the shading frame, on the side of the normal. Stretching by
`alpha` along the surface turns the facets into a hemisphere. So masking depends only on the length
`s = |(alpha x, alpha y, z)|` of a stretched direction: Smith's `G1 = 2 z / (z + s)`, and for both
directions together `G2 = 2 zi zo / (si zo + so zi)`. `alpha` can be a pair for x and y; the same
equations hold, and kernels for a single number do not become longer.

Sources: B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007
(distribution); E. Heitz, "Understanding the Masking-Shadowing Function", JCGT 3(2), 2014 (G2);
J. Dupuy & A. Benyoub, "Sampling Visible GGX Normals with Spherical Caps", CGF 42(8), 2023.
"""

from collections.abc import Callable
from functools import lru_cache, reduce
from operator import or_
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from jaxtyping import Float

Alpha: TypeAlias = mi.Float | mi.Vector2f
TABLE = 128  # Number of nodes in a table over the cosine; values between them are interpolated.
# If roughness varies, tables have a row for each of these alphas, with equal steps of the cube
# root: energy changes fastest for rough metals and for smooth coats.
ALPHAS = np.linspace(1e-4 ** (1 / 3), 1, 24) ** 3
_FACETS = 4096  # The error of the visible-normal integral is then below 2e-4.
_STEP = 0.5698402909980532  # From M. Roberts' R2 sequence, which fills two dimensions evenly.


def distribution(half: mi.Vector3f, alpha: Alpha) -> mi.Float:
    """Return the density of facets per solid angle and projected area; precise for small alpha."""
    if isinstance(alpha, mi.Vector2f):
        length2 = dr.squared_norm(mi.Vector3f(half.x / alpha.x, half.y / alpha.y, half.z))
        return dr.inv_pi / (alpha.x * alpha.y * dr.square(length2))
    across = dr.square(half.x) + dr.square(half.y)
    square = dr.square(alpha)
    return square * dr.inv_pi / dr.square(dr.fma(square, dr.square(half.z), across))


def stretched(w: mi.Vector3f, alpha: Alpha) -> mi.Vector3f:
    if isinstance(alpha, mi.Vector2f):
        return mi.Vector3f(alpha.x * w.x, alpha.y * w.y, w.z)
    return mi.Vector3f(alpha * w.x, alpha * w.y, w.z)


def single_reflection(
    wi: mi.Vector3f, wo: mi.Vector3f, half: mi.Vector3f, alpha: Alpha
) -> tuple[mi.Float, mi.Float]:
    """Return `D G2 / (4 cos cos)` times the cosine of wo, and the sampling density of wo."""
    cos_i, cos_o = mi.Frame3f.cos_theta(wi), mi.Frame3f.cos_theta(wo)
    density = 0.5 * distribution(half, alpha)
    length_i, length_o = dr.norm(stretched(wi, alpha)), dr.norm(stretched(wo, alpha))
    shape = density * cos_o / dr.fma(length_i, cos_o, length_o * cos_i)
    return shape, density / (cos_i + length_i)


def sample_visible(wi: mi.Vector3f, alpha: Alpha, uv: mi.Point2f) -> mi.Vector3f:
    """Sample the normal of a visible facet, with density `G1(wi) max(wi . h, 0) D(h) / wi.z`."""
    direction = dr.normalize(stretched(wi, alpha))
    z = dr.fma(1 - uv.y, 1 + direction.z, -direction.z)  # Spherical cap of reflected directions
    across = dr.safe_sqrt(dr.fma(-z, z, 1))
    sine, cosine = dr.sincos(dr.two_pi * uv.x)
    half = mi.Vector3f(across * cosine, across * sine, z) + direction
    return dr.normalize(stretched(half, alpha))


def interpolated(table: mi.Float, cosine: mi.Float, row: mi.UInt32 | None = None) -> mi.Float:
    """Interpolate linearly in a table over the cosines from 0 to 1, or in one row of several."""
    place = dr.clip(cosine, 0, 1) * (TABLE - 1)
    low = mi.UInt32(dr.minimum(place, TABLE - 2))
    first = low if row is None else row * TABLE + low
    a, b = dr.gather(mi.Float, table, first), dr.gather(mi.Float, table, first + 1)
    return dr.lerp(a, b, place - mi.Float(low))


def between_rows(alpha: mi.Float, value: Callable[[mi.UInt32], mi.Float]) -> mi.Float:
    """Interpolate between the values for two `ALPHAS`, linearly in the cube root of alpha."""
    least = float(np.cbrt(ALPHAS[0]))
    place = (dr.cbrt(alpha) - least) * ((len(ALPHAS) - 1) / (1 - least))
    row = mi.UInt32(dr.clip(place, 0, len(ALPHAS) - 2))
    return dr.lerp(value(row), value(row + 1), place - mi.Float(row))


def schlick(normal: mi.Color3f, cos_half: mi.Float) -> mi.Color3f:
    """Return a metal's Fresnel reflectance from its normal reflectance (C. Schlick, 1994)."""
    away = 1 - cos_half
    return dr.fma(1 - normal, dr.square(dr.square(away)) * away, normal)


def coming_later(normal: mi.Color3f, share: mi.Float) -> mi.Color3f:
    """Return the share `F_ms` of the light that leaves a metal after more than one reflection.

    At each further reflection, the metal reflects `F_avg = F0 + (1 - F0) / 21` (the mean of
    Schlick's term), and `share` of this light leaves.
    """
    average = dr.fma(normal, 20 / 21, 1 / 21)
    return average * share / dr.fma(-average, 1 - share, 1)


def layer_share(reflected: mi.Float, below: mi.Color3f) -> mi.Float:
    """Return the probability of sampling the top layer: its share of all reflected light."""
    return reflected / (reflected + (1 - reflected) * dr.mean(below))


class GlossyBSDF(mi.BSDF):
    """The common base of our glossy BSDFs; subclasses define `reflected` and `sample`.

    The surface reflects only on its front, in one or two lobes.
    Properties: `reflectance` (texture), `alpha` (GGX) or `roughness` (texture), its square root.
    """

    def __init__(self, props: mi.Properties, *lobes: mi.BSDFFlags):
        super().__init__(props)
        flags = [lobe | mi.BSDFFlags.FrontSide for lobe in lobes]
        self.m_components, self.m_flags = [int(flag) for flag in flags], reduce(or_, flags)
        self.reflectance = props.get_texture("reflectance")
        varied = "roughness" in props
        self.roughness = props.get_texture("roughness") if varied else None
        # Opaque, because a literal would force a new compilation for every roughness.
        self.alpha = None if varied else dr.opaque(mi.Float, float(props["alpha"]))

    def alpha_at(self, si, active) -> Alpha:
        varied = self.roughness
        return self.alpha if varied is None else dr.square(varied.eval_1(si, active))

    def eval_pdf(self, context, si, wo, active):
        """Return the BSDF times the cosine, and the solid-angle density; 0 below the surface."""
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_i > 0) & (cos_o > 0)
        value, pdf = self.reflected(si, wo, cos_i, cos_o, active)
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[0]

    def pdf(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[1]

    def eval_diffuse_reflectance(self, si, active):
        return self.reflectance.eval(si, active)

    def layer_sample(self, context, si, wo, of_layer, active):
        """Return the sample for a direction of the top layer (first component) or of the base."""
        value, pdf = self.eval_pdf(context, si, wo, active)
        layer, below = self.m_components
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = wo, pdf, 1.0
        bs.sampled_type = dr.select(of_layer, mi.UInt32(layer), below)
        bs.sampled_component = dr.select(of_layer, mi.UInt32(0), 1)
        active &= pdf > 0
        return bs, dr.select(active, value / pdf, 0)

    def to_string(self):
        return f"{type(self).__name__}[alpha={self.alpha}]"

    def traverse(self, callback):
        callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)
        if self.roughness is not None:
            callback.put("roughness", self.roughness, mi.ParamFlags.Differentiable)


def leaning(cosine: Float[np.ndarray, " n"], azimuth_rad: float = 0.0) -> Float[np.ndarray, "n 3"]:
    """Return unit vectors with these cosines to the normal, slightly above the horizon at 0."""
    z = np.clip(cosine, 1e-6, 1)
    sine = np.sqrt(1 - z**2)
    return np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), z], axis=-1)


def directional_albedo(
    wi: Float[np.ndarray, "n 3"],
    alphas: tuple[float, float],
    fresnel: Callable[[np.ndarray], np.ndarray] = np.ones_like,
) -> Float[np.ndarray, " n"]:
    """Return the share of light from each direction that leaves after one reflection.

    It is the mean of `F G2 / G1` over `_FACETS` visible normals, where F is the reflectance of a
    facet as a function of the cosine of incidence. `alphas` are the widths along x and y.
    """
    met = (facets(w, alphas) for w in wi)
    return np.array([float((fresnel(cos_half) * left).mean()) for cos_half, _, left in met])


def facets(
    wi: Float[np.ndarray, "3"], alphas: tuple[float, float]
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Return facets that are visible from a direction, with equal weights.

    Returns:
        For each facet the cosine of incidence, the cosine between reflected light and the surface's
        normal, and the share that other facets let pass, `G2 / G1` (0 for light that goes down).
    """
    around, height = _spread()
    widths = np.array([*alphas, 1.0])
    length = np.linalg.norm(widths * wi)  # Length of the stretched direction
    x, y, cosine = widths * wi / length
    z = (1 - height) * (1 + cosine) - cosine
    across = np.sqrt(np.maximum(1 - z * z, 0))
    half = np.stack([across * around[0] + x, across * around[1] + y, z + cosine])
    half *= widths[:, None]
    half /= np.linalg.norm(half, axis=0)
    cos_half = np.minimum(wi @ half, 1)
    wo = 2 * cos_half * half - wi[:, None]
    length_o = np.linalg.norm(widths[:, None] * wo, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = wo[2] * (wi[2] + length) / (length * wo[2] + length_o * wi[2])
    return cos_half, wo[2], np.where(wo[2] > 0, passed, 0)


@lru_cache
def _spread() -> tuple[Float[np.ndarray, "2 f"], Float[np.ndarray, " f"]]:
    """Return cosines and sines of the facets' azimuths, and their heights in the cap (0 to 1)."""
    order = np.arange(_FACETS) + 0.5
    turn = 2 * np.pi * ((order * _STEP) % 1)
    return np.stack([np.cos(turn), np.sin(turn)]), order / _FACETS


def mean_albedo(alphas: tuple[float, float]) -> float:
    """Return the cosine-weighted mean of `directional_albedo` over all directions of light."""
    node, weight = np.polynomial.legendre.leggauss(32)
    cosine = 0.5 * (node + 1)
    azimuths_rad = [0.0] if alphas[0] == alphas[1] else np.pi / 8 * (np.arange(4) + 0.5)
    albedo = [directional_albedo(leaning(cosine, azimuth), alphas) for azimuth in azimuths_rad]
    return float(weight @ (cosine * np.mean(albedo, axis=0)))
