"""Clear glass and plastic with smooth surfaces, as Mitsuba BSDFs: solids and thin walls.

Both have only delta distributions, so `eval` and `pdf` are 0. The reflected share follows from
Fresnel's equations for unpolarised light. Leaves out: rough glass, polarisation, dispersion.
"""

from typing import final

import drjit as dr
import mitsuba as mi

MIRRORED, REFRACTED = int(mi.BSDFFlags.DeltaReflection), int(mi.BSDFFlags.DeltaTransmission)
BLACK = 1e-12  # Lower limit of the colour, because 0 times infinity would be NaN.


class _DeltaBSDF(mi.BSDF):
    """Base class of glass BSDFs, with the properties `reflectance` (colour) and `eta` (index)."""

    def __init__(self, props: mi.Properties, flags: int):
        super().__init__(props)
        self.color = props.get_texture("reflectance")
        # Opaque, because a literal would force a new compilation of the kernel for every glass.
        self.eta = dr.opaque(mi.Float, float(props["eta"]))
        self.m_flags = flags
        self.m_components = [int(flags)]

    def eval_pdf(self, context, si, wo, active):
        return mi.Color3f(0), mi.Float(0)

    def eval(self, context, si, wo, active):
        return mi.Color3f(0)

    def pdf(self, context, si, wo, active):
        return mi.Float(0)

    def eval_diffuse_reflectance(self, si, active):
        """Return 0, because the denoiser uses the albedo of the surface behind the glass."""
        return mi.Color3f(0)


@final
class Dielectric(_DeltaBSDF):
    """The surface of a solid. Its additional property is `color_depth` [m].

    On its way inside the solid, a ray loses light by Beer's law: after a length t, the remaining
    share is the colour to the power `t / color_depth`.

    Where light enters the solid, radiance grows by the square of the index; paths from the camera
    have the inverse factor. Paths from the projector carry power, which does not change (E. Veach
    1997, section 5.2), even under interpolated normals, as the true surface is smooth.
    """

    def __init__(self, props: mi.Properties):
        flags = mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission
        flags |= mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        super().__init__(props, flags)
        self.color_depth = dr.opaque(mi.Float, float(props["color_depth"]))

    def sample(self, context, si, sample1, sample2, active):
        cosine = mi.Frame3f.cos_theta(si.wi)
        reflectance, cos_t, eta_it, eta_ti = mi.fresnel(cosine, self.eta)
        mirrored = sample1 < reflectance
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = dr.select(mirrored, mi.reflect(si.wi), mi.refract(si.wi, cos_t, eta_ti))
        bs.pdf = dr.select(mirrored, reflectance, 1 - reflectance)
        bs.eta = dr.select(mirrored, 1, eta_it)
        bs.sampled_type = dr.select(mirrored, mi.UInt32(MIRRORED), REFRACTED)
        color = dr.maximum(self.color.eval(si, active), BLACK)
        weight = dr.exp(dr.log(color) * dr.select(cosine < 0, si.t / self.color_depth, 0))
        if context.mode == mi.TransportMode.Radiance:
            weight *= dr.select(mirrored, 1, dr.square(eta_ti))
        return bs, dr.select(active, weight, 0)


@final
class ThinDielectric(_DeltaBSDF):
    """A thin wall with two parallel surfaces, for light from both sides.

    If one surface reflects the share R, the wall reflects `2 R / (1 + R)` and transmits
    `(1 - R) / (1 + R)`, times the colour, with all reflections between its surfaces. In
    `mitsuba/sight.py`, rays pass the wall; only the other rays use the BSDF, which mirrors them.

    Leaves out: the parallel shift of transmitted rays; the effect of the angle on the colour.
    """

    def __init__(self, props: mi.Properties):
        flags = mi.BSDFFlags.DeltaReflection
        super().__init__(props, flags | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide)

    def sample(self, context, si, sample1, sample2, active):
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo, bs.pdf, bs.eta = mi.reflect(si.wi), mi.Float(1), 1.0
        bs.sampled_type = mi.UInt32(MIRRORED)
        return bs, dr.select(active, mi.Color3f(1), 0)

    def passing(self, si) -> tuple[mi.Float, mi.Color3f]:
        """Return the share of light that is transmitted, and the colour that multiplies it."""
        cosine = dr.abs(mi.Frame3f.cos_theta(si.wi))
        reflectance = mi.fresnel(cosine, self.eta)[0]
        return (1 - reflectance) / (1 + reflectance), self.color.eval(si, True)
