"""Files of a dataset, read without trust in them."""

import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import GenericAlias
from typing import Any, TypeVar

import cv2
import numpy as np
from pydantic import TypeAdapter, ValidationError

from ..base.file_limits import refuse_large_picture, refuse_turned

R = TypeVar("R")
Form = type[R] | GenericAlias  # GenericAlias is what `list[Pose]` is when the program runs.
_checker: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
_PNG = b"\x89PNG\r\n\x1a\n"


class Unreadable(Exception):
    """A file that is missing, damaged or of another form than it must have."""


def read_json(path: Path, form: Form[R]) -> R:
    """A JSON file as the record it must be.

    Raises:
        Unreadable: it is not there, not JSON or of another form.
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
    """What a file or a part of it holds as the record it must be.

    Raises:
        Unreadable: it is of another form.
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
    """A mask (h, w) of bool as BOP stores it: one channel of 8 bits, 255 inside and 0 outside.

    Raises:
        Unreadable: it is not there, damaged or of another form.
    """
    image = read_png(path)
    name = f"{path.parent.name}/{path.name}"
    if image.ndim != 2 or image.dtype != np.uint8:
        raise Unreadable(f"{name} is {image.shape} {image.dtype}, it must be one channel of uint8")
    mask = image == 255
    if (image[~mask] != 0).any():
        raise Unreadable(f"{name} has values other than 0 and 255")
    return mask


def read_png(path: Path) -> np.ndarray:
    """A PNG's pixels, every chunk's checksum verified: decoders forgive a file that ends early.

    Raises:
        Unreadable: it is not there or damaged.
    """
    return png_pixels(*_named(path))


def read_picture(path: Path) -> np.ndarray:
    """The pixels of a picture of any format; a PNG is checked as `read_png` checks.

    Raises:
        Unreadable: it is not there or damaged.
    """
    return pixels(*_named(path))


def _named(path: Path) -> tuple[bytes, str]:
    """What a file holds, and its name as a scene's reader knows it."""
    name = f"{path.parent.name}/{path.name}"
    try:
        return path.read_bytes(), name
    except OSError as error:
        raise Unreadable(f"{name} is missing") from error


def png_kind(path: Path) -> str:
    """How a PNG that is whole holds its pixels: decoders turn all kinds into arrays alike."""
    with open(path, "rb") as file:
        kind = file.read(26)[25]
    return {0: "grey", 2: "colour", 3: "palette"}.get(kind, "with opacity")


def png_pixels(data: bytes, name: str) -> np.ndarray:
    """The pixels of a PNG that is in memory, checked as `read_png` checks.

    Raises:
        Unreadable: it is damaged.
    """
    at, kind = 8, b""
    while data[:8] == _PNG and kind != b"IEND" and at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        kind = data[at + 4 : at + 8]
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            break
        at = end + 4
    if kind != b"IEND" or at != len(data):
        raise Unreadable(f"{name} is cut off or damaged")
    return _decoded(data, name)


def pixels(data: bytes, name: str) -> np.ndarray:
    """The pixels of a picture in memory, of any format; a PNG is checked as `read_png` checks.

    Raises:
        Unreadable: it is damaged.
    """
    return png_pixels(data, name) if data.startswith(_PNG) else _decoded(data, name)


def _decoded(data: bytes, name: str) -> np.ndarray:
    refuse_large_picture(data, name, Unreadable)
    refuse_turned(data, name, Unreadable)
    encoded = np.frombuffer(data, dtype=np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise Unreadable(f"{name} is not an image, or is damaged")
    return image
