"""Refuse users' JSON, arrays and pictures that are damaged, too large, rotated or mirrored."""

import re
import struct
import warnings
from codecs import BOM_UTF8
from collections.abc import Mapping
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

MOST_PX = 100_000_000
_HEAD_BYTES = 1 << 16
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_ORIENTATION = 0x0112  # the tag of the orientation in EXIF and TIFF
_TURNS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "upside down and mirrored",
    5: "turned by 90 degrees and mirrored",
    6: "turned by 90 degrees",
    7: "turned by 90 degrees and mirrored",
    8: "turned by 90 degrees",
}
_File = BufferedReader | BytesIO
_DAMAGED = (OSError, SyntaxError, LookupError, ValueError, TypeError, struct.error)
_ANYTHING: TypeAdapter[Any] = TypeAdapter(Any)


def parse_json(content: bytes | str) -> Any:
    """Parse a JSON text; all JSON from files or from outside is read with this function.

    Lists and objects may be nested 200 levels deep, so that code that walks through the result
    does not reach Python's recursion limit.

    Raises:
        ValueError: the text is not JSON, or is nested too deeply.
    """
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    try:
        return _ANYTHING.validate_json(data.removeprefix(BOM_UTF8))
    except ValidationError as error:
        why = error.errors()[0]["ctx"]["error"]
        why = why.replace("recursion limit exceeded", "nested too deeply")
        raise ValueError(why) from error


def refuse_large_size(width_px: int, height_px: int, name: str, error: type[Exception]) -> None:
    """Raise an error of the given class if a picture of this size would take too much memory."""
    if width_px * height_px > MOST_PX:
        raise error(
            f"{name}: has {width_px} x {height_px} pixels, and at most {MOST_PX // 10**6} million "
            "are allowed: give a smaller picture"
        )


def refuse_large_picture(source: Path | bytes, name: str, error: type[Exception]) -> None:
    """Raise an error of the given class if a picture's header states too many pixels.

    Only the header is read. A picture without a known header is accepted, because its decoder
    gives a better error message.

    Args:
        source: path of an existing file, or the content of a file.
        name: the picture's name in the error.
    """
    with open(source, "rb") if isinstance(source, Path) else BytesIO(source) as file:
        try:
            size = _stated_size(file)
        except _DAMAGED:
            return
    refuse_large_size(*size, name, error)


def refuse_turned(source: Path | bytes, name: str, error: type[Exception]) -> None:
    """Raise an error of the given class if a picture's EXIF makes viewers rotate or mirror it.

    Phones, and cameras that are mounted upside down, store the sensor's picture with an EXIF note
    on how to rotate it. Viewers and labelling tools rotate the picture, but our decoders do not, so
    labels, camera matrix and pixels would not fit together.

    Args:
        source: path of an existing file, or the content of a file.
        name: the picture's name in the error.
    """
    content = source.read_bytes() if isinstance(source, Path) else source
    if (orientation := _orientation(content)) in _TURNS:
        raise error(
            f"{name}: is stored {_TURNS[orientation]} (EXIF orientation {orientation}): save it "
            "upright without this note, as ImageOps.exif_transpose of Pillow does, with labels and "
            "a camera matrix of that picture"
        )


def _orientation(content: bytes) -> int:
    """Return the EXIF orientation of a JPEG, PNG or TIFF file; 1 (upright) if it is absent."""
    mark = b"eXIf" if content.startswith(b"\x89PNG") else b"Exif\0\0"
    if content[:4] not in _TIFF and mark not in content:
        return 1
    exif = content if content[:4] in _TIFF else content.partition(mark)[2]
    try:
        return _tiff_tags(BytesIO(exif)).get(_ORIENTATION, 1)
    except _DAMAGED:
        return 1  # The decoder will say what is wrong with the file.


def load_array(path: Path) -> np.ndarray:
    """Read the array of an NPY file; refuse a file that is shorter than its header states.

    Raises:
        ValueError: the file is no NPY file, contains Python objects, or ends early.
        OSError: the file cannot be read.
    """
    mapped = np.load(path, mmap_mode="r")
    if not isinstance(mapped, np.ndarray):
        raise ValueError("it is an archive of several arrays")
    return np.array(mapped)


