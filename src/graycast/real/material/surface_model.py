"""The light that a surface should reflect, and the likelihood of the observed light.

The model is the renderer's own BSDF. Its value at a pixel is the mean over the uncertain normal, so
that noise of the normals is not mistaken for roughness.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy import special

from ...world.parts import Material
from .observing import Reflections

Kind: TypeAlias = Literal["metal", "plastic", "scattering metal"]
# These kinds are compared. A scattering metal looks like plastic with a different brightness, so it
# is fitted only to a surface that is known to be metal.
KINDS: tuple[Kind, ...] = ("metal", "plastic")
# A scattering metal has this base colour; a different colour multiplies its light by a factor.
METAL_COLOR = 0.6
FREEDOM = 4.0  # Degrees of freedom of Student's t distribution.
COLORS = (0.0, 0.25, 0.6, 1.0)  # Nodes of base colour; the BSDF is a smooth function of it.
TILTS = 21  # The number of tilts of a normal that represent its uncertainty.
_GOLDEN_RAD = math.pi * (3 - math.sqrt(5))  # Turns by this angle fill a disc evenly.
SCALE_SIGMA = 0.02  # Relative standard deviation of a scale from a white reference, our choice.


def surface(kind: Kind, color: float, roughness: float) -> Material:
    """Return a grey material of a kind; for a scattering metal, `color` is its scattered share."""
    if kind == "scattering metal":
        grey = (METAL_COLOR,) * 3
        return Material(base_color=grey, metallic=1.0, roughness=roughness, diffuse=color)
    metallic = float(kind == "metal")
    return Material(base_color=(color,) * 3, metallic=metallic, roughness=roughness)


class SurfaceModel:
    """The BSDF of the pixels, as a function of kind, colour and roughness."""

    def __init__(self, observations: Reflections, scale: float | None, weight: float):
        self.observations, self.scale, self.weight = observations, scale, weight
        self.directions = _tilted(observations)
        self._nodes: dict[tuple[Kind, float], np.ndarray] = {}

    def nodes(self, kind: Kind, roughness: float) -> Float[np.ndarray, "colors 2 n"]:
        """Return the BSDF's mean and variance over the normals, at each node of base colour."""
        key = kind, roughness
        if key not in self._nodes:
            reflected = _reflected_share()
            count = len(self.observations)
            rows = []
            for color in COLORS:
                value = reflected(surface(kind, color, roughness), *self.directions)
                value = value.reshape(TILTS, count)
                rows.append([value.mean(axis=0), value.var(axis=0)])
            self._nodes[key] = np.array(rows)
        return self._nodes[key]

    def score(
        self,
        nodes: Float[np.ndarray, "colors 2 n"],
        color: float,
        scale: float,
        scatter: float,
    ) -> float:
        """Return the log likelihood of all windows, and of the scale."""
        density = self.densities(nodes, color, scale, scatter)
        score = self.weight * float(density.sum())
        if self.scale is not None:
            score -= 0.5 * (math.log(scale / self.scale) / SCALE_SIGMA) ** 2
        return score

    def densities(
        self,
        nodes: Float[np.ndarray, "colors 2 n"],
        color: float,
        scale: float,
        scatter: float,
    ) -> Float[np.ndarray, " n"]:
        """Return the log density of each pixel's light; if clipped, that of brighter light."""
        own = self.observations
        mean, variance = np.tensordot(color_weights(color), nodes, axes=1)
        mean, variance = np.maximum(mean, 1e-9), np.maximum(variance, 0)
        sigma = np.sqrt(own.sigma**2 + scale**2 * (scatter**2 * mean**2 + variance))
        off = (own.light - scale * mean) / sigma
        density = _LOG_PEAK - 0.5 * (FREEDOM + 1) * np.log1p(off**2 / FREEDOM) - np.log(sigma)
        density[own.clipped] = _log_above(off[own.clipped])
        return density


_LOG_PEAK = (
    special.gammaln(0.5 * (FREEDOM + 1))
    - special.gammaln(0.5 * FREEDOM)
    - 0.5 * math.log(FREEDOM * math.pi)
)


def _log_above(off: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the logarithm of the probability of a larger residual."""
    return np.log(np.maximum(special.stdtr(FREEDOM, -off), 1e-12))


def color_weights(color: float) -> Float[np.ndarray, " colors"]:
    """Return each node's weight, at a base colour, in the polynomial through all nodes."""
    return np.array([math.prod((color - b) / (a - b) for b in COLORS if b != a) for a in COLORS])


def _tilted(own: Reflections) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Return the directions to camera and projector in the frames of TILTS possible normals.

    The tilts of a pixel follow a normal distribution in two dimensions.
    """
    along = own.to_camera - (own.to_camera * own.normal).sum(axis=-1, keepdims=True) * own.normal
    size = np.linalg.norm(along, axis=-1, keepdims=True)
    spare = np.cross(own.normal, np.eye(3)[np.abs(own.normal).argmin(axis=-1)])
    along = np.where(size > 1e-6, along, spare)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.cross(own.normal, along)
    order = np.arange(TILTS)
    radius = np.sqrt(-2 * np.log(1 - (order + 0.5) / TILTS))
    cameras, projectors = [], []
    for r, turn in zip(radius, order * _GOLDEN_RAD, strict=True):
        slope = r * own.normal_sigma_rad[:, None]
        normal = own.normal + slope * (math.cos(turn) * along + math.sin(turn) * across)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        x = along - (along * normal).sum(axis=-1, keepdims=True) * normal
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        frame = np.stack([x, np.cross(normal, x), normal], axis=1)
        cameras.append(np.einsum("nij,nj->ni", frame, own.to_camera))
        projectors.append(np.einsum("nij,nj->ni", frame, own.to_projector))
    return np.concatenate(cameras), np.concatenate(projectors)


@lru_cache
def _reflected_share() -> Callable[..., Float[np.ndarray, " n"]]:
    """Open the renderer's device, and return its BSDF as a function."""
    from ...rendering.device import choose_device, open_device

    open_device(choose_device("cpu"))
    from ...rendering.mitsuba.lobe import reflected_share

    return reflected_share


def mean_light(observations: Reflections, material: Material) -> Float[np.ndarray, " n"]:
    """Return the modelled `f cos(theta)` of each pixel, as the mean over its uncertain normal."""
    value = _reflected_share()(material, *_tilted(observations))
    return value.reshape(TILTS, len(observations)).mean(axis=0)
