"""Organised point clouds in PLY: a vertex per pixel, row by row, in the camera frame."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ..base.errors import DatasetError
from ..base.ply import COLORS, read_vertices

_SIZE = {"num_cols": "width", "width": "width", "num_rows": "height", "height": "height"}
_FIT_PX = 0.5  # It is the largest RMS of a cloud about its own pinhole camera.


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
    header, table, count = read_vertices(path)
    width_px, height_px = _size(path, header, count, size_px)
    point = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    point[~np.isfinite(point).all(axis=-1) | (point == 0).all(axis=-1)] = np.nan
    gray = rgb = None
    if all(name in table and table[name].dtype == np.uint8 for name in COLORS):
        rgb = np.stack([table[name] for name in COLORS], axis=-1).reshape(height_px, width_px, 3)
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
            f"the points are {rms_px:.2f} px RMS from the best pinhole camera, and {_FIT_PX} are "
            "allowed: give the intrinsics, or export the cloud in the camera frame"
        )
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _size(
    path: Path, header: list[str], count: int, size_px: tuple[int, int] | None
) -> tuple[int, int]:
    """Width and height: those given, or those of the header."""
    size_of = {}
    for line in header:
        words = line.split()
        if len(words) == 3 and words[0] in ("obj_info", "comment") and words[1] in _SIZE:
            size_of[_SIZE[words[1]]] = int(words[2])
    if size_px is None and len(size_of) < 2:
        raise DatasetError(
            f"{path}: does not state how its {count} vertices form rows and columns: export an "
            "organised cloud with 'obj_info num_cols' and 'obj_info num_rows', or give the size"
        )
    width_px, height_px = size_px or (size_of["width"], size_of["height"])
    if width_px * height_px != count:
        raise DatasetError(
            f"{path}: has {count} vertices, {width_px} x {height_px} pixels need "
            f"{width_px * height_px}: export every pixel, and the missing ones as 0 0 0 or nan"
        )
    return width_px, height_px
