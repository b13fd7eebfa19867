"""A rough clear coat over a diffuse base that conserves energy, as a Mitsuba BSDF.

Mitsuba's `roughplastic` loses light that its single-scattering coat neither reflects nor lets
through, a fifth at roughness 0.5 and two thirds at 1. Here the base gets exactly what the coat does
not reflect: with `E` the coat's directional albedo, the sum is `E + base (1 - E)`, 1 for a white
base.

Leaves out: interreflection between coat and base that would saturate deep colours, and light
scattered twice among the coat's facets, which goes to the base instead.

Source: Kelemen & Szirmay-Kalos, "A Microfacet Based Coupled Specular-Matte BRDF Model with
Importance Sampling", Eurographics 2001; GGX: Walter et al., EGSR 2007.

Imported only by `mitsuba_scene.py`, after a variant was set.
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

TABLE = 64  # nodes over the cosine; linear between them
_FACETS = 64  # squared: midpoints of the visible-normal integral


@final
class CoatedDiffuse(mi.BSDF):
    """Properties: `reflectance` (texture), `alpha` (GGX), `eta` (index of the coat)."""

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.reflectance = props.get_texture("reflectance")
        self.alpha = float(props["alpha"])
        self.eta = float(props["eta"])
        table = coat_albedo(self.alpha, self.eta)
        cosine = np.linspace(0, 1, TABLE)
        self.mean = float(np.trapezoid(2 * cosine * table, cosine))
        self.table = mi.Float(table.astype(np.float32))
        coat = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        base = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [int(coat), int(base)]
        self.m_flags = coat | base

    def eval(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[0]

    def pdf(self, context, si, wo, active):
        return self.eval_pdf(context, si, wo, active)[1]

    def eval_pdf(self, context, si, wo, active):
        """Value times cosine, and solid-angle density."""
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_i > 0) & (cos_o > 0)
        facets = self._facets()
        half = dr.normalize(si.wi + wo)
        fresnel = mi.fresnel(dr.dot(si.wi, half), self.eta)[0]
        coat = fresnel * facets.eval(half) * facets.G(si.wi, wo, half) / (4 * cos_i)
        base = self.reflectance.eval(si, active)
        seen, left = self._albedo(cos_i), 1 - self._albedo(cos_o)
        matte = base * ((1 - seen) * left / (1 - self.mean) * dr.inv_pi * cos_o)
        share = self._coat_share(seen, base)
        coat_pdf = facets.pdf(si.wi, half) / (4 * dr.dot(wo, half))
        pdf = dr.lerp(mi.warp.square_to_cosine_hemisphere_pdf(wo), coat_pdf, share)
        return dr.select(active, coat + matte, 0), dr.select(active, pdf, 0)

    def sample(self, context, si, sample1, sample2, active):
        cos_i = mi.Frame3f.cos_theta(si.wi)
        active &= cos_i > 0
        share = self._coat_share(self._albedo(cos_i), self.reflectance.eval(si, active))
        of_coat = sample1 < share
        half, _ = self._facets().sample(si.wi, sample2)
        wo = dr.select(
            of_coat, mi.reflect(si.wi, half), mi.warp.square_to_cosine_hemisphere(sample2)
        )
        value, pdf = self.eval_pdf(context, si, wo, active)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = wo, pdf, 1.0
        bs.sampled_type = dr.select(of_coat, mi.UInt32(self.m_components[0]), self.m_components[1])
        bs.sampled_component = dr.select(of_coat, mi.UInt32(0), 1)
        active &= pdf > 0
        return bs, dr.select(active, value / pdf, 0)

    def eval_diffuse_reflectance(self, si, active):
        return self.reflectance.eval(si, active)

    def traverse(self, callback):
        callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)

    def to_string(self):
        return f"CoatedDiffuse[alpha={self.alpha}, eta={self.eta}]"

    def _facets(self) -> mi.MicrofacetDistribution:
        return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, sample_visible=True)

    def _albedo(self, cosine: mi.Float) -> mi.Float:
        """The coat's directional albedo, linear between the table's nodes."""
        place = dr.clip(cosine, 0, 1) * (TABLE - 1)
        low = mi.UInt32(dr.minimum(place, TABLE - 2))
        a, b = dr.gather(mi.Float, self.table, low), dr.gather(mi.Float, self.table, low + 1)
        return dr.lerp(a, b, place - low)

    def _coat_share(self, seen: mi.Float, base: mi.Color3f) -> mi.Float:
        """Probability of sampling the coat: its share of what is reflected in all."""
        return seen / (seen + (1 - seen) * dr.mean(base))


@lru_cache
def coat_albedo(alpha: float, eta: float) -> np.ndarray:
    """Share of light that a rough dielectric surface reflects off its facets, per cosine.

    The mean of `F G2 / G1` over visible normals (E. Heitz, JCGT 7(4), 2018) by the midpoint rule.

    Returns:
        One value for each of `TABLE` cosines from 0 to 1.
    """
    node = (np.arange(_FACETS) + 0.5) / _FACETS
    u, v = (axis.ravel() for axis in np.meshgrid(node, node))
    table = np.array([_mean_reflection(c, alpha, eta, u, v) for c in np.linspace(0, 1, TABLE)])
    table.flags.writeable = False  # it is kept for the next scene
    return table


def _mean_reflection(
    cosine: float, alpha: float, eta: float, u: np.ndarray, v: np.ndarray
) -> float:
    cosine = max(cosine, 1e-3)  # grazing: the limit, where `F G2 / G1` is still smooth
    wi = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    # Heitz' sampling: a disk seen from the stretched direction, its far half shifted.
    stretched = wi * [alpha, alpha, 1]
    stretched /= np.linalg.norm(stretched)
    t1 = np.array([0.0, 1.0, 0.0])
    t2 = np.cross(stretched, t1)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    p1, p2 = radius * np.cos(angle), radius * np.sin(angle)
    s = 0.5 * (1 + stretched[2])
    p2 = (1 - s) * np.sqrt(np.maximum(1 - p1**2, 0)) + s * p2
    p3 = np.sqrt(np.maximum(1 - p1**2 - p2**2, 0))
    half = p1[:, None] * t1 + p2[:, None] * t2 + p3[:, None] * stretched
    half = half * [alpha, alpha, 1]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cos_half = half @ wi
    cos_o = (2 * cos_half[:, None] * half - wi)[:, 2]
    return float((np.where(cos_o > 0, _fresnel(cos_half, eta) * _g1(cos_o, alpha), 0)).mean())


def _g1(cosine: np.ndarray, alpha: float) -> np.ndarray:
    """Smith's masking of GGX, which for `G2 = G1(wi) G1(wo)` is what the sampling leaves over."""
    cosine = np.clip(cosine, 1e-6, 1)
    return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)))


def _fresnel(cosine: np.ndarray, eta: float) -> np.ndarray:
    """Unpolarised reflectance of a dielectric from outside."""
    inner = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel = (eta * cosine - inner) / (eta * cosine + inner)
    across = (cosine - eta * inner) / (cosine + eta * inner)
    return 0.5 * (parallel**2 + across**2)
