"""Readers of third-party depth, colours, cameras and poses, with checks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, UInt8

from ...base.errors import DatasetError
from ...base.frames import is_rigid, rigid
from ...dataset.files.safe_reading import Form, Unreadable, read_json
from ...rig.optics import Optics, optics_of
from ..depth_file import in_metres, load_npy, read_image, z_of_ray_length
from ..picture_pairs import refuse_damaged
from .source import SourceImage

REPAIR = "repair the file, or download it again"
_ROUNDED = 2e-3  # twice the error of rotation matrices that are written with three digits

R = TypeVar("R")


def record_of(path: Path, form: Form[R]) -> R:
    """Read a JSON file as a record of the required form, or raise a DatasetError."""
    try:
        return read_json(path, form)
    except Unreadable as error:
        raise DatasetError(f"{path.parent}/{error}: {REPAIR}") from error


def source_image(
    depth_m: Float[np.ndarray, "h w"],
    rgb: Path | None,
    camera: tuple[Any, str],
    objects: Sequence[tuple[int, np.ndarray]] = (),
    distortion: Sequence[float] = (0.0,) * 5,
    *,
    step_m: float,
    ray_length: bool = False,
) -> SourceImage:
    """Return an image from its depth, its picture's file, its camera and its objects.

    Args:
        depth_m: depth from `stored_depth`.
        rgb: path of the colour or grey picture.
        camera: the matrix by rows, and its place in the files for errors.
        objects: id and pose of each object.
        step_m: step of the depth from `stored_depth`.
        ray_length: whether `depth_m` is the distance along each pixel's ray, to convert to z.

    Raises:
        DatasetError: the picture is damaged or of another size, or the matrix has a wrong form.
    """
    colours = None if rgb is None else _rgb(rgb)
    if colours is not None and colours.shape[:2] != depth_m.shape:
        (rows, columns), (h, w) = colours.shape[:2], depth_m.shape
        raise DatasetError(
            f"{rgb}: is {columns} x {rows} pixels, its depth {w} x {h}: give both of one camera"
        )
    optics = camera_of(*camera, depth_m.shape, distortion)
    return SourceImage(
        camera=optics,
        depth_m=z_of_ray_length(depth_m, optics) if ray_length else depth_m,
        rgb=colours,
        obj_id=np.array([obj_id for obj_id, _ in objects], np.int64),
        T_cam_part=np.array([T for _, T in objects], float).reshape(-1, 4, 4),
        step_m=step_m,
    )


def stored_steps(path: Path) -> np.ndarray:
    """Read stored depth with one channel: 16-bit integers or floats.

    Raises:
        DatasetError: the file is missing, damaged, or of another type.
    """
    steps = load_npy(path) if path.suffix == ".npy" else _picture(path)
    if steps.ndim != 2 or (steps.dtype != np.uint16 and steps.dtype.kind != "f"):
        raise DatasetError(
            f"{path}: is {steps.dtype} {steps.shape}: depth has one channel of 16 bits or of "
            "floats: export it again without a colour map"
        )
    return steps


def stored_depth(path: Path, scale_m: float) -> tuple[Float[np.ndarray, "h w"], float]:
    """Read depth [m] and its step [m], which is 0 for floats; unknown depth becomes NaN.

    Raises:
        DatasetError: see `stored_steps`; or depth is negative or too large.
    """
    steps = stored_steps(path)
    depth_m = in_metres(steps, scale_m, str(path))
    if (depth_m < 0).any():
        raise DatasetError(f"{path}: has negative depth: give z of the camera frame, which is > 0")
    return depth_m, scale_m if steps.dtype == np.uint16 else 0.0


def _rgb(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read a colour picture, or a grey picture as three equal bands; 16 bits are reduced to 8."""
    image = _picture(path)
    image = image[..., None] if image.ndim == 2 else image
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.dtype != np.uint8 or image.shape[2] not in (1, 3, 4):
        raise DatasetError(f"{path}: is {image.dtype} {image.shape}: give a picture of 8 bits")
    return np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[..., 2::-1].copy()


def _picture(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: download it again, or remove its image")
    refuse_damaged(path)
    return read_image(path)


def camera_of(
    K: Any, where: str, size_px: tuple[int, ...], distortion: Sequence[float] = (0.0,) * 5
) -> Optics:
    """Return the camera with the matrix K, given by rows; `size_px` is height and width.

    Raises:
        DatasetError: K is not a camera matrix, or has a skew.
    """
    matrix = np.reshape(K, (3, 3)).astype(float)
    (fx, skew, _), (zero, _, _), last = matrix.tolist()
    if max(abs(skew), abs(zero)) > 1e-6 * fx or last != [0.0, 0.0, 1.0]:
        raise DatasetError(
            f"{where}: {matrix.ravel().tolist()} is no camera matrix: give [fx, 0, cx, 0, fy, cy, "
            "0, 0, 1] with fx greater than 0"
        )
    try:
        return optics_of(matrix, (size_px[0], size_px[1]), distortion)
    except ValueError as error:
        raise DatasetError(f"{where}: {error}") from error


def pose_of(rotation: Any, translation_m: Any, where: str) -> Float[np.ndarray, "4 4"]:
    """Return a pose from a file, with the rotation matrix that is nearest to the rounded numbers.

    Raises:
        DatasetError: the matrix is not a rotation, or numbers are not finite.
    """
    T = rigid(np.reshape(rotation, (3, 3)).astype(float), np.asarray(translation_m, float))
    if not is_rigid(T, tolerance=_ROUNDED):
        raise DatasetError(
            f"{where}: its pose is no rotation and translation: give an orthonormal matrix with "
            "determinant +1, by rows and without a scale"
        )
    left, _, right = np.linalg.svd(T[:3, :3])
    return rigid(left @ right, T[:3, 3])
