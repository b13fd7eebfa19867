"""What a dataset keeps beside depth, for the page: captured frames, decoded projector positions.

Each is a separate script that is loaded when it is shown.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32

from ....base.errors import DatasetError
from ....camera.picture import srgb_frame
from ....dataset.raw import read_capture, read_code_maps
from ....dataset.safe_reading import Unreadable
from ....dataset.sample import Raw
from ....dataset.stored import StoredScene
from .packing import jpeg_url, pack_words, shrunk

_QUALITY = 85
_FAST = 2  # This is a fast level of zlib, as code maps are noisy.
_STEPS = 65534  # Of the values of 16 bits, 0 is no value, and the first step is 1.


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """As `read_capture` and `read_code_maps` give them."""

    raw: Raw | None
    code_maps: Mapping[str, Float32[np.ndarray, "h w"]]

    @property
    def frame_names(self) -> list[str]:
        return [] if self.raw is None else [f.name for f in self.raw.scanner.light_code().frames]


def read_kept(scene: StoredScene) -> Kept:
    """What a scene's folder keeps of a picture.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    try:
        return Kept(
            raw=read_capture(scene.folder, sensor=scene.sensor, number=scene.image),
            code_maps=read_code_maps(scene.folder, sensor=scene.sensor, number=scene.image),
        )
    except Unreadable as error:
        raise DatasetError(f"{scene.folder}: {error}: run graycast validate") from error


def frames_script(name: str, raw: Raw, stride: int) -> dict[str, Any]:
    """Every captured picture as `srgb_frame`: 0 at the sensor's offset, 255 where it saturates."""
    sensor, capture = raw.scanner.sensor, raw.capture
    if capture is None:
        raise ValueError("no picture was captured")
    width_px = -(-capture.frames.shape[2] // stride)
    pictures = [
        jpeg_url(shrunk(srgb_frame(capture, k), width_px), _QUALITY)
        for k in range(len(capture.frames))
    ]
    return {
        "key": name,
        "pictures": pictures,
        "bits": sensor.bit_depth,
        "low_dn": float(sensor.offset_dn),
        "high_dn": float(sensor.saturation_dn),
        "merged": isinstance(capture.exposure_s, np.ndarray),
    }


def columns_script(
    name: str, code_maps: Mapping[str, Float32[np.ndarray, "h w"]], stride: int
) -> dict[str, Any]:
    """Positions and standard deviations in steps of a power of two [px], 0 for none."""
    return {
        "key": name,
        "maps": {axis: _packed(image[::stride, ::stride]) for axis, image in code_maps.items()},
    }


def _packed(image: Float32[np.ndarray, "h w"]) -> dict[str, Any]:
    known = np.isfinite(image)
    low = float(np.floor(image[known].min(initial=0.0)))
    span = float(image[known].max(initial=0.0)) - low
    step = 2.0 ** math.ceil(math.log2(max(span, 2.0**-8) / (_STEPS - 1)))
    steps = np.rint((np.where(known, image, low).astype(np.float64) - low) / step) + 1
    return {
        "words": pack_words(np.where(known, steps, 0).astype(np.uint16), level=_FAST),
        "low": low,
        "step": step,
    }
