"""A material's reflection between two directions, from the BSDF that also renders scenes."""

import mitsuba as mi
import numpy as np
from jaxtyping import Float

from ...world.parts import Material
from .scene import load_bsdf


def reflected_share(
    material: Material, to_camera: Float[np.ndarray, "n 3"], to_light: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return `f cos(theta)` [sr^-1] of the first colour band, with theta between normal and light.

    Args:
        material: an opaque material without pictures and grooves, which depend on the place.
        to_camera: unit vectors to the camera in the surface's frame, where z is the normal.
        to_light: unit vectors to the light in the same frame.
    """
    count = len(to_camera)
    hit = mi.SurfaceInteraction3f()
    hit.t = mi.Float(np.ones(count, dtype=np.float32))
    hit.wi = mi.Vector3f(np.ascontiguousarray(to_camera.T, dtype=np.float32))
    light = mi.Vector3f(np.ascontiguousarray(to_light.T, dtype=np.float32))
    bsdf = load_bsdf(material)
    return np.array(bsdf.eval(mi.BSDFContext(), hit, light, True)[0], dtype=np.float64)
