"""Depth, colours, cameras and poses of others: read without trust, and refused in one line."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...base.errors import DatasetError
from ...base.frames import is_rigid, rigid
from ...dataset.records import MM_PER_M
from ...rig.optics import Optics, optics_of
from ...world.parts import Part
from ..depth_file import in_metres, read_image
from ..picture_pairs import refuse_damaged
from .source import SourceImage

NO_OBJECTS = (np.zeros(0, np.int64), np.zeros((0, 4, 4)))
_ROUNDED = 2e-3  # Files with three digits have rotations that are off by half of it.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FileSource:
    """A `Source` whose images are read by a function of their scene and number."""

    folder: Path
    split: str
    images: tuple[tuple[int, int], ...]
    parts: Mapping[int, Part]
    plain: frozenset[int]
    image_of: Callable[[int, int], SourceImage]
    sensor: str = ""
    is_bop: bool = False

    def read(self, scene_id: int, image_id: int) -> SourceImage:
        if (scene_id, image_id) not in self.images:
            raise DatasetError(f"{self.folder}: has no image {image_id} of scene {scene_id}")
        return self.image_of(scene_id, image_id)


def depth_steps(path: Path) -> np.ndarray:
    """Stored depth of one channel: whole numbers of 16 bits, or floats.

    Raises:
        DatasetError: the file is missing, damaged, or of another kind.
    """
    steps = _picture(path)
    if steps.ndim != 2 or (steps.dtype != np.uint16 and steps.dtype.kind != "f"):
        shape = " x ".join(str(length) for length in steps.shape)
        raise DatasetError(
            f"{path}: is {shape} of {steps.dtype}: depth has one channel of 16 bits or of floats: "
            "export it again without a colour map"
        )
    return steps


def depth_of_steps(steps: np.ndarray, scale_mm: float, path: Path) -> Float[np.ndarray, "h w"]:
    """Depth [m]; 0 and what is not finite is NaN.

    Raises:
        DatasetError: depth is negative, or too far for millimetres.
    """
    depth_m = in_metres(steps, scale_mm / MM_PER_M, str(path))
    if (depth_m < 0).any():
        raise DatasetError(f"{path}: has negative depth: give z of the camera frame, which is > 0")
    return depth_m


def picture_rgb(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """A colour picture, or a grey one with three equal bands; 16 bits become 8.

    Raises:
        DatasetError: the file is missing, damaged, or of another kind.
    """
    image = _picture(path)
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.dtype != np.uint8 or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise DatasetError(
            f"{path}: is {image.dtype} {image.shape}: give 8 or 16 bits of a picture"
        )
    if image.ndim == 2 or image.shape[2] == 1:
        return np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
    return np.ascontiguousarray(image[..., 2::-1])


def _picture(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: download it again, or remove its image")
    refuse_damaged(path)
    return read_image(path)


def camera_of(
    K: Sequence[float] | Float[np.ndarray, "3 3"],
    size_px: tuple[int, int],
    where: str,
    distortion: Sequence[float] = (0.0,) * 5,
) -> Optics:
    """The camera of a matrix, by rows.

    Raises:
        DatasetError: the matrix is that of no camera, or has a skew.
    """
    (fx, skew, _), (zero, fy, _), last = np.reshape(K, (3, 3)).astype(float).tolist()
    if min(fx, fy) <= 0 or max(abs(skew), abs(zero)) > 1e-6 * fx or last != [0.0, 0.0, 1.0]:
        numbers = ", ".join(f"{number:.6g}" for number in np.ravel(K))
        raise DatasetError(
            f"{where}: [{numbers}] is no camera matrix: give [fx, 0, cx, 0, fy, cy, 0, 0, 1] with "
            "fx and fy greater than 0"
        )
    try:
        return optics_of(np.reshape(K, (3, 3)).astype(float), size_px, distortion)
    except ValueError as error:
        raise DatasetError(f"{where}: {error}") from error


def pose_of(
    rotation: Sequence[float] | Float[np.ndarray, "3 3"], translation_m: np.ndarray, where: str
) -> Float[np.ndarray, "4 4"]:
    """A pose of a file; its rotation is the one nearest to the rounded numbers.

    Raises:
        DatasetError: the numbers are no rotation, or are not finite.
    """
    stored = np.reshape(rotation, (3, 3)).astype(float)
    if not is_rigid(rigid(stored, np.asarray(translation_m, float)), tolerance=_ROUNDED):
        raise DatasetError(
            f"{where}: its pose is no rotation and translation: give an orthonormal matrix with "
            "determinant +1, by rows and without a scale"
        )
    left, _, right = np.linalg.svd(stored)
    return rigid(left @ right, np.asarray(translation_m, float))


def objects_of(
    obj_id: Sequence[int], poses: Sequence[np.ndarray]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    return np.array(obj_id, np.int64), np.array(poses, float).reshape(-1, 4, 4)


def refuse_other_size(rgb: np.ndarray | None, depth_m: np.ndarray, path: Path) -> None:
    """Raises DatasetError where a colour picture is not of the depth's size."""
    if rgb is not None and rgb.shape[:2] != depth_m.shape:
        (rows, columns), (h, w) = rgb.shape[:2], depth_m.shape
        raise DatasetError(
            f"{path}: is {columns} x {rows} pixels, its depth {w} x {h}: give both of one camera"
        )
