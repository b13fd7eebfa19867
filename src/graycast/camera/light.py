"""Light on the measuring camera's sensor: rendered light with black level and stray light."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy import fft

from ..base import array_types as arrays
from ..base.public_value import public_value
from ..rendering.radiance import Radiance
from ..rig.pair import Rig

OCTAVES = 6  # The Gaussians of the veil have sigmas of 1/64, 1/32 .. 1/2 of the image's width.
LOW_WIDTH_PX = 128  # The veil is computed at this width, where the smallest sigma is 2 pixels.


@public_value
@dataclass(frozen=True, slots=True)
class SensorLight:
    """Light on the sensor in one exposure [W sr^-1 m^-2]: the projector's in each frame, and other
    light, which is the same in all frames unless the scene moves."""

    stack: arrays.FloatArray_n_h_w
    background: arrays.FloatArray_any  # (h, w), or (n, h, w) for a scene that moves


def camera_light(
    radiance: Radiance, rig: Rig
) -> tuple[Float[np.ndarray, "n h w"], Float[np.ndarray, "h w"]]:
    """Return the projector's light on the sensor for each frame, and all other light (radiance).

    Every projected picture contains `b = 1 / contrast_ratio` of white, so pattern k becomes
    `(1 - b) pattern_k + b white`. Then the camera's lens spreads the share `rig.veil` of all light
    over the image (see `veiled`). Without either effect, the renderer's own array is returned.

    Leaves out: stray light from outside the image; ghost images of single lights.
    """
    black = 1 / rig.contrast_ratio
    stack, background = radiance.pattern, radiance.ambient
    if black:
        stack = stack * np.float32(1 - black)
        stack += np.float32(black) * radiance.white
    if rig.veil:
        stack = stack if black else stack.copy()
        for image in stack:
            image[:] = veiled(image, rig.veil)
        background = veiled(background, rig.veil)
    return stack, background


def veiled(image: Float[np.ndarray, "h w"], share: float) -> Float[np.ndarray, "h w"]:
    """Return the image with a share of its light spread widely, as stray light in a lens is.

    `I' = (1 - share) I + share * mean_k(G_k I)` with Gaussians `G_k` whose standard deviations are
    1/64, 1/32 .. 1/2 of the image's width. Each octave of distance has equal energy, so the halo
    falls with the square of the distance. Borders are mirrored, so no light is lost.

    The halo is computed on a small picture. There a cosine transform, which implies mirrored
    borders, turns all Gaussians into one factor per frequency.
    """
    h, w = image.shape
    low_w = min(w, LOW_WIDTH_PX)
    low_h = max(1, round(h * low_w / w))
    low = cv2.resize(image, (low_w, low_h), interpolation=cv2.INTER_AREA)
    halo = fft.idctn(
        fft.dctn(low, norm="ortho") * _halo_spectrum(low_h, low_w, h / w), norm="ortho"
    )
    halo = cv2.resize(halo, (w, h), interpolation=cv2.INTER_LINEAR)
    # Restore the mean, which interpolation between the two pixel grids changes by about 1e-4.
    halo += image.mean() - halo.mean()
    halo -= image
    halo *= np.float32(share)
    halo += image
    return halo


def _halo_spectrum(low_h: int, low_w: int, aspect: float) -> Float[np.ndarray, "low_h low_w"]:
    """Return the factor by which all Gaussians together reduce each cosine of the transform."""
    wy = np.pi * np.arange(low_h) / aspect  # radians per image width
    wx = np.pi * np.arange(low_w)
    frequency2 = wy[:, None] ** 2 + wx[None, :] ** 2
    sigma2 = 4.0 ** -np.arange(1, OCTAVES + 1)
    octaves = np.exp(-0.5 * sigma2[:, None, None] * frequency2)
    return octaves.mean(axis=0).astype(np.float32)
