"""The pictures of a dataset: the colour picture, and the grey picture of the measuring camera."""

import numpy as np
from jaxtyping import Float, UInt8

from ..base.color import srgb
from ..rendering import Denoiser, Rendering
from ..rendering.denoise import denoise
from ..rig.pair import Rig
from .scanner import Scanner
from .sensor import Capture, SensorSpec, auto_exposure_s, expose

PERCENTILE, TARGET = 98.0, 0.85  # The exposure puts this percentile at this share of the range.


def color_picture(
    scanner: Scanner, rendering: Rendering, *, denoiser: Denoiser | None, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture lit by lamps, environment and the idle projector, in 8-bit sRGB.

    The measuring sensor takes the three bands one after the other.

    Args:
        denoiser: denoiser that removes the sampling noise of the rendered light; None keeps it.
        seed: seed of the sensor's noise, which differs between the bands.

    Raises:
        ValueError: there is no light in the picture.
    """
    return developed(color_light(scanner.rig, rendering, denoiser=denoiser), scanner, seed=seed)


def color_light(
    rig: Rig, rendering: Rendering, *, denoiser: Denoiser | None
) -> Float[np.ndarray, "h w 3"]:
    """Return the light of the colour picture, before the sensor; see `color_picture`."""
    radiance = rendering.radiance
    linear = radiance.ambient_rgb + np.float32(idle_share(rig)) * radiance.white_rgb
    if denoiser is None:
        return linear
    return denoise(linear, radiance.albedo, rendering.truth.normal, denoiser)


def developed(
    linear: Float[np.ndarray, "h w 3"], scanner: Scanner, *, seed: int
) -> UInt8[np.ndarray, "h w 3"]:
    """Return the colour picture that the scanner's sensor takes of a light; see `color_picture`."""
    sensor = scanner.sensor
    if not linear.max() > 0:
        raise ValueError(
            "the colour picture is black: give light.environment or light.lamps some radiance, "
            "or the rig a picture_level"
        )
    bands = np.ascontiguousarray(np.moveaxis(np.maximum(linear, 0), -1, 0), dtype=np.float32)
    exposure_s = auto_exposure_s(bands, sensor, percentile=PERCENTILE, target=TARGET)
    capture = expose(bands, None, sensor, exposure_s=exposure_s, seed=seed)
    return srgb(np.moveaxis(_share(capture.frames, sensor), 0, -1))


def idle_share(rig: Rig) -> float:
    """Return the projector's light during the colour picture, relative to its white."""
    black = 1 / rig.contrast_ratio
    return (1 - black) * rig.picture_level + black


def gray_picture(capture: Capture) -> UInt8[np.ndarray, "h w"]:
    """Return `relative_light` of the first frame, which is white, in 8 bits, clipped to 255."""
    return np.round(np.minimum(relative_light(capture, 0), 1) * 255).astype(np.uint8)


def relative_light(capture: Capture, index: int) -> Float[np.ndarray, "h w"]:
    """Return the light of a frame; 1 saturates the sensor in the reference exposure.

    A pixel with another exposure is scaled by the ratio of the times, so that equal light has equal
    values in all exposures; values can be greater than 1.
    """
    share = _share(capture.frames[index], capture.sensor)
    return share * np.float32(capture.reference_s / capture.exposure_s)


def srgb_frame(capture: Capture, index: int) -> UInt8[np.ndarray, "h w"]:
    """Return a frame for display: its `relative_light` in 8-bit sRGB."""
    share = np.minimum(relative_light(capture, index), 1)
    return _SRGB[np.round(share * (len(_SRGB) - 1)).astype(np.uint16)]


_SRGB = srgb(np.linspace(0, 1, 2**16))  # A table is faster than computing a power per pixel.


def _share(dn: np.ndarray, sensor: SensorSpec) -> Float[np.ndarray, "*n"]:
    """Return digital numbers as a share of the sensor's range, from 0 to 1."""
    offset_dn = np.float32(sensor.offset_dn)
    return np.clip((dn - offset_dn) / np.float32(sensor.saturation_dn - sensor.offset_dn), 0, 1)
