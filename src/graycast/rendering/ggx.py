"""The GGX distribution of microfacets with Smith's height-correlated shadowing, for our BSDFs.

All directions are unit vectors in the shading frame, both on the side of the normal. Stretched by
`alpha` along the surface, facets become a hemisphere, so the length `s = |(alpha x, alpha y, z)|`
of a stretched direction says all about its masking: Smith's `G1 = 2 z / (z + s)`, and for both
directions at once `G2 = 2 zi zo / (si zo + so zi)`.

Sources: B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007
(distribution); E. Heitz, "Understanding the Masking-Shadowing Function", JCGT 3(2), 2014 (G2);
J. Dupuy & A. Benyoub, "Sampling Visible GGX Normals with Spherical Caps", CGF 42(8), 2023.

Imported only by the BSDFs, after a variant was set.
"""

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from jaxtyping import Float

TABLE = 128  # A table over a cosine has so many nodes and is linear between them.
_FACETS = 4096  # With so many, the error of the visible-normal integral is below 2e-4.
_STEP = 0.5698402909980532  # M. Roberts' R2 sequence spreads the facets over two dimensions.


def distribution(half: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """Density of facets, per solid angle and projected area. Keeps digits where alpha is small."""
    across = dr.square(half.x) + dr.square(half.y)
    square = dr.square(alpha)
    return square * dr.inv_pi / dr.square(dr.fma(square, dr.square(half.z), across))


def stretched(w: mi.Vector3f, alpha: mi.Float) -> mi.Vector3f:
    return mi.Vector3f(alpha * w.x, alpha * w.y, w.z)


def sample_visible(wi: mi.Vector3f, alpha: mi.Float, uv: mi.Point2f) -> mi.Vector3f:
    """A facet's normal, with density `G1(wi) max(wi . h, 0) D(h) / wi.z`."""
    direction = dr.normalize(stretched(wi, alpha))
    z = dr.fma(1 - uv.y, 1 + direction.z, -direction.z)  # the cap that mirrors into the hemisphere
    across = dr.safe_sqrt(dr.fma(-z, z, 1))
    sine, cosine = dr.sincos(dr.two_pi * uv.x)
    half = mi.Vector3f(across * cosine, across * sine, z) + direction
    return dr.normalize(stretched(half, alpha))


def interpolated(table: mi.Float, cosine: mi.Float) -> mi.Float:
    """A table over the cosines from 0 to 1, linear between its nodes."""
    place = dr.clip(cosine, 0, 1) * (TABLE - 1)
    low = mi.UInt32(dr.minimum(place, TABLE - 2))
    a, b = dr.gather(mi.Float, table, low), dr.gather(mi.Float, table, low + 1)
    return dr.lerp(a, b, place - mi.Float(low))


class GlossyBSDF(mi.BSDF):
    """What our BSDFs share; `eval_pdf` and `sample` are each one's own.

    Properties: `reflectance` (texture), `alpha` (GGX).
    """

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.reflectance = props.get_texture("reflectance")
        # Opaque: a literal would be compiled into the kernel, anew for every roughness.
        self.alpha = dr.opaque(mi.Float, float(props["alpha"]))

    def eval(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[0]

    def pdf(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[1]

    def eval_diffuse_reflectance(self, si, active):
        return self.reflectance.eval(si, active)

    def traverse(self, callback):
        callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)


def directional_albedo(
    cosine: Float[np.ndarray, " n"],
    alpha: float,
    fresnel: Callable[[np.ndarray], np.ndarray] = np.ones_like,
) -> Float[np.ndarray, " n"]:
    """Share of light from each angle that facets send back after one reflection.

    The mean of `F G2 / G1` over visible normals, which `_FACETS` of them stand for.

    Args:
        cosine: between the light and the surface's normal.
        alpha: width of GGX.
        fresnel: reflectance of a facet by the cosine at which light meets it; all of it by default.
    """
    order = np.arange(_FACETS) + 0.5
    turn, height = 2 * np.pi * ((order * _STEP) % 1), order / _FACETS
    return np.array(
        [_mean_reflection(max(c, 1e-6), alpha, fresnel, turn, height) for c in cosine.tolist()]
    )


def _mean_reflection(
    cosine: float,
    alpha: float,
    fresnel: Callable[[np.ndarray], np.ndarray],
    turn: np.ndarray,
    height: np.ndarray,
) -> float:
    sine = np.sqrt(1 - cosine**2)
    length = np.hypot(alpha * sine, cosine)  # of the stretched direction
    z = (1 - height) * (1 + cosine / length) - cosine / length
    across = np.sqrt(np.maximum(1 - z * z, 0))
    half = np.stack(
        [
            alpha * (across * np.cos(turn) + alpha * sine / length),
            alpha * across * np.sin(turn),
            z + cosine / length,
        ]
    )
    half /= np.linalg.norm(half, axis=0)
    cos_half = np.minimum(sine * half[0] + cosine * half[2], 1)
    cos_o = 2 * cos_half * half[2] - cosine
    length_o = np.sqrt(np.maximum(cos_o**2 + alpha**2 * (1 - cos_o**2), 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = cos_o * (cosine + length) / (length * cos_o + length_o * cosine)
    return float(np.where(cos_o > 0, fresnel(cos_half) * kept, 0).mean())


def mean_albedo(alpha: float, fresnel: Callable[[np.ndarray], np.ndarray] = np.ones_like) -> float:
    """`directional_albedo` for light from everywhere: its cosine-weighted mean."""
    node, weight = np.polynomial.legendre.leggauss(32)
    cosine = 0.5 * (node + 1)
    return float(weight @ (cosine * directional_albedo(cosine, alpha, fresnel)))
