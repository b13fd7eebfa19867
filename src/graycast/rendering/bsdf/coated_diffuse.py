"""A rough clear coat over a diffuse base that conserves energy, as a Mitsuba BSDF.

Mitsuba's `roughplastic` loses the light that its single-scattering coat neither reflects nor
transmits: a fifth at roughness 0.5 and two thirds at 1. Here the base receives exactly the light
that the coat does not reflect. With the directional albedo `E` of the coat, the sum is
`E + base (1 - E)`, which is 1 for a white base. Light passes the coat on its way in and on its way
out, so both angles count and the BSDF is reciprocal (Helmholtz). Blender's Principled BSDF counts
only the way out: at roughness below 0.3 it is 5 % darker than this for steep light, and brighter
for grazing light (docs/explanation/light.md, "Materials").

If roughness varies, `E` is interpolated linearly between the widths `ggx.ALPHAS`: a white base with
a coat of index 1.5 conserves energy to 0.3 % up to 85 degrees, and to 0.5 % beyond.

Leaves out: interreflection between coat and base, which would saturate deep colours; light that is
scattered twice among the coat's facets, which goes to the base instead.

Source: Kelemen & Szirmay-Kalos, "A Microfacet Based Coupled Specular-Matte BRDF Model with
Importance Sampling", Eurographics 2001; the coat: `ggx.py`.
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from . import ggx


@final
class CoatedDiffuse(ggx.GlossyBSDF):
    """A BSDF with the properties `reflectance` (texture), `eta` (coat), `alpha` or `roughness`."""

    def __init__(self, props: mi.Properties):
        lobes = mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection
        super().__init__(props, *lobes)
        eta = float(props["eta"])
        cosine = np.linspace(0, 1, ggx.TABLE)
        self.eta = dr.opaque(mi.Float, eta)  # A literal would force a recompilation for each eta.
        if self.roughness is None:
            table = coat_albedo(float(props["alpha"]), eta)
            mean = float(np.trapezoid(2 * cosine * table, cosine))
            self.base_scale = dr.opaque(mi.Float, 1 / (np.pi * (1 - mean)))
        else:
            table = np.stack([coat_albedo(alpha, eta) for alpha in ggx.ALPHAS.tolist()])
            means = np.trapezoid(2 * cosine * table, cosine)
            self.mean = mi.Float(means.astype(np.float32))
        self.table = mi.Float(table.astype(np.float32).ravel())

    def reflected(self, si, wo, cos_i, cos_o, active):
        alpha = self.alpha_at(si, active)
        half = dr.normalize(si.wi + wo)
        shape, coat_pdf = ggx.single_reflection(si.wi, wo, half, alpha)
        coat = mi.fresnel(dr.dot(si.wi, half), self.eta)[0] * shape
        base = self.reflectance.eval(si, active)
        share_in, left = self._albedo(cos_i, alpha), 1 - self._albedo(cos_o, alpha)
        matte = base * ((1 - share_in) * left * self._base_scale(alpha) * cos_o)
        share = ggx.layer_share(share_in, base)
        pdf = dr.lerp(mi.warp.square_to_cosine_hemisphere_pdf(wo), coat_pdf, share)
        return coat + matte, pdf

    def sample(self, context, si, sample1, sample2, active):
        cos_i = mi.Frame3f.cos_theta(si.wi)
        active &= cos_i > 0
        alpha = self.alpha_at(si, active)
        share = ggx.layer_share(self._albedo(cos_i, alpha), self.reflectance.eval(si, active))
        of_coat = sample1 < share
        half = ggx.sample_visible(si.wi, alpha, sample2)
        wo = dr.select(
            of_coat, mi.reflect(si.wi, half), mi.warp.square_to_cosine_hemisphere(sample2)
        )
        return self.layer_sample(context, si, wo, of_coat, active)

    def _albedo(self, cosine: mi.Float, alpha: mi.Float) -> mi.Float:
        """Return the coat's directional albedo."""
        if self.roughness is None:
            return ggx.interpolated(self.table, cosine)
        return ggx.between_rows(alpha, lambda row: ggx.interpolated(self.table, cosine, row))

    def _base_scale(self, alpha: mi.Float) -> mi.Float:
        """Return the normalisation factor of the base, `1 / (pi (1 - mean albedo))`."""
        if self.roughness is None:
            return self.base_scale
        mean = ggx.between_rows(alpha, lambda row: dr.gather(mi.Float, self.mean, row))
        return dr.inv_pi / (1 - mean)


@lru_cache
def coat_albedo(alpha: float, eta: float) -> np.ndarray:
    """Return the share of light that the facets of a rough dielectric reflect, per cosine.

    Returns:
        One value for each of `ggx.TABLE` cosines from 0 to 1.
    """
    cosine = np.linspace(0, 1, ggx.TABLE)
    wi = ggx.leaning(cosine)
    table = ggx.directional_albedo(wi, (alpha, alpha), lambda met: _fresnel(met, eta))
    table.flags.writeable = False  # The cache returns the same array for the next scene.
    return table


def _fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Return the unpolarised reflectance of a dielectric, from outside."""
    inner = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel = (eta * cosine - inner) / (eta * cosine + inner)
    across = (cosine - eta * inner) / (cosine + eta * inner)
    return 0.5 * (parallel**2 + across**2)
