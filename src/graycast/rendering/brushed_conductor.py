"""A rough metal with grooves, as a Mitsuba BSDF: `RoughConductor` in a frame along the grain.

The mesh attribute `vertex_grain` has the direction of the grooves in world coordinates. At a hit it
is projected onto the plane of the shading normal; there the facets have one width along it and
another across it. A hit without a direction has its grain along the shading frame's x.

Leaves out: the single grooves, and so glints and the rainbow that fine ones make.

Imported only by `mitsuba_scene.py`, after a variant was set.
"""

from typing import final

import drjit as dr
import mitsuba as mi

from . import ggx
from .rough_conductor import RoughConductor

GRAIN = "vertex_grain"


@final
class BrushedConductor(ggx.GlossyBSDF):
    """Properties: those of `RoughConductor`, `alpha` along the grain and `alpha_across` it."""

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.metal = RoughConductor(props)
        self.m_flags, self.m_components = self.metal.m_flags, self.metal.m_components

    def eval_pdf(self, context, si, wo, active):
        si, cosine, sine = self._along_grain(si, active)
        return self.metal.eval_pdf(context, si, _turned(wo, cosine, -sine), active)

    def sample(self, context, si, sample1, sample2, active):
        si, cosine, sine = self._along_grain(si, active)
        bs, weight = self.metal.sample(context, si, sample1, sample2, active)
        bs.wo = _turned(bs.wo, cosine, sine)
        return bs, weight

    def to_string(self):
        return f"BrushedConductor[alpha={self.metal.alpha}]"

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
