"""Read a stack's pictures as they were stored, and refuse pictures that do not fit together."""

import hashlib
import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16
from PIL import Image, UnidentifiedImageError

from ...base.errors import DecodeError
from ...base.file_limits import refuse_large_picture

Picture = UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]
THREADS = 4  # Decoding of JPEG and PNG releases Python's lock, so threads run in parallel.


@dataclass(frozen=True, slots=True, kw_only=True)
class StackPictures:
    """The pictures of a stack in memory."""

    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"]
    files: tuple[Path, ...]
    digests: tuple[str, ...]  # Hashes of the files
    lossy: bool  # Whether a file is a JPEG
    converted: bool  # Whether a file is a colour picture

    def __post_init__(self) -> None:
        self.frames.flags.writeable = False


def read_pictures(files: Sequence[Path]) -> StackPictures:
    """Read grey values as stored; a rotation in EXIF is ignored.

    Colour becomes luma, 0.299 R + 0.587 G + 0.114 B of the stored values (Rec. 601, as in JPEG). If
    the camera applied a gamma, luma increases with light, but is not linear in it.

    Raises:
        DecodeError: a file is missing, damaged, no picture, or of another size or bit depth.
    """
    first = _read(files[0])
    frames = np.empty((len(files), *first.grey.shape), dtype=first.grey.dtype)
    frames[0] = first.grey

    def read(k: int) -> _Read:
        """Read a picture directly into the stack, so that few other pictures are in memory."""
        picture = _read(files[k])
        _check_alike(frames[0], files[0], picture.grey, files[k])
        frames[k] = picture.grey
        return picture._replace(grey=frames[k])

    with ThreadPoolExecutor(THREADS) as pool:
        waiting = [pool.submit(read, k) for k in range(1, len(files))]
        try:
            pictures = [first, *(job.result() for job in waiting)]
        except DecodeError:  # This is the first error in the order of the files.
            pool.shutdown(cancel_futures=True)
            raise
    return StackPictures(
        frames=frames,
        files=tuple(files),
        digests=tuple(picture.digest for picture in pictures),
        lossy=any(picture.jpeg for picture in pictures),
        converted=any(picture.color for picture in pictures),
    )


def read_color(file: Path) -> UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]:
    """Read a picture in colour, as stored; grey becomes three equal channels."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    picture = cv2.imdecode(np.fromfile(file, dtype=np.uint8), flags)
    if picture is None:
        raise DecodeError(f"{file}: OpenCV cannot read it in colour: save it as PNG")
    return np.ascontiguousarray(picture[..., ::-1])


def _check_alike(first: np.ndarray, first_file: Path, other: np.ndarray, file: Path) -> None:
    if other.shape != first.shape:
        sizes = [f"{p.shape[1]} x {p.shape[0]} px" for p in (other, first)]
        raise DecodeError(
            f"{file} is {sizes[0]}, {first_file.name} is {sizes[1]}: all pictures of a stack must "
            "have one size; one may have been rotated, cropped or scaled"
        )
    if other.dtype != first.dtype:
        bits = [8 * p.dtype.itemsize for p in (other, first)]
        raise DecodeError(
            f"{file} has {bits[0]} bits a pixel, {first_file.name} has {bits[1]}: save all "
            "frames alike, from one camera setting"
        )


class _Read(NamedTuple):
    grey: Picture
    digest: str
    jpeg: bool
    color: bool


def _read(file: Path) -> _Read:
    try:
        content = file.read_bytes()
    except FileNotFoundError as error:
        raise DecodeError(f"{file}: no such file: paths are relative to the stack file") from error
    except OSError as error:
        raise DecodeError(f"{file}: cannot be read ({error.strerror}): give a picture") from error
    if not content:
        raise DecodeError(f"{file}: is empty: take or copy the picture again")
    refuse_large_picture(content, str(file), DecodeError)
    try:
        with Image.open(io.BytesIO(content)) as picture:
            is_jpeg = picture.format == "JPEG"
            is_color = picture.mode not in ("L", "I;16", "I;16B", "1", "I")
            if is_jpeg:
                picture.draft("L", picture.size)  # Use the luma of the file; do not decode chroma.
            picture.load()
            grey = _grey(picture, content, file)
    except UnidentifiedImageError as error:
        raise DecodeError(f"{file}: is not a picture: give PNG, TIFF or JPEG") from error
    except (OSError, SyntaxError, ValueError) as error:  # Pillow's errors for damaged files
        raise DecodeError(
            f"{file}: is damaged or cut short ({error}): copy or take it again"
        ) from error
    digest = hashlib.blake2b(content, digest_size=16).hexdigest()
    return _Read(grey=grey, digest=digest, jpeg=is_jpeg, color=is_color)


def _grey(picture: Image.Image, content: bytes, file: Path) -> Picture:
    match picture.mode:
        case "L":
            return np.asarray(picture)
        case "1":
            return np.asarray(picture.convert("L"))
        case "I;16" | "I;16B":
            return np.asarray(picture).astype(np.uint16)
        case "I":
            return _from_int32(np.asarray(picture), file)
        case "F":
            raise DecodeError(f"{file}: holds floating-point numbers: save 8 or 16 bits a pixel")
    # Pillow reduces 16-bit colour to 8 bits, but OpenCV does not. Both use the weights of Rec. 601.
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    grey = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flags)
    if grey is None:
        grey = np.asarray(picture.convert("L"))
    if grey.dtype not in (np.uint8, np.uint16):
        raise DecodeError(f"{file}: holds {grey.dtype} numbers: save 8 or 16 bits a pixel")
    return grey


def _from_int32(values: np.ndarray, file: Path) -> UInt16[np.ndarray, "h w"]:
    if values.min() < 0 or values.max() > 65535:
        span = f"{values.min()} to {values.max()}"
        raise DecodeError(f"{file}: holds values from {span}: save 8 or 16 bits a pixel")
    return values.astype(np.uint16)
