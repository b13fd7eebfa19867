"""From the renderer's light to the light on the measuring camera's sensor: black level and veil."""

import cv2
import numpy as np
from jaxtyping import Float
from scipy import fft

from ..rendering.radiance import Radiance
from ..rig.pair import Rig

OCTAVES = 6  # The veil has sigmas of 1/64, 1/32 .. 1/2 of the image's width.
LOW_WIDTH_PX = 128  # The veil is computed on a picture this wide: the finest octave spans 2 pixels.


def camera_light(
    radiance: Radiance, rig: Rig
) -> tuple[Float[np.ndarray, "n h w"], Float[np.ndarray, "h w"]]:
    """The light of each frame's projector on the sensor, and all other light (float32, radiance).

    The projector leaks `b = 1 / contrast_ratio` of its white through every picture, so pattern k
    becomes `(1 - b) pattern_k + b white`; then the camera's lens spreads `rig.veil` of all light
    far over the image (see `veiled`). Where neither happens the renderer's own array comes back.

    Leaves out: what the veil takes from outside the image; ghosts of single lights.
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
    """An image of which a share of the light is spread far and wide, as stray light in a lens is.

    `I' = (1 - share) I + share * mean_k(G_k I)` with Gaussians `G_k` whose standard deviations are
    1/64, 1/32 .. 1/2 of the image's width: equal energy in each octave of distance is a halo that
    falls with its square. Borders mirror, so no light is lost.

    The halo is computed on a small picture, where a cosine transform (whose pictures are mirrored
    at their borders) turns all Gaussians into one factor per frequency.
    """
    h, w = image.shape
    low_w = min(w, LOW_WIDTH_PX)
    low_h = max(1, round(h * low_w / w))
    low = cv2.resize(image, (low_w, low_h), interpolation=cv2.INTER_AREA)
    halo = fft.idctn(
        fft.dctn(low, norm="ortho") * _halo_spectrum(low_h, low_w, h / w), norm="ortho"
    )
    halo = cv2.resize(halo, (w, h), interpolation=cv2.INTER_LINEAR)
    # Interpolation between pixel grids that do not match moves the mean by about 1e-4.
    halo += image.mean() - halo.mean()
    halo -= image
    halo *= np.float32(share)
    halo += image
    return halo


def _halo_spectrum(low_h: int, low_w: int, aspect: float) -> Float[np.ndarray, "low_h low_w"]:
    """What all octaves together leave of each cosine over the image; wavelengths in its widths."""
    wy = np.pi * np.arange(low_h) / aspect  # radians per image width
    wx = np.pi * np.arange(low_w)
    frequency2 = wy[:, None] ** 2 + wx[None, :] ** 2
    sigma2 = 4.0 ** -np.arange(1, OCTAVES + 1)
    octaves = np.exp(-0.5 * sigma2[:, None, None] * frequency2)
    return octaves.mean(axis=0).astype(np.float32)
