"""Organised point clouds in PLY: a vertex per pixel, row by row, in the camera frame."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ..errors import DatasetError

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_SIZE = {"num_cols": "width", "width": "width", "num_rows": "height", "height": "height"}
_FIT_PX = 0.5  # largest RMS of a cloud about its own pinhole camera
_COLORS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True, kw_only=True)
class OrganisedCloud:
    """Points of a cloud in the file's unit, NaN where there is none, and their look, if it is said.

    `gray` is the mean of the colours as a share of their range.
    """

    point: Float[np.ndarray, "h w 3"]
    gray: Float[np.ndarray, "h w"] | None
    rgb: UInt8[np.ndarray, "h w 3"] | None = None


def read_ply(path: Path, size_px: tuple[int, int] | None = None) -> OrganisedCloud:
    """Read an organised PLY, ASCII or binary; missing points are NaN or at the origin.

    Args:
        path: the file. Its vertices are its first element; what follows is not read.
        size_px: width and height, where the header has no `obj_info num_cols` and `num_rows`.

    Raises:
        DatasetError: it is no PLY, is cut off, or its size is unknown or another.
    """
    header, body = _split(path)
    try:
        count, names = _vertices(path, header)
        order = _order(path, header)
    except (ValueError, IndexError) as error:
        raise DatasetError(f"{path}: its header is damaged: export it again") from error
    if order == "=":
        table = _ascii(path, body, count, names)
    else:
        kind = np.dtype([(name, order + code) for name, code in names])
        if len(body) < count * kind.itemsize:
            raise DatasetError(f"{path}: ends before its {count} vertices do: copy it again")
        table = np.frombuffer(body, dtype=kind, count=count)
    width_px, height_px = _size(path, header, count, size_px)
    point = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    point[~np.isfinite(point).all(axis=-1) | (point == 0).all(axis=-1)] = np.nan
    gray = rgb = None
    if all((name, "u1") in names for name in _COLORS):
        color = np.stack([table[name] for name in _COLORS], axis=-1)
        rgb = color.reshape(height_px, width_px, 3).astype(np.uint8)
        gray = rgb.mean(axis=-1) / 255
    return OrganisedCloud(point=point.reshape(height_px, width_px, 3), gray=gray, rgb=rgb)


def camera_of(point: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3 3"]:
    """K of the pinhole camera that sees each point in its own pixel, by least squares.

    Raises:
        ValueError: too few points, or none such within half a pixel: a lens with distortion, or
            points of another frame.
    """
    y, x = np.nonzero(~np.isnan(point[..., 2]))
    if len(x) < 100:
        raise ValueError(f"{len(x)} points are too few to find the camera: give the intrinsics")
    across, down = (point[y, x, i] / point[y, x, 2] for i in (0, 1))
    one = np.ones(len(x))
    (fx, cx), _, rank_x, _ = np.linalg.lstsq(np.stack([across, one], 1), x, rcond=None)
    (fy, cy), _, rank_y, _ = np.linalg.lstsq(np.stack([down, one], 1), y, rcond=None)
    off = np.hypot(fx * across + cx - x, fy * down + cy - y)
    rms_px = float(np.sqrt((off**2).mean()))
    if min(rank_x, rank_y) < 2 or rms_px > _FIT_PX or min(fx, fy) <= 0:
        raise ValueError(
            f"the points are {rms_px:.2f} px RMS off every pinhole camera, {_FIT_PX} are allowed: "
            "give the intrinsics, or export the cloud in the camera frame"
        )
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _split(path: Path) -> tuple[list[str], bytes]:
    data = path.read_bytes()
    end = re.search(rb"\nend_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or end is None:
        raise DatasetError(f"{path}: is not a PLY: its header is missing")
    return data[: end.start()].decode("ascii", errors="replace").splitlines(), data[end.end() :]


def _order(path: Path, header: list[str]) -> str:
    form = next((line.split()[1] for line in header if line.startswith("format ")), "none")
    if form not in _ORDERS:
        raise DatasetError(f"{path}: format is {form}: choose one of {', '.join(_ORDERS)}")
    return _ORDERS[form]


def _vertices(path: Path, header: list[str]) -> tuple[int, list[tuple[str, str]]]:
    """How many there are, and names and types of their properties."""
    at = [i for i, line in enumerate(header) if line.startswith("element ")]
    first = header[at[0]].split() if at else []
    if len(first) != 3 or first[1] != "vertex":
        raise DatasetError(f"{path}: its first element is not 'vertex': write the vertices first")
    names = []
    for line in header[at[0] + 1 : at[1] if len(at) > 1 else None]:
        words = line.split()
        if words[:1] == ["property"]:
            if words[1] not in _TYPES:
                raise DatasetError(f"{path}: vertices have a property of type {words[1]}")
            names.append((words[2], _TYPES[words[1]]))
    if missing := set("xyz") - {name for name, _ in names}:
        raise DatasetError(f"{path}: vertices have no {', '.join(sorted(missing))}")
    return int(first[2]), names


def _ascii(
    path: Path, body: bytes, count: int, names: list[tuple[str, str]]
) -> Mapping[str, np.ndarray]:
    lines = body.decode("ascii", errors="replace").splitlines()[:count]
    try:
        rows = np.array([line.split() for line in lines], dtype=np.float64)
    except ValueError as error:
        raise DatasetError(f"{path}: its vertices are not numbers in equal rows") from error
    if rows.shape != (count, len(names)):
        raise DatasetError(
            f"{path}: has {len(rows)} vertices of {rows.shape[1] if rows.ndim > 1 else 0} numbers, "
            f"its header says {count} of {len(names)}"
        )
    return {name: rows[:, i] for i, (name, _) in enumerate(names)}


def _size(
    path: Path, header: list[str], count: int, size_px: tuple[int, int] | None
) -> tuple[int, int]:
    """Width and height: those given, or those of the header."""
    said = {}
    for line in header:
        words = line.split()
        if len(words) == 3 and words[0] in ("obj_info", "comment") and words[1] in _SIZE:
            said[_SIZE[words[1]]] = int(words[2])
    if size_px is None and len(said) < 2:
        raise DatasetError(
            f"{path}: does not say how its {count} vertices make rows and columns: export it "
            "organised with 'obj_info num_cols' and 'obj_info num_rows', or give the size"
        )
    width_px, height_px = size_px or (said["width"], said["height"])
    if width_px * height_px != count:
        raise DatasetError(
            f"{path}: has {count} vertices, {width_px} x {height_px} pixels need "
            f"{width_px * height_px}: export every pixel, the missing ones as 0 0 0 or nan"
        )
    return width_px, height_px
