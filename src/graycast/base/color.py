"""The colour encoding of all pictures on disk."""

import numpy as np
from jaxtyping import Float, UInt8


def srgb(linear: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """Encode linear values, clipped to 0 to 1, as 8-bit sRGB. Source: IEC 61966-2-1."""
    x = np.clip(linear, 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(encoded * 255).astype(np.uint8)


def srgb_of_bytes(linear: UInt8[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """Encode 8-bit linear values, such as a white frame, as 8-bit sRGB for display."""
    return srgb(np.arange(256) / 255).take(linear)


def linear(encoded: UInt8[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Decode 8-bit sRGB to linear values from 0 to 1; inverts `srgb` up to its rounding."""
    return linear_share(encoded / 255.0)


def linear_share(encoded: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Decode unrounded sRGB values from 0 to 1 to linear values from 0 to 1."""
    low = encoded <= 0.04045
    return np.where(low, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
