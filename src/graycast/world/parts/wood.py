"""A computed wood texture for bins: growth rings cut lengthwise, with fine grain."""

from functools import cache

import numpy as np
from jaxtyping import UInt8
from scipy.ndimage import fourier_gaussian

SIZE_PX = 1024
_LIGHT_SRGB = np.array([214.0, 174.0, 122.0])
_DARK_SRGB = np.array([158.0, 112.0, 66.0])
_SEED = 7


@cache
def wood_texture() -> UInt8[np.ndarray, "h w 3"]:
    """Return an sRGB picture with the grain along its rows; it repeats without a seam."""
    rng = np.random.default_rng(_SEED)

    def noise(along_px: float, across_px: float) -> np.ndarray:
        spectrum = np.fft.fft2(rng.standard_normal((SIZE_PX, SIZE_PX)))
        field = np.fft.ifft2(fourier_gaussian(spectrum, (across_px, along_px))).real
        return field / field.std()

    y = np.arange(SIZE_PX)[:, None] / SIZE_PX
    # A whole number of rings makes opposite edges match, and the noise makes the rings wavy.
    ring = 14 * y + 0.9 * noise(260.0, 60.0) + 0.12 * noise(120.0, 12.0)
    late = np.abs((ring % 1.0) - 0.5) * 2
    dark = 0.75 * late**3 + 0.10 * noise(60.0, 1.2) + 0.05 * noise(25.0, 0.7)
    # Dark pores are short strokes along the grain.
    pores = noise(14.0, 0.8) > 2.6
    share = np.clip(dark + 0.35 * pores, 0, 1)[..., None]
    picture = np.round(_LIGHT_SRGB + share * (_DARK_SRGB - _LIGHT_SRGB)).astype(np.uint8)
    picture.flags.writeable = False  # All callers share this array.
    return picture
