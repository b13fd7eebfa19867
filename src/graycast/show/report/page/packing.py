"""Encode pictures, maps and records as text in a script.

A page that is opened from the disk can run scripts, but it can read neither files by `fetch` nor
the pixels of an image file. Therefore all data are text in scripts: pictures are data URLs, and
maps are bytes in zlib and base64. `web/core.js` decodes them.
"""

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt16
from matplotlib import colormaps

from ....base.frames import inverse
from ....camera.decode import Reason
from ....rig.optics import Optics

_LEVEL = 4  # Level 6 takes twice the time and saves 3 % of the size.
_FAST = 2


def receiving(content: Mapping[str, Any]) -> bytes:
    """Return a script that passes its content to the page."""
    return f"Graycast.receive({_json(content)});\n".encode()


def report_script(content: Mapping[str, Any]) -> bytes:
    """Return the script with the data that all parts of a page share."""
    return f"Graycast.report = {_json(content)};\n".encode()


def reason_records() -> list[dict[str, Any]]:
    """Return the reasons for missing depth for the legends of pages."""
    return [
        {
            "number": int(reason),
            "name": reason.label,
            "color": reason.color,
            "meaning": reason.meaning,
        }
        for reason in Reason
    ]


def view_record(camera: Optics, T_world_cam: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Return a camera and its pose [mm], with the keys of a dataset's `scene_camera.json`."""
    T_cam_world = inverse(T_world_cam)
    return {
        "cam_K": camera.K.ravel().tolist(),
        "distortion": list(camera.distortion),
        "cam_R_w2c": T_cam_world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (1000.0 * T_cam_world[:3, 3]).tolist(),
    }


def plain_text(array: np.ndarray) -> str:
    """Return the uncompressed bytes of an array as base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def pack_bytes(values: UInt8[np.ndarray, "h w"]) -> str:
    """Return the bytes of a map, row by row, compressed."""
    return _text(np.ascontiguousarray(values).tobytes(), strategy=zlib.Z_RLE)


def pack_words(values: UInt16[np.ndarray, "h w"], *, noisy: bool = False) -> str:
    """Return a map of 16-bit numbers, stored as residuals of a prediction from three neighbours.

    The residual is `v[r, c] - v[r-1, c] - v[r, c-1] + v[r-1, c-1]` modulo 2^16, with v = 0 outside;
    low bytes precede high bytes. Small residuals on planes need a third of a PNG's size.

    Args:
        noisy: the map is hard to compress, so little time is spent on it.
    """
    residual = np.diff(np.diff(np.pad(values, ((1, 0), (1, 0))), axis=0), axis=1)
    if noisy:
        return _text(_planes(residual), level=_FAST)
    return _text(_planes(residual), strategy=zlib.Z_RLE)


def pack_difference(values: UInt16[np.ndarray, "h w"], base: UInt16[np.ndarray, "h w"]) -> str:
    """Return a map's difference from a base map modulo 2^16; 0 where the map has no value.

    A signed difference d is first mapped to a small positive number (2 d, or -2 d - 1).
    """
    d = np.where(values > 0, values - base, np.uint16(0)).view(np.int16)
    folded = (d << 1) ^ (d >> 15)  # The second term is -1 for negative numbers, and 0 otherwise.
    return _text(_planes(folded.view(np.uint16)))


def _planes(words: UInt16[np.ndarray, "h w"]) -> bytes:
    """Return the low bytes of all numbers, and then the high bytes."""
    return words.astype(np.uint8).tobytes() + (words >> 8).astype(np.uint8).tobytes()


def jpeg(picture: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"], quality: int) -> bytes:
    """Return an RGB or grey picture as a JPEG."""
    image = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def jpeg_url(picture: UInt8[np.ndarray, "..."], quality: int) -> str:
    """Return a JPEG as a data URL, because scripts can read its pixels, unlike those of a file."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(picture, quality)).decode()


def shrunk(picture: UInt8[np.ndarray, "..."], width_px: int) -> UInt8[np.ndarray, "..."]:
    """Return a picture reduced to at most this width by area averaging."""
    height_px = max(round(picture.shape[0] * width_px / picture.shape[1]), 1)
    if width_px >= picture.shape[1]:
        return picture
    return cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)


def palette_picture(
    index: Int[np.ndarray, "h w"] | UInt8[np.ndarray, "h w"], colors: dict[int, str]
) -> UInt8[np.ndarray, "h w 3"]:
    """Return an image with the colour (`#rrggbb`) of each number; numbers without one are black."""
    table = np.zeros((256, 3), dtype=np.uint8)
    for number, color in colors.items():
        table[number] = list(bytes.fromhex(color[1:]))
    return table[index]


def color_table(name: str) -> str:
    """Return 256 colours of a colour map as hexadecimal digits."""
    return (colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8).tobytes().hex()


def _json(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _text(data: bytes, *, level: int = _LEVEL, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> str:
    """Return compressed bytes as base64.

    On residuals and reasons, `Z_RLE` takes a third of the time, and the result is not larger.
    """
    deflate = zlib.compressobj(level, strategy=strategy)
    return base64.b64encode(deflate.compress(data) + deflate.flush()).decode()
