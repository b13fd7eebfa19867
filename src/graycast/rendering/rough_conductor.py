"""A rough metal that loses no light among its facets, as a Mitsuba BSDF.

One reflection off GGX facets, `F D G2 / (4 cos cos)`, returns the share `E` of light: of white
metal and light from everywhere 0.88 at roughness 0.5 and 0.41 at 1. The rest strikes further facets
and comes out later. It is given back in the first lobe's directions,

    f = f_single (1 + F_ms (1 - E) / E),    F_ms = F_avg E_avg / (1 - F_avg (1 - E_avg)),

with `E` at the direction that light leaves for (in a path from the camera: where it came from),
`E_avg` its cosine-weighted mean, and `F_avg = F0 + (1 - F0) / 21` the mean of Schlick's Fresnel
term: white metal returns everything, and colours deepen as they do by reflecting twice.

This is also the metal of Blender's Principled BSDF, to 0.3 % wherever we looked
(`tests/rendering/test_materials_in_both.py`).

Leaves out: that light reflected many times leaves in directions of its own, wider than the first
lobe. Since `E` is taken at one of the two directions, light may not run backwards: the two ways
differ by the ratio of `1 + F_ms (1 - E) / E`, which for white metal within 60 degrees of the normal
is 2 % at roughness 0.3, 7 % at 0.5 and 47 % at 1. No complex index, so no dip of the reflectance
before grazing incidence.

Sources: C. Kulla & A. Conty, "Revisiting Physically Based Shading at Imageworks", SIGGRAPH 2017
course (F_ms); E. Turquin, "Practical Multiple Scattering Compensation for Microfacet Models",
Industrial Light & Magic, 2019 (scaled lobe); C. Schlick, CGF 13(3), 1994 (F).

Imported only by `mitsuba_scene.py`, after a variant was set.
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from . import ggx


@final
class RoughConductor(ggx.GlossyBSDF):
    """Properties: `reflectance` (texture) at normal incidence, `alpha` (GGX)."""

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        lost, mean = lost_share(float(props["alpha"]))
        self.mean = dr.opaque(mi.Float, mean)
        self.lost = mi.Float(lost.astype(np.float32))
        self.m_flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        self.m_components = [int(self.m_flags)]

    def eval_pdf(self, context, si, wo, active):
        """Value times cosine, and solid-angle density."""
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_i > 0) & (cos_o > 0)
        half = dr.normalize(si.wi + wo)
        density = 0.5 * ggx.distribution(half, self.alpha)
        length_i = dr.norm(ggx.stretched(si.wi, self.alpha))
        length_o = dr.norm(ggx.stretched(wo, self.alpha))
        shape = density * cos_o / dr.fma(length_i, cos_o, length_o * cos_i)
        value = self._reflected(si, dr.dot(si.wi, half), length_i, active) * shape
        pdf = density / (cos_i + length_i)
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def sample(self, context, si, sample1, sample2, active):
        half = ggx.sample_visible(si.wi, self.alpha, sample2)
        cos_half = dr.dot(si.wi, half)
        wo = dr.fma(2 * cos_half, half, -si.wi)
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_i > 0) & (cos_o > 0)
        length_i = dr.norm(ggx.stretched(si.wi, self.alpha))
        length_o = dr.norm(ggx.stretched(wo, self.alpha))
        both = cos_i + length_i
        kept = cos_o * both / dr.fma(length_i, cos_o, length_o * cos_i)  # G2 / G1
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.eta = wo, 1.0
        bs.pdf = dr.select(active, 0.5 * ggx.distribution(half, self.alpha) / both, 0)
        bs.sampled_type, bs.sampled_component = mi.UInt32(self.m_components[0]), mi.UInt32(0)
        weight = self._reflected(si, cos_half, length_i, active) * kept
        return bs, dr.select(active, weight, 0)

    def to_string(self):
        return f"RoughConductor[alpha={self.alpha}]"

    def _reflected(self, si, cos_half: mi.Float, length_i: mi.Float, active) -> mi.Color3f:
        """Fresnel's share, and what comes back after the first reflection."""
        normal = self.reflectance.eval(si, active)
        away = 1 - cos_half
        fresnel = dr.fma(1 - normal, dr.square(dr.square(away)) * away, normal)
        average = dr.fma(normal, 20 / 21, 1 / 21)
        later = average * self.mean / dr.fma(-average, 1 - self.mean, 1)
        lost = ggx.interpolated(self.lost, mi.Frame3f.cos_theta(si.wi) / length_i)
        return fresnel * dr.fma(later, lost, 1)


@lru_cache
def lost_share(alpha: float) -> tuple[np.ndarray, float]:
    """`(1 - E) / E` of white GGX facets, and the mean of `E`.

    Returns:
        The first at `ggx.TABLE` values from 0 to 1 of the cosine of the STRETCHED direction, in
        which `E` is smooth however small alpha is; linear between them, `E (1 + lost)` is 1 to
        0.05 %, and 0.3 % beyond 89 degrees.
    """
    stretched = np.linspace(0, 1, ggx.TABLE)
    cosine = alpha * stretched / np.sqrt(1 - stretched**2 * (1 - alpha**2))
    albedo = ggx.directional_albedo(np.minimum(cosine, 1), alpha)
    table = (1 - albedo) / albedo
    table.flags.writeable = False  # it is kept for the next scene
    return table, ggx.mean_albedo(alpha)
