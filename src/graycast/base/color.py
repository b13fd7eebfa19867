"""The colour encoding of all pictures on disk."""

import numpy as np
from jaxtyping import Float, UInt8


def srgb(linear: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """8-bit sRGB of linear values, clipped to 0 to 1. Source: IEC 61966-2-1."""
    x = np.clip(linear, 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(encoded * 255).astype(np.uint8)


def srgb_of_bytes(linear: UInt8[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """8-bit sRGB of 8-bit linear values: how a white frame is shown to people."""
    return srgb(np.arange(256) / 255)[linear]


def linear(encoded: UInt8[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Linear values, 0 to 1, of 8-bit sRGB: the inverse of `srgb` up to its rounding."""
    return linear_share(encoded / 255.0)


def linear_share(encoded: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Linear values, 0 to 1, of unrounded sRGB values from 0 to 1."""
    low = encoded <= 0.04045
    return np.where(low, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
