"""Convert a dataset's pictures to bytes: depth and modulation in 16-bit steps, masks, and PNGs."""

import math
import struct
import zlib

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from ...base.errors import DatasetError
from ...rendering.radiance import Silhouette
from ..files.records import MM_PER_M
from ..read.example import LEAST_LOG_P, P_STEPS

_PNG_LEVEL = 2  # Higher levels take twice the time and save a hundredth of the size.
_STEP_MAX = 65535
DEPTH_MAX = _STEP_MAX - 1  # Cameras write 65535 for missing depth, so readers treat it as missing.
_SCALES_MM = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def depth_scale_mm(reach_m: float) -> float:
    """Return the depth step [mm] with which 16 bits can store depths up to `reach_m`.

    It is the finest of 0.001, 0.002, 0.005, 0.01, ... 1 mm whose 65534 steps reach `reach_m`:
    0.02 mm up to 1.31 m. A step is thus 1/65534 to 1/26213 of `reach_m`, well under a scanner's
    noise, and its multiples have few decimals. A dataset has a single scale.

    Raises:
        ValueError: `reach_m` is not positive, or beyond 65 m.
    """
    if not reach_m > 0:
        raise ValueError(f"reach_m is {reach_m}; a depth in metres above 0")
    for scale_mm in _SCALES_MM:
        if reach_m * MM_PER_M <= scale_mm * DEPTH_MAX:
            return scale_mm
    raise ValueError(f"reach_m is {reach_m}; 16-bit depth in millimetres ends at 65.534 m")


def depth_steps(
    depth_m: Float[np.ndarray, "h w"], scale_mm: float, *, needed: Bool[np.ndarray, "h w"]
) -> UInt16[np.ndarray, "h w"]:
    """Return depth in steps of the scale; 0 if unknown, or too deep for 16 bits and not `needed`.

    The table has infinite depths, so only pixels of parts and of measurements must fit.
    """
    steps = np.rint(depth_m.astype(np.float64) * (MM_PER_M / scale_mm))
    fits = (steps >= 1) & (steps <= DEPTH_MAX)  # False for NaN
    if (needed & ~fits).any():
        worst_m = depth_m[needed & ~fits][0]
        coarser = (mm for mm in _SCALES_MM if worst_m * MM_PER_M <= mm * DEPTH_MAX)
        raise DatasetError(
            f"a depth of {worst_m:.6g} m does not fit 16 bits in steps of {scale_mm} mm "
            f"(up to {scale_mm * DEPTH_MAX / MM_PER_M:.3f} m): give a coarser step, such as "
            f"store: {{depth_step_mm: {next(coarser, _SCALES_MM[-1])}}}"
        )
    return np.where(fits, steps, 0).astype(np.uint16)


def modulation_steps(
    modulation: Float[np.ndarray, "h w"],
) -> tuple[UInt16[np.ndarray, "h w"], float]:
    """Return 16-bit steps and the power of two that turns a step back into modulation.

    NaN and numbers that noise made negative are stored as 0: no modulation.
    """
    value = np.nan_to_num(modulation.astype(np.float64), nan=0.0).clip(min=0.0)
    scale = 2.0 ** math.ceil(math.log2(max(value.max(initial=0.0), 2.0**-16) / _STEP_MAX))
    return np.rint(value / scale).astype(np.uint16), scale


def probability_steps(p_wrong: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Return 8-bit steps of the logarithm of a probability; 0 if it is unknown.

    Step 255 is 1, and each step less is a factor of 10^(4/254), down to 1e-4 or less at step 1.
    """
    known = np.isfinite(p_wrong)
    exponent = np.log10(np.where(known, p_wrong, 1).clip(10**LEAST_LOG_P, 1))
    steps = 255 - np.rint(P_STEPS * exponent / LEAST_LOG_P)
    return np.where(known, steps, 0).astype(np.uint8)


def png(image: UInt8[np.ndarray, "..."] | UInt16[np.ndarray, "..."]) -> bytes:
    """Return a PNG of a picture in OpenCV's channel order."""
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])[1].tobytes()


def mask_png(crop: Silhouette, height_px: int, width_px: int) -> bytes:
    """Return an 8-bit grey PNG, 255 inside the mask.

    OpenCV is not used because it tries filters on every row, which is eight times slower; the
    scene of a full bin has 500 masks.
    """
    rows = np.zeros((height_px, 1 + width_px), dtype=np.uint8)  # a row starts with its filter, 0
    bh, bw = crop.mask.shape
    rows[crop.top_px : crop.top_px + bh, 1 + crop.left_px : 1 + crop.left_px + bw] = (
        crop.mask.astype(np.uint8) * 255
    )
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 0, 0, 0, 0)
    deflate = zlib.compressobj(1, strategy=zlib.Z_RLE)
    pixels = deflate.compress(rows.tobytes()) + deflate.flush()
    chunks = [(b"IHDR", header), (b"IDAT", pixels), (b"IEND", b"")]
    body = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)
