"""A rough metal that loses no light among its facets, as a Mitsuba BSDF.

One reflection off GGX facets, `F D G2 / (4 cos cos)`, returns a share `E` of the light. For a white
metal under uniform light this is 0.88 at roughness 0.5 and 0.41 at 1. The remaining light meets
other facets and leaves later. It is added in the directions of the first lobe,

    f = f_single (1 + F_ms (1 - E) / E),    F_ms = F_avg E_avg / (1 - F_avg (1 - E_avg)),

where `E` belongs to the direction in which light leaves (from which a path from the camera
arrives), `E_avg` is its cosine-weighted mean, and `F_avg = F0 + (1 - F0) / 21` is the mean of
Schlick's Fresnel term. A white metal returns all light, and repeated reflection deepens colours.

The metal of Blender's Principled BSDF agrees with this to 0.3 % in all cases tested
(`tests/rendering/test_materials_in_both.py`).

With grooves, facets have two widths, along x and y of a frame along the grain. The mesh attribute
`vertex_grain` has the direction of the grooves in world coordinates. At a hit it is projected onto
the plane of the shading normal. Without a direction, the grain is along x of the shading frame.
Single grooves are not modelled, so there are no glints and no rainbow of fine grooves.

If roughness varies, `E` is interpolated linearly between the widths `ggx.ALPHAS`: a white metal
conserves energy to 0.4 %.

Leaves out: the wider lobe of light that is reflected many times; a complex index, and so the dip of
reflectance before grazing incidence. The BSDF is not reciprocal, because `E` depends on only one of
the two directions: the two ways differ by the ratio of `1 + F_ms (1 - E) / E`, which for a white
metal within 60 degrees of the normal is 2 % at roughness 0.3, 7 % at 0.5 and 47 % at 1.

Sources: C. Kulla & A. Conty, "Revisiting Physically Based Shading at Imageworks", SIGGRAPH 2017
course (F_ms); E. Turquin, "Practical Multiple Scattering Compensation for Microfacet Models",
Industrial Light & Magic, 2019 (scaled lobe); C. Schlick, CGF 13(3), 1994 (F).
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from . import ggx

GRAIN = "vertex_grain"


@final
class RoughConductor(ggx.GlossyBSDF):
    """A BSDF with `reflectance` (texture) at normal incidence, and `alpha` (GGX) or `roughness`.

    With a property `alpha_across`, `alpha` applies only along x, and `alpha_across` along y.
    """

    def __init__(self, props: mi.Properties):
        super().__init__(props, mi.BSDFFlags.GlossyReflection)
        if self.roughness is not None:
            self.energy, self.mean = map(mi.Float, energy_shares())
            return
        along = across = float(props["alpha"])
        if "alpha_across" in props:
            across = float(props["alpha_across"])
            self.alpha = mi.Vector2f(self.alpha, dr.opaque(mi.Float, across))
        lost, mean = lost_share(along, across)
        self.mean = dr.opaque(mi.Float, mean)
        self.lost = [mi.Float(table) for table in lost.astype(np.float32)]

    def reflected(self, si, wo, cos_i, cos_o, active):
        alpha = self.alpha_at(si, active)
        half = dr.normalize(si.wi + wo)
        shape, pdf = ggx.single_reflection(si.wi, wo, half, alpha)
        length_i = dr.norm(ggx.stretched(si.wi, alpha))
        return self._returned(si, alpha, dr.dot(si.wi, half), length_i, active) * shape, pdf

    def sample(self, context, si, sample1, sample2, active):
        alpha = self.alpha_at(si, active)
        half = ggx.sample_visible(si.wi, alpha, sample2)
        cos_half = dr.dot(si.wi, half)
        wo = dr.fma(2 * cos_half, half, -si.wi)
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active &= (cos_i > 0) & (cos_o > 0)
        length_i = dr.norm(ggx.stretched(si.wi, alpha))
        length_o = dr.norm(ggx.stretched(wo, alpha))
        both = cos_i + length_i
        passed = cos_o * both / dr.fma(length_i, cos_o, length_o * cos_i)  # G2 / G1
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.eta = wo, 1.0
        bs.pdf = dr.select(active, 0.5 * ggx.distribution(half, alpha) / both, 0)
        bs.sampled_type, bs.sampled_component = mi.UInt32(self.m_components[0]), mi.UInt32(0)
        weight = self._returned(si, alpha, cos_half, length_i, active) * passed
        return bs, dr.select(active, weight, 0)

    def _returned(
        self, si, alpha: ggx.Alpha, cos_half: mi.Float, length_i: mi.Float, active
    ) -> mi.Color3f:
        """Return the Fresnel reflectance times the factor for multiple scattering."""
        normal = self.reflectance.eval(si, active)
        fresnel, mean = ggx.schlick(normal, cos_half), self.mean
        if self.roughness is not None:
            mean = ggx.between_rows(alpha, lambda row: dr.gather(mi.Float, self.mean, row))
        later = ggx.coming_later(normal, mean)
        return fresnel * dr.fma(later, self._lost(si.wi, alpha, length_i), 1)

    def _lost(self, wi: mi.Vector3f, alpha: ggx.Alpha, length_i: mi.Float) -> mi.Float:
        """Return `(1 - E) / E`; with grooves (facets wider along y) it also depends on azimuth."""
        cosine = mi.Frame3f.cos_theta(wi) / length_i
        if self.roughness is not None:
            energy = ggx.between_rows(alpha, lambda row: ggx.interpolated(self.energy, cosine, row))
            return dr.rcp(energy) - 1
        if len(self.lost) == 1:
            return ggx.interpolated(self.lost[0], cosine)
        x2, y2 = (dr.square(w) for w in ggx.stretched(wi, alpha)[:2])
        twice = (x2 - y2) / dr.maximum(x2 + y2, 1e-12)  # Cosine of twice the azimuth
        middle, slope, bend = (ggx.interpolated(table, cosine) for table in self.lost)
        return dr.fma(dr.fma(bend, twice, slope), twice, middle)


@final
class BrushedConductor(ggx.GlossyBSDF):
    """A metal with grooves. Properties: like `RoughConductor`, with `alpha` along the grain."""

    def __init__(self, props: mi.Properties):
        super().__init__(props, mi.BSDFFlags.GlossyReflection)
        self.metal = RoughConductor(props)

    def eval_pdf(self, context, si, wo, active):
        si, cosine, sine = self._along_grain(si, active)
        return self.metal.eval_pdf(context, si, _turned(wo, cosine, -sine), active)

    def sample(self, context, si, sample1, sample2, active):
        si, cosine, sine = self._along_grain(si, active)
        bs, weight = self.metal.sample(context, si, sample1, sample2, active)
        bs.wo = _turned(bs.wo, cosine, sine)
        return bs, weight

    def _along_grain(self, si, active) -> tuple[mi.SurfaceInteraction3f, mi.Float, mi.Float]:
        """Return the hit in a frame along the grain, and cosine and sine of the rotation to it."""
        grain = si.to_local(mi.Vector3f(si.shape.eval_attribute_3(GRAIN, si, active)))
        length = dr.hypot(grain.x, grain.y)
        cosine = dr.select(length > 0, grain.x / length, 1)
        sine = dr.select(length > 0, grain.y / length, 0)
        si = mi.SurfaceInteraction3f(si)
        si.wi = _turned(si.wi, cosine, -sine)
        return si, cosine, sine


def _turned(w: mi.Vector3f, cosine: mi.Float, sine: mi.Float) -> mi.Vector3f:
    """Return a direction after a rotation about the normal, from x towards y."""
    return mi.Vector3f(dr.fma(cosine, w.x, -sine * w.y), dr.fma(sine, w.x, cosine * w.y), w.z)


@lru_cache
def lost_share(along: float, across: float) -> tuple[np.ndarray, float]:
    """Return `(1 - E) / E` for white GGX facets with two widths, and the mean of `E`.

    Returns:
        A row for `ggx.TABLE` cosines of the STRETCHED direction from 0 to 1, because `E` is smooth
        in it even if alpha is small. With linear interpolation `E (1 + lost)` is 1 to 0.05 %, and
        to 0.3 % beyond 89 degrees. For two widths there are three rows a, b, c: the share is
        `a + b t + c t^2`, where t is the cosine of twice the azimuth of the stretched direction. It
        is exact at 0, 45 and 90 degrees. The sum is then 1 to 0.3 % if `across` is at most 0.8, to
        0.7 % at 1.2 and to 1.4 % at 3.2.
    """
    alphas = along, across
    if along == across:
        tables = _lost_along(alphas, 0.0)[None]
    else:
        x, between, y = (_lost_along(alphas, float(turn)) for turn in np.pi / 4 * np.arange(3))
        tables = np.stack([between, (x - y) / 2, (x + y) / 2 - between])
    tables.flags.writeable = False  # The cache returns the same array for the next scene.
    return tables, ggx.mean_albedo(alphas)


@lru_cache
def energy_shares() -> tuple[np.ndarray, np.ndarray]:
    """Return `E` of white GGX facets and its mean, for each of `ggx.ALPHAS`.

    `E` is a flat array with a row for each alpha, over the cosine of `lost_share`.
    """
    tables = [lost_share(alpha, alpha) for alpha in ggx.ALPHAS.tolist()]
    energy = 1 / (1 + np.concatenate([lost[0] for lost, _ in tables]))
    shares = energy.astype(np.float32), np.array([mean for _, mean in tables], dtype=np.float32)
    for table in shares:
        table.flags.writeable = False  # The cache returns the same array for the next scene.
    return shares


def _lost_along(alphas: tuple[float, float], azimuth_rad: float) -> np.ndarray:
    """Return `(1 - E) / E` over the cosine of the stretched direction, at one azimuth."""
    wi = ggx.leaning(np.linspace(0, 1, ggx.TABLE), azimuth_rad)
    wi[:, :2] /= alphas
    albedo = ggx.directional_albedo(wi / np.linalg.norm(wi, axis=1, keepdims=True), alphas)
    return (1 - albedo) / albedo
