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

With grooves, facets have two widths, along x and y of a frame along the grain. The mesh attribute
`vertex_grain` has the direction of the grooves in world coordinates. At a hit it is projected onto
the plane of the shading normal. A hit without a direction has its grain along the shading frame's
x. Left out are the single grooves, and so glints and the rainbow that fine ones make.

Where roughness varies, `E` is linear between the widths `ggx.ALPHAS`: white metal returns all light
to 0.4 %.

Leaves out: that light reflected many times leaves in directions of its own, wider than the first
lobe. Since `E` is taken at one of the two directions, light may not run backwards: the two ways
differ by the ratio of `1 + F_ms (1 - E) / E`, which for white metal within 60 degrees of the normal
is 2 % at roughness 0.3, 7 % at 0.5 and 47 % at 1. No complex index, so no dip of the reflectance
before grazing incidence.

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
    """Properties: `reflectance` (texture) at normal incidence, `alpha` (GGX) or `roughness`.

    With a property `alpha_across`, `alpha` is that along x alone, and this that along y.
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
        """Fresnel's share, and what comes back after the first reflection."""
        normal = self.reflectance.eval(si, active)
        fresnel, mean = ggx.schlick(normal, cos_half), self.mean
        if self.roughness is not None:
            mean = ggx.between_rows(alpha, lambda row: dr.gather(mi.Float, self.mean, row))
        later = ggx.coming_later(normal, mean)
        return fresnel * dr.fma(later, self._lost(si.wi, alpha, length_i), 1)

    def _lost(self, wi: mi.Vector3f, alpha: ggx.Alpha, length_i: mi.Float) -> mi.Float:
        """`(1 - E) / E`; by the azimuth, too, where grooves make facets wider along y than x."""
        cosine = mi.Frame3f.cos_theta(wi) / length_i
        if self.roughness is not None:
            energy = ggx.between_rows(alpha, lambda row: ggx.interpolated(self.energy, cosine, row))
            return dr.rcp(energy) - 1
        if len(self.lost) == 1:
            return ggx.interpolated(self.lost[0], cosine)
        x2, y2 = (dr.square(w) for w in ggx.stretched(wi, alpha)[:2])
        twice = (x2 - y2) / dr.maximum(x2 + y2, 1e-12)  # the cosine of twice the azimuth
        middle, slope, bend = (ggx.interpolated(table, cosine) for table in self.lost)
        return dr.fma(dr.fma(bend, twice, slope), twice, middle)


@final
class BrushedConductor(ggx.GlossyBSDF):
    """A metal with grooves. Properties: as of `RoughConductor`, `alpha` along the grain."""

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
        """The hit in a frame along the grain; cosine and sine of the turn that leads there."""
        grain = si.to_local(mi.Vector3f(si.shape.eval_attribute_3(GRAIN, si, active)))
        length = dr.hypot(grain.x, grain.y)
        cosine = dr.select(length > 0, grain.x / length, 1)
        sine = dr.select(length > 0, grain.y / length, 0)
        si = mi.SurfaceInteraction3f(si)
        si.wi = _turned(si.wi, cosine, -sine)
        return si, cosine, sine


def _turned(w: mi.Vector3f, cosine: mi.Float, sine: mi.Float) -> mi.Vector3f:
    """Turned about the normal, from x towards y."""
    return mi.Vector3f(dr.fma(cosine, w.x, -sine * w.y), dr.fma(sine, w.x, cosine * w.y), w.z)


@lru_cache
def lost_share(along: float, across: float) -> tuple[np.ndarray, float]:
    """`(1 - E) / E` of white GGX facets with these widths along x and y, and the mean of `E`.

    Returns:
        The first at `ggx.TABLE` values from 0 to 1 of the cosine of the STRETCHED direction, in
        which `E` is smooth however small alpha is, as one row; linear between them, `E (1 + lost)`
        is 1 to 0.05 %, and 0.3 % beyond 89 degrees. Of two widths there are three rows a, b, c: the
        share is `a + b t + c t^2` with the cosine t of twice the azimuth of the stretched
        direction, right at 0, 45 and 90 degrees; then it is 1 to 0.3 % where `across` is at most
        0.8, 0.7 % at 1.2 and 1.4 % at 3.2.
    """
    alphas = along, across
    if along == across:
        tables = _lost_along(alphas, 0.0)[None]
    else:
        x, between, y = (_lost_along(alphas, float(turn)) for turn in np.pi / 4 * np.arange(3))
        tables = np.stack([between, (x - y) / 2, (x + y) / 2 - between])
    tables.flags.writeable = False  # it is kept for the next scene
    return tables, ggx.mean_albedo(alphas)


@lru_cache
def energy_shares() -> tuple[np.ndarray, np.ndarray]:
    """`E` of white GGX facets, a row over `lost_share`'s cosine for each of `ggx.ALPHAS`, and its
    mean for each. The rows follow one another.
    """
    tables = [lost_share(alpha, alpha) for alpha in ggx.ALPHAS.tolist()]
    energy = 1 / (1 + np.concatenate([lost[0] for lost, _ in tables]))
    shares = energy.astype(np.float32), np.array([mean for _, mean in tables], dtype=np.float32)
    for table in shares:
        table.flags.writeable = False  # it is kept for the next scene
    return shares


def _lost_along(alphas: tuple[float, float], azimuth_rad: float) -> np.ndarray:
    """`(1 - E) / E` over the cosine of the stretched direction, at one azimuth of it."""
    wi = ggx.leaning(np.linspace(0, 1, ggx.TABLE), azimuth_rad)
    wi[:, :2] /= alphas
    albedo = ggx.directional_albedo(wi / np.linalg.norm(wi, axis=1, keepdims=True), alphas)
    return (1 - albedo) / albedo