def check_runs(runs: Any, where: str, error: type[Exception]) -> None:
    """Raise an error of the given class if run lengths do not fill a picture of allowed size.

    pycocotools itself does not check run lengths.
    """
    if not isinstance(runs, dict) or not isinstance(runs.get("counts"), str | list):
        raise error(
            f"{where} is not a run-length encoding (size, counts): give masks as in COCO results"
        )
    size, counts = runs.get("size"), runs["counts"]
    if not (
        isinstance(size, list)
        and len(size) == 2
        and all(type(edge) is int and edge > 0 for edge in size)
    ):
        raise error(f"{where}: size is {size!r}; it must be rows and columns")
    refuse_large_size(size[1], size[0], where, error)
    lengths = _lengths(counts) if isinstance(counts, str) else counts
    if (
        lengths is None
        or not all(type(n) is int and n >= 0 for n in lengths)
        or sum(lengths) != size[0] * size[1]
    ):
        raise error(
            f"{where}: its run lengths do not fill {size[1]} x {size[0]} pixels: the file is "
            "damaged, or size is wrong"
        )


def _lengths(counts: str) -> list[int] | None:
    """Decode COCO's compressed run lengths; return None if they are damaged.

    Each number is stored in characters that start at '0' and hold six bits, low bits first: five
    bits of the number and one bit that is set if more follow. From the third number on, the stored
    value is the difference from the number two positions earlier.
    """
    code = np.frombuffer(counts.encode("utf-8", "replace"), np.uint8).astype(np.int64) - 48
    more = (code & 32) > 0
    if not len(code) or more[-1] or code.min() < 0 or code.max() > 63:
        return None
    start = np.append(0, np.flatnonzero(~more)[:-1] + 1)
    place = np.arange(len(code)) - np.repeat(start, np.diff(np.append(start, len(code))))
    if place.max() > 6:
        return None
    value = np.add.reduceat((code & 31) << (5 * place), start)
    end = np.flatnonzero(~more)
    value -= np.where(code[end] & 16, 1 << (5 * (place[end] + 1)), 0)
    value[1::2] = np.cumsum(value[1::2])
    if len(value) > 2:
        value[2::2] = np.cumsum(value[2::2])
    return value.tolist()


def _stated_size(file: _File) -> tuple[int, int]:
    """Read the numbers of columns and rows from a picture's header; no pixel is decoded."""
    head = file.read(_HEAD_BYTES)
    file.seek(0)
    if head.startswith(b"\x89PNG"):
        return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    if head[:4] in _TIFF:
        tags = _tiff_tags(file)  # Pillow cannot open a TIFF with three floats per pixel.
        return tags[256], tags[257]
    if head.startswith(b"\x76\x2f\x31\x01"):  # OpenEXR states the first and last column and row.
        at = head.index(b"dataWindow\0box2i\0") + 21
        left, top, right, bottom = np.frombuffer(head, "<i4", 4, at).tolist()
        return right - left + 1, bottom - top + 1
    if head.startswith(b"#?"):  # Radiance HDR files state "-Y rows +X columns".
        size = re.search(rb"\n[-+][XY] (\d{1,9}) [-+][XY] (\d{1,9})\n", head)
        if size is None:
            raise ValueError("no size")
        return int(size[2]), int(size[1])
    from PIL import Image  # Pillow is slow to import, and a PNG does not need it.

    Image.init()
    for factory, accepts in Image.OPEN.values():  # `Image.open` would warn about large pictures.
        if accepts is not None and accepts(head[:16]) is True:
            return factory(file, "").size
    raise ValueError("no known format")


def _tiff_tags(file: _File) -> Mapping[int, Any]:
    """Return the tags of a TIFF file's first picture, or of an EXIF block."""
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    head = file.read(16)
    tags = ImageFileDirectory_v2(head if 43 in head[2:4] else head[:8])
    file.seek(tags.next)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Damaged tags would cause warnings.
        tags.load(file)
    return tags
