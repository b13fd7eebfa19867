"""Clear glass and plastic with smooth surfaces, as Mitsuba BSDFs: solid, or a wall without depth.

Both have delta distributions alone: `eval` and `pdf` are 0. Fresnel's equations for unpolarised
light say how much is mirrored. Leaves out: rough glass, polarisation, dispersion.
"""

from typing import final

import drjit as dr
import mitsuba as mi

MIRRORED, REFRACTED = int(mi.BSDFFlags.DeltaReflection), int(mi.BSDFFlags.DeltaTransmission)
BLACK = 1e-12  # A black solid leaves so much, not 0, for 0 times infinity is no number.


class _DeltaBSDF(mi.BSDF):
    """What both share. Properties: `reflectance` (texture), the colour; `eta`, the index."""

    def __init__(self, props: mi.Properties, flags: int):
        super().__init__(props)
        self.color = props.get_texture("reflectance")
        # Opaque: literals would be compiled into the kernel, anew for every glass.
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
        """None: the denoiser's albedo is that of the surface behind."""
        return mi.Color3f(0)


@final
class Dielectric(_DeltaBSDF):
    """The surface of a solid. A further property: `color_depth` [m].

    A ray that hits it from inside has lost light since the last surface by Beer's law: of
    `color_depth` it leaves the colour, of a length t the colour to the power `t / color_depth`.

    Radiance grows by the square of the index where light goes in, which paths from the camera
    undo; those from the projector carry power, which stays (E. Veach 1997, section 5.2), also under
    interpolated normals, as behind the smooth surface that the mesh stands for.
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
    """A wall of two parallel surfaces without depth, lit and seen from both sides.

    With one surface's reflectance R and all reflections between both, `2 R / (1 + R)` is mirrored
    and `(1 - R) / (1 + R)` goes straight on, times the colour. Rays pass it in `mitsuba_sight.py`;
    the BSDF is asked by those that do not, and mirrors them.

    Leaves out: the shift of what is behind, and that colours depend on the angle.
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
        """The share of light that goes straight on, and the colour that this takes on."""
        cosine = dr.abs(mi.Frame3f.cos_theta(si.wi))
        reflectance = mi.fresnel(cosine, self.eta)[0]
        return (1 - reflectance) / (1 + reflectance), self.color.eval(si, True)
