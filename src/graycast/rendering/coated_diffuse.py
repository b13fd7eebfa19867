"""A rough clear coat over a diffuse base that conserves energy, as a Mitsuba BSDF.

Mitsuba's `roughplastic` loses light that its single-scattering coat neither reflects nor lets
through, a fifth at roughness 0.5 and two thirds at 1. Here the base gets exactly what the coat does
not reflect: with `E` the coat's directional albedo, the sum is `E + base (1 - E)`, 1 for a white
base. Light passes the coat on its way in and on its way out, so both angles count, and it may run
backwards (Helmholtz). Blender's Principled BSDF counts the way out only: at roughness below 0.3 it
is 5 % darker than this where light comes in steeply, and brighter where it grazes
(docs/explanation/light.md, "Materials").

Where roughness varies, `E` is linear between the widths `ggx.ALPHAS`: a white base and its coat of
index 1.5 reflect all light to 0.3 % up to 85 degrees, and to 0.5 % beyond.

Leaves out: interreflection between coat and base that would saturate deep colours, and light
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
    """Properties: `reflectance` (texture), `eta` (index of the coat), `alpha` or `roughness`."""

    def __init__(self, props: mi.Properties):
        lobes = mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection
        super().__init__(props, *lobes)
        eta = float(props["eta"])
        cosine = np.linspace(0, 1, ggx.TABLE)
        self.eta = dr.opaque(mi.Float, eta)  # opaque, as alpha is
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
        """The coat's directional albedo."""
        if self.roughness is None:
            return ggx.interpolated(self.table, cosine)
        return ggx.between_rows(alpha, lambda row: ggx.interpolated(self.table, cosine, row))

    def _base_scale(self, alpha: mi.Float) -> mi.Float:
        """`1 / (pi (1 - mean albedo))`."""
        if self.roughness is None:
            return self.base_scale
        mean = ggx.between_rows(alpha, lambda row: dr.gather(mi.Float, self.mean, row))
        return dr.inv_pi / (1 - mean)


@lru_cache
def coat_albedo(alpha: float, eta: float) -> np.ndarray:
    """Share of light that a rough dielectric surface reflects off its facets, per cosine.

    Returns:
        One value for each of `ggx.TABLE` cosines from 0 to 1.
    """
    cosine = np.linspace(0, 1, ggx.TABLE)
    wi = ggx.leaning(cosine)
    table = ggx.directional_albedo(wi, (alpha, alpha), lambda met: _fresnel(met, eta))
    table.flags.writeable = False  # it is kept for the next scene
    return table


def _fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Unpolarised reflectance of a dielectric from outside."""
    inner = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel = (eta * cosine - inner) / (eta * cosine + inner)
    across = (cosine - eta * inner) / (cosine + eta * inner)
    return 0.5 * (parallel**2 + across**2)
