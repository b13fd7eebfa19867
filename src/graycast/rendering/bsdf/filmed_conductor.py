"""A rough metal under a clear film, such as oil or lacquer, as a Mitsuba BSDF.

The surface of the film reflects a share `E_c` of the light, like the coat of `coated_diffuse.py`.
The rest `T = 1 - E_c` is refracted into the film of index n, reflected by the metal's facets, and
refracted out again, so the lobe of the metal is about n times as wide as in air:

    f = f_coat + K(i) T(o) f_1(i', o') / n^2,    K = T + F_ms T (1 - S) / S,

where i', o' are the directions inside, `f_1` is the metal's single reflection of
`rough_conductor.py`, and `S(i)` is the share of light that leaves a white metal and the film after
it. Light that facets or film send back leaves later, in the same lobe. Its share is
`F_ms = F_avg S_2 / (1 - F_avg (1 - S_2))`, where `S_2` leaves after its second reflection. A white
metal returns all light. The limit for smooth surfaces is `T^2 R / (1 - R E_c)`.

The metal's reflectance must be given for metal in the film, where it is lower than in air: for iron
in oil it is 0.38 instead of 0.51.

Leaves out: absorption and interference, so the film is clear and thicker than a few micrometres;
the wider lobe of light that is reflected many times. The BSDF is not reciprocal, because `K`
depends on only one direction.

Sources: A. Weidlich & A. Wilkie, "Arbitrarily Layered Micro-Facet Surfaces", GRAPHITE 2007
(refracted lobe); E. Turquin, 2019, and C. Kulla & A. Conty, 2017, as in `rough_conductor.py`.
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from . import ggx
from .coated_diffuse import coat_albedo


@final
class FilmedConductor(ggx.GlossyBSDF):
    """A BSDF with `reflectance` (texture) and `alpha` of the metal, `film_alpha` and `eta`."""

    def __init__(self, props: mi.Properties):
        super().__init__(props, mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.GlossyReflection)
        alpha, film_alpha, eta = (float(props[key]) for key in ("alpha", "film_alpha", "eta"))
        coat, later, second = film_shares(alpha, film_alpha, eta)
        self.coat, self.later = mi.Float(coat), mi.Float(later)
        self.film_alpha, self.eta, self.second = (
            dr.opaque(mi.Float, value) for value in (film_alpha, eta, second)
        )

    def reflected(self, si, wo, cos_i, cos_o, active):
        half = dr.normalize(si.wi + wo)
        film, film_pdf = ggx.single_reflection(si.wi, wo, half, self.film_alpha)
        film *= mi.fresnel(dr.dot(si.wi, half), self.eta)[0]
        inside_i, inside_o = self._refracted(si.wi), self._refracted(wo)
        half = dr.normalize(inside_i + inside_o)
        metal, metal_pdf = ggx.single_reflection(inside_i, inside_o, half, self.alpha)
        # A solid angle is n^2 cos / cos_inside times as large above the film as inside it.
        narrower = cos_o / (dr.square(self.eta) * mi.Frame3f.cos_theta(inside_o))
        metal *= (1 - ggx.interpolated(self.coat, cos_o)) * narrower
        normal = self.reflectance.eval(si, active)
        share = ggx.layer_share(ggx.interpolated(self.coat, cos_i), normal)
        value = self._returned(normal, dr.dot(inside_i, half), cos_i) * metal + film
        return value, dr.lerp(metal_pdf * narrower, film_pdf, share)

    def sample(self, context, si, sample1, sample2, active):
        cos_i = mi.Frame3f.cos_theta(si.wi)
        normal = self.reflectance.eval(si, active)
        of_film = sample1 < ggx.layer_share(ggx.interpolated(self.coat, cos_i), normal)
        inside = self._refracted(si.wi)
        off_film = mi.reflect(si.wi, ggx.sample_visible(si.wi, self.film_alpha, sample2))
        off_metal = mi.reflect(inside, ggx.sample_visible(inside, self.alpha, sample2))
        x, y = self.eta * off_metal.x, self.eta * off_metal.y
        up2 = 1 - dr.square(x) - dr.square(y)  # Negative for total reflection inside the film
        active &= (cos_i > 0) & (of_film | ((off_metal.z > 0) & (up2 > 0)))
        wo = dr.select(of_film, off_film, mi.Vector3f(x, y, dr.safe_sqrt(up2)))
        return self.layer_sample(context, si, wo, of_film, active)

    def _refracted(self, w: mi.Vector3f) -> mi.Vector3f:
        """Refract a direction above the film into it; both directions point away from the metal."""
        x, y = w.x / self.eta, w.y / self.eta
        return mi.Vector3f(x, y, dr.safe_sqrt(1 - dr.square(x) - dr.square(y)))

    def _returned(self, normal: mi.Color3f, cos_half: mi.Float, cos_i: mi.Float) -> mi.Color3f:
        """Return the metal's Fresnel reflectance times `K`."""
        fresnel = ggx.schlick(normal, cos_half)
        again = ggx.coming_later(normal, self.second)
        later = ggx.interpolated(self.later, cos_i)
        return fresnel * dr.fma(again, later, 1 - ggx.interpolated(self.coat, cos_i))


@lru_cache
def film_shares(
    alpha: float, film_alpha: float, eta: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Compute the shares of light that a film on a white metal reflects and lets out.

    Returns:
        `E_c` and `T (1 - S) / S`, one value for each of `ggx.TABLE` cosines from 0 to 1 above the
        film; and `S_2`.
    """
    cosine = np.linspace(0, 1, ggx.TABLE)
    coat = coat_albedo(film_alpha, eta)

    def leaving(cos_inside: np.ndarray) -> np.ndarray:
        """Return the share that the film's surface lets out at an angle; 0 for total reflection."""
        up2 = 1 - eta**2 * (1 - cos_inside**2)
        out = np.interp(np.sqrt(np.maximum(up2, 0)), cosine, 1 - coat)
        return np.where(up2 > 0, out, 0.0)

    def once(inside: np.ndarray) -> np.ndarray:
        """Return the share of light from these directions that leaves after one reflection."""
        met = (ggx.facets(w, (alpha, alpha)) for w in inside)
        return np.array([(leaving(up) * passed).mean() for _, up, passed in met])

    inside = ggx.leaning(np.sqrt(1 - (1 - cosine**2) / eta**2))
    first, of_inside = once(inside), once(ggx.leaning(cosine))
    # Light that was sent back meets the metal at about the angle at which it left the metal.
    weight = cosine * (1 - coat)
    met = [ggx.facets(w, (alpha, alpha))[1:] for w in inside]
    stays = np.array([1 - leaving(up) * passed for up, passed in met])
    again = np.array([np.interp(np.abs(up), cosine, of_inside) for up, _ in met])
    second = float((weight @ (stays * again)).sum() / (weight @ stays).sum())
    later = (1 - coat) * (1 - first) / first
    later.flags.writeable = False  # The cache returns the same array for the next scene.
    return coat, later, second
