"""The one colour encoding that pictures on disk have."""

import numpy as np
from jaxtyping import Float, UInt8


def srgb(linear: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """8-bit sRGB of linear values; below 0 and above 1 is clipped. Source: IEC 61966-2-1."""
    x = np.clip(linear, 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(encoded * 255).astype(np.uint8)
