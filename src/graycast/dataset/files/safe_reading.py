"""Read files of a dataset and check their form, since they may be damaged."""

import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import GenericAlias
from typing import Any, TypeVar

import cv2
import numpy as np
from pydantic import TypeAdapter, ValidationError

from ...base.file_limits import refuse_large_picture, refuse_turned

R = TypeVar("R")
Form = type[R] | GenericAlias  # At run time, `list[Pose]` is a GenericAlias.
_checker: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
_PNG = b"\x89PNG\r\n\x1a\n"


class Unreadable(Exception):
    """A file is missing, damaged or not of the required form."""


def read_json(path: Path, form: Form[R]) -> R:
    """Read a JSON file as a record of the given form.

    Raises:
        Unreadable: the file is missing, not JSON or not of this form.
    """
    try:
        return _checker(form).validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise Unreadable(f"{path.name} is missing") from error
    except OSError as error:
        raise Unreadable(f"{path.name} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise Unreadable(_first_mistake(path.name, error)) from error


def record_as(content: Any, form: Form[R], where: str) -> R:
    """Convert the content of a file, or of a part of it, to a record of the given form.

    Raises:
        Unreadable: the content is not of this form.
    """
    try:
        return _checker(form).validate_python(content)
    except ValidationError as error:
        raise Unreadable(_first_mistake(where, error)) from error


def _first_mistake(where: str, error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(key) for key in first["loc"])
    return ": ".join(filter(None, (where, key, first["msg"].removeprefix("Value error, "))))


def read_mask(path: Path) -> np.ndarray:
    """Read a mask (h, w) of BOP: one channel of 8 bits, 255 inside and 0 outside.

    Raises:
        Unreadable: the file is missing, damaged or not a mask.
    """
    return mask_pixels(*content_of(path))


def mask_pixels(data: bytes, name: str) -> np.ndarray:
    """Return the mask of a PNG in memory, checked as in `read_mask`.

    Raises:
        Unreadable: the data are damaged or not a mask.
    """
    kinds = _intact_chunks(data, name)
    refuse_large_picture(data, name, Unreadable)
    image = _plain_rows(data)
    if image is None:
        image = _decoded(data, name, turnable=b"eXIf" in kinds)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise Unreadable(f"{name} is {image.shape} {image.dtype}, it must be one channel of uint8")
    mask = image == 255
    if np.count_nonzero(image) != np.count_nonzero(mask):
        raise Unreadable(f"{name} has values other than 0 and 255")
    return mask


def read_png(path: Path) -> np.ndarray:
    """Return a PNG's pixels; all checksums are verified, because decoders accept truncated files.

    Raises:
        Unreadable: the file is missing or damaged.
    """
    return png_pixels(*content_of(path))


def read_picture(path: Path) -> np.ndarray:
    """Return the pixels of a picture of any format; a PNG is checked as in `read_png`.

    Raises:
        Unreadable: the file is missing or damaged.
    """
    return pixels(*content_of(path))


def content_of(path: Path) -> tuple[bytes, str]:
    """Return a file's content, and its name with its folder for error messages.

    Raises:
        Unreadable: the file is missing.
    """
    name = f"{path.parent.name}/{path.name}"
    try:
        return path.read_bytes(), name
    except OSError as error:
        raise Unreadable(f"{name} is missing") from error


def png_kind(path: Path) -> str:
    """Return the colour type of an intact PNG, which decoders do not preserve."""
    with open(path, "rb") as file:
        kind = file.read(26)[25]
    return {0: "grey", 2: "colour", 3: "palette"}.get(kind, "with opacity")


def png_pixels(data: bytes, name: str) -> np.ndarray:
    """Return the pixels of a PNG in memory, checked as in `read_png`.

    Raises:
        Unreadable: the data are damaged.
    """
    return _decoded(data, name, turnable=b"eXIf" in _intact_chunks(data, name))


def _plain_rows(data: bytes) -> np.ndarray | None:
    """Return the pixels of an 8-bit grey PNG whose rows have no filter, as Graycast stores masks.

    This takes half the time of a decoder. The result is None for any other PNG.
    """
    length = int.from_bytes(data[33:37], "big")
    if data[24:29] != b"\x08\0\0\0\0" or data[37:41] != b"IDAT" or len(data) != 57 + length:
        return None
    width_px, height_px = struct.unpack(">II", data[16:24])
    size, inflate = height_px * (1 + width_px), zlib.decompressobj()
    try:
        content = inflate.decompress(data[41 : 41 + length], size + 1)
    except zlib.error:
        return None  # The decoder will say what is wrong with the file.
    if len(content) != size or not inflate.eof:
        return None
    rows = np.frombuffer(content, dtype=np.uint8).reshape(height_px, 1 + width_px)
    return None if rows[:, 0].any() else rows[:, 1:]


def is_intact_png(path: Path, shape: tuple[int, ...], dtype: type) -> bool:
    """Return whether a PNG has this form and all its checksums, without decoding its pixels.

    False does not mean that the file is damaged: `read_png` reads rarer kinds of PNG, too.
    """
    try:
        data = path.read_bytes()
    except OSError:
        return False
    bits, colors = 8 * np.dtype(dtype).itemsize, 2 if len(shape) == 3 else 0
    must = struct.pack(">IIBB", shape[1], shape[0], bits, colors)
    plain = {b"IHDR", b"IDAT", b"IEND"}  # Other chunks may change the decoded picture.
    return data[16:26] == must and _png_chunks(data) == plain


def _intact_chunks(data: bytes, name: str) -> set[bytes]:
    if (kinds := _png_chunks(data)) is None:
        raise Unreadable(f"{name} is cut off or damaged")
    return kinds


def _png_chunks(data: bytes) -> set[bytes] | None:
    """Return the kinds of a PNG's chunks; None if a checksum is wrong or the file is cut off."""
    at, kinds, kind = 8, set(), b""
    while data[:8] == _PNG and kind != b"IEND" and at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        kind = data[at + 4 : at + 8]
        kinds.add(kind)
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return None
        at = end + 4
    return kinds if kind == b"IEND" and at == len(data) else None


def pixels(data: bytes, name: str) -> np.ndarray:
    """Return the pixels of a picture in memory, of any format; a PNG is checked as in `read_png`.

    Raises:
        Unreadable: the data are damaged.
    """
    return png_pixels(data, name) if data.startswith(_PNG) else _decoded(data, name)


def _decoded(data: bytes, name: str, *, turnable: bool = True) -> np.ndarray:
    refuse_large_picture(data, name, Unreadable)
    if turnable:
        refuse_turned(data, name, Unreadable)
    encoded = np.frombuffer(data, dtype=np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise Unreadable(f"{name} is not an image, or is damaged")
    return image
