"""Pictures, maps and records as a script can carry them.

A page opened from the disk may not read files: neither fetch nor the pixels of an image beside it.
It may run scripts, so everything a script needs is text in one: pictures as data URLs, maps of
numbers as base64 of zlib of bytes. `web/packed.js` undoes what is done here.
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

_LEVEL = 6
_WHOLE = 65536


def receiving(content: Mapping[str, Any]) -> bytes:
    """A script that hands its content to the page."""
    return f"Graycast.receive({_json(content)});\n".encode()


def report_script(content: Mapping[str, Any]) -> bytes:
    """The script of what all of a page shares."""
    return f"Graycast.report = {_json(content)};\n".encode()


def reason_records() -> list[dict[str, Any]]:
    """The reasons of missing depth, as the legends of pages have them."""
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
    """A camera and its place [mm], with the keys of a dataset's `scene_camera.json`."""
    T_cam_world = inverse(T_world_cam)
    return {
        "cam_K": camera.K.ravel().tolist(),
        "distortion": list(camera.distortion),
        "cam_R_w2c": T_cam_world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (1000.0 * T_cam_world[:3, 3]).tolist(),
    }


def plain_text(array: np.ndarray) -> str:
    """The bytes of an array as base64, not compressed."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def pack_bytes(values: UInt8[np.ndarray, "h w"]) -> str:
    """A map of bytes, row by row."""
    return _text(np.ascontiguousarray(values).tobytes())


def pack_words(values: UInt16[np.ndarray, "h w"], *, level: int = _LEVEL) -> str:
    """A map of 16-bit numbers as what a plane through three neighbours leaves over.

    `d[r, c] = v[r, c] - v[r-1, c] - v[r, c-1] + v[r-1, c-1]` modulo 2^16, beyond the border 0; low
    bytes first, then high bytes. On flat surfaces that is a step or two: a third of a PNG's size.
    """
    wide = np.pad(values.astype(np.int32), ((1, 0), (1, 0)))
    left_over = wide[1:, 1:] - wide[:-1, 1:] - wide[1:, :-1] + wide[:-1, :-1]
    words = (left_over % _WHOLE).astype(np.uint16)
    planes = np.stack([words & 255, words >> 8]).astype(np.uint8)
    return _text(planes.tobytes(), level)


def pack_difference(values: UInt16[np.ndarray, "h w"], base: UInt16[np.ndarray, "h w"]) -> str:
    """A map as its difference to another modulo 2^16; 0 where it has no value.

    Small differences of either sign are folded to small numbers (2 d, or -2 d - 1) first.
    """
    d = values.astype(np.int32) - base
    d = np.where(values > 0, (d + _WHOLE // 2) % _WHOLE - _WHOLE // 2, 0)
    folded = np.where(d >= 0, 2 * d, -2 * d - 1).astype(np.uint16)
    planes = np.stack([folded & 255, folded >> 8]).astype(np.uint8)
    return _text(planes.tobytes())


def jpeg(picture: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"], quality: int) -> bytes:
    """A JPEG of an RGB or grey picture."""
    image = picture if picture.ndim == 2 else picture[..., ::-1]
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return cv2.imencode(".jpg", np.ascontiguousarray(image), options)[1].tobytes()


def jpeg_url(picture: UInt8[np.ndarray, "..."], quality: int) -> str:
    """The same as a data URL: its pixels are open to scripts, those of a file are not."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg(picture, quality)).decode()


def shrunk(picture: UInt8[np.ndarray, "..."], width_px: int) -> UInt8[np.ndarray, "..."]:
    """A picture of at most that width, averaged over what falls together."""
    height_px = max(round(picture.shape[0] * width_px / picture.shape[1]), 1)
    if width_px >= picture.shape[1]:
        return picture
    return cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)


def palette_picture(
    index: Int[np.ndarray, "h w"] | UInt8[np.ndarray, "h w"], colors: dict[int, str]
) -> UInt8[np.ndarray, "h w 3"]:
    """Numbers in their colours (`#rrggbb`); black where a number has none."""
    table = np.zeros((256, 3), dtype=np.uint8)
    for number, color in colors.items():
        table[number] = list(bytes.fromhex(color[1:]))
    return table[index]


def color_table(name: str) -> str:
    """256 colours of a colour map as hexadecimal digits."""
    return (colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8).tobytes().hex()


def _json(content: Mapping[str, Any]) -> str:
    return json.dumps(content, allow_nan=False, separators=(",", ":"))


def _text(data: bytes, level: int = _LEVEL) -> str:
    return base64.b64encode(zlib.compress(data, level)).decode()
