"""Reflectance that varies from place to place, as a Mitsuba texture that needs no uv.

The reflectance of the base is multiplied by `1 + spread u`, where u is a random field over the
places of a part in its own frame: its mean is 0, its standard deviation 1, and the correlation of
two places at the distance r is about `exp(-(r / length)^2)`. u is uniformly distributed, so it has
the limit `MOTTLE_PEAK` and reflectance needs no clipping, which would change its mean.

The field is one volume of numbers, read with linear interpolation and repeated in space. Its axes
are rotated relative to the part's axes, so a flat face does not repeat the same section.

Leaves out: varying slopes and roughness, which make glints, and a grain that is longer in one
direction.
"""

from functools import lru_cache
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np
from jaxtyping import Float, Float32
from scipy.ndimage import convolve1d, gaussian_filter
from scipy.special import erf

from ...base.frames import axis_rotation

PLACE = "vertex_place"  # The attribute of a mesh with places in the frame of the part [m]
_VOXELS, _LENGTH_VOXELS, _SEED = 96, 4, 11
_TURN = axis_rotation("x", 0.6) @ axis_rotation("y", 1.1) @ axis_rotation("z", 0.3)
_STEP = np.array([0.8191725, 0.6710436, 0.5497005])  # M. Roberts' R3 sequence fills a cube evenly.


@final
class Mottled(mi.Texture):
    """A texture with the properties `base` (texture), `spread`, and `length` [m]."""

    def __init__(self, props: mi.Properties):
        super().__init__(props)
        self.base = props.get_texture("base")
        # Opaque, because a literal would force a new compilation for every spread and length.
        self.spread = dr.opaque(mi.Float, float(props["spread"]))
        self.turn = mi.Matrix3f(_TURN / _period_m(float(props["length"])))
        dr.make_opaque(self.turn)
        field = mi.TensorXf(mottle_field()[..., None])
        self.field = mi.Texture3f(field, use_accel=False, wrap_mode=dr.WrapMode.Repeat)

    def eval(self, si, active=True):
        return self.base.eval(si, active) * self._factor(si, active)

    def eval_1(self, si, active=True):
        return self.base.eval_1(si, active) * self._factor(si, active)

    def eval_3(self, si, active=True):
        return self.base.eval_3(si, active) * self._factor(si, active)

    def _factor(self, si, active) -> mi.Float:
        place = mi.Point3f(si.shape.eval_attribute_3(PLACE, si, active))
        return dr.fma(self.spread, self.field.eval(self.turn @ place, active)[0], 1)

    def mean(self):
        return self.base.mean()

    def is_spatially_varying(self):
        return True

    def to_string(self):
        return f"Mottled[spread={self.spread}]"

    def traverse(self, callback):
        callback.put("base", self.base, mi.ParamFlags.Differentiable)


def places(
    corner_m: Float[np.ndarray, "corners 3"], copies: int, length_m: float
) -> Float[np.ndarray, "copies corners 3"]:
    """Return the places of corners in the field; each copy of a part has its own section."""
    offset_m = _period_m(length_m) * np.arange(copies)[:, None, None] * _STEP
    return corner_m + offset_m


def _period_m(length_m: float) -> float:
    return length_m * _VOXELS / _LENGTH_VOXELS


@lru_cache
def mottle_field() -> Float32[np.ndarray, "z y x"]:
    """Return the field u: white noise, blurred and then mapped to a uniform distribution.

    The blur gives correlations of `exp(-(r / 4)^2)` between voxels. The uniform distribution
    shortens the length at which the correlation is 1/e by 2 %, and linear interpolation, which also
    lowers the variance, makes it 2 % longer.
    """
    noise = np.random.default_rng(_SEED).standard_normal((_VOXELS,) * 3)
    normal = gaussian_filter(noise, _LENGTH_VOXELS / 2, mode="wrap")
    field = erf((normal - normal.mean()) / (normal.std() * np.sqrt(2)))
    field -= field.mean()
    between = field
    # With these weights, the mean of `field * between` is the mean square after interpolation.
    for axis in range(3):
        between = convolve1d(between, [1 / 6, 2 / 3, 1 / 6], axis=axis, mode="wrap")
    field = (field / np.sqrt((field * between).mean())).astype(np.float32)
    field.flags.writeable = False  # The cache returns the same array for the next scene.
    return field
