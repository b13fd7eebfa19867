"""Readers of depth maps, pictures and camera matrices in NPY, PNG, TIFF and PLY files.

A PLY file must be an organised point cloud: one vertex per pixel, row by row, in the camera frame.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ..base.errors import DatasetError
from ..base.file_limits import load_array, parse_json, refuse_large_picture, refuse_turned
from ..base.folder import visible_entries
from ..base.ply import COLORS, read_vertices
from ..dataset.read.example import known_depth
from ..rig.optics import Optics, optics_of, picture_rays

NO_CAMERA = "the file does not state its camera: give the intrinsics (--intrinsics fx,fy,cx,cy)"
DEPTH_FILES = (".npy", ".png", ".ply", ".tif", ".tiff")
_FARTHEST_M = 100.0
_SIZE = {"num_cols": "width", "width": "width", "num_rows": "height", "height": "height"}
_FIT_PX = 0.5  # largest allowed RMS reprojection error when K is fitted to a cloud


@dataclass(frozen=True, slots=True, kw_only=True)
class FileOptions:
    """Facts about depth files that the files themselves do not contain.

    Attributes:
        K: intrinsics [px]; None estimates them from the points of an organised cloud.
        distortion: k1, k2, p1, p2, k3 of OpenCV.
        scale_m: metres per unit of depth; required for integers; None reads floats as metres.
        size_px: width and height of a cloud whose file does not state them.
        ray_length: whether depth is the distance from the camera along each pixel's ray, which
            the readers convert to z.
        max_depth_m: largest depth; larger values count as missing; None sets no limit.
    """

    K: Float[np.ndarray, "3 3"] | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    scale_m: float | None = None
    size_px: tuple[int, int] | None = None
    ray_length: bool = False
    max_depth_m: float | None = None


NO_OPTIONS = FileOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthFile:
    """Depth [m] (NaN where missing), camera matrix, and the colours of a cloud that has them.

    `gray` is the mean of the three colours, from 0 to 1. `largest_px` counts the pixels with the
    largest number of the file's type, which marks missing depth; `beyond_px` counts the pixels with
    depth beyond `FileOptions.max_depth_m`.
    """

    depth_m: Float[np.ndarray, "h w"]
    K: Float[np.ndarray, "3 3"]
    gray: Float[np.ndarray, "h w"] | None = None
    rgb: UInt8[np.ndarray, "h w 3"] | None = None
    largest_px: int = 0
    beyond_px: int = 0


def read_intrinsics(text: str) -> Float[np.ndarray, "3 3"]:
    """Read K [px] from the text 'fx,fy,cx,cy' or from the file that the text names.

    NPY and text files contain 3 x 3 numbers. JSON files contain them as a list or under `K`, or
    have BOP's `cam_K` or the keys `fx`, `fy`, `cx`, `cy`.

    Raises:
        DatasetError: the text is none of these.
    """
    wanted = "give fx,fy,cx,cy or a file of 3 x 3 numbers (.npy, .txt, .json) or of BOP's keys"
    path = Path(text)
    try:
        if path.suffix == ".npy":
            K = load_array(path).astype(np.float64)
        elif path.suffix == ".json":
            K = _json_K(parse_json(path.read_bytes()))
        elif path.is_file():
            K = np.loadtxt(path, ndmin=2)
        else:
            fx, fy, cx, cy = (float(word) for word in text.split(","))
            K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
        why = f" ({error})" if type(error) is ValueError else ""
        raise DatasetError(f"intrinsics {text}: cannot be read{why}: {wanted}") from error
    if K.shape != (3, 3):
        shape = " x ".join(str(length) for length in K.shape)
        raise DatasetError(f"intrinsics {text}: holds {shape} numbers: {wanted}")
    if not (np.isfinite(K).all() and np.allclose(K[2], [0, 0, 1]) and min(K[0, 0], K[1, 1]) > 0):
        raise DatasetError(f"intrinsics {text}: {K.tolist()} is not a camera matrix: {wanted}")
    return K


def read_depth(path: Path, options: FileOptions) -> DepthFile:
    """Read a depth map; see `FileOptions` for what the file does not say.

    Raises:
        DatasetError: the file is missing, damaged or of another form, or an option is missing.
    """
    if path.suffix.lower() == ".ply":
        return _read_cloud(path, options)
    value = load_npy(path) if path.suffix.lower() == ".npy" else read_image(path)
    if options.K is None:
        raise DatasetError(f"{path}: {NO_CAMERA}")
    if value.ndim == 3 and value.shape[2] == 1:  # Some programs write (h, w, 1) for one channel.
        value = value[..., 0]
    if value.ndim != 2:
        raise DatasetError(
            f"{path}: has the shape {value.shape}: give a depth map with rows and columns"
        )
    if value.dtype.kind not in "uif" or value.dtype.itemsize == 1:
        raise DatasetError(
            f"{path}: has {value.dtype} numbers: give integers of 16 bits or floating-point numbers"
        )
    if value.dtype.kind in "ui" and options.scale_m is None:
        raise DatasetError(
            f"{path}: has {value.dtype} numbers: give the scale in metres per unit (such as "
            "--scale 0.001)"
        )
    scale_m = 1.0 if options.scale_m is None else options.scale_m
    depth_m = in_metres(value, scale_m, str(path))
    if options.ray_length:
        size_px = depth_m.shape[0], depth_m.shape[1]
        optics = optics_of(options.K, size_px, options.distortion or (0.0,) * 5)
        depth_m = z_of_ray_length(depth_m, optics)
    largest = np.isfinite(value) & (value != 0) & ~known_depth(value)
    depth_m, beyond_px = _without_far(depth_m, options)
    return DepthFile(
        depth_m=depth_m, K=options.K, largest_px=int(largest.sum()), beyond_px=beyond_px
    )


def _read_cloud(path: Path, options: FileOptions) -> DepthFile:
    """Read an organised PLY, ASCII or binary, in which missing points are NaN or at the origin."""
    if options.ray_length:
        raise DatasetError(
            f"{path}: is a cloud of points, which states z: leave out --ray-length, or give depth "
            "maps"
        )
    try:
        header, table, count = read_vertices(path)
        width_px, height_px = _size(path, header, count, options.size_px)
        point = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        point[~np.isfinite(point).all(axis=-1) | (point == 0).all(axis=-1)] = np.nan
        point = point.reshape(height_px, width_px, 3)
        K = _camera_of(point) if options.K is None else options.K
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise DatasetError(f"{path}: {error}") from error
    gray = rgb = None
    if all(name in table and table[name].dtype == np.uint8 for name in COLORS):
        rgb = np.stack([table[name] for name in COLORS], axis=-1).reshape(height_px, width_px, 3)
        gray = rgb.mean(axis=-1) / 255
    scale_m = 1.0 if options.scale_m is None else options.scale_m
    depth_m, beyond_px = _without_far(in_metres(point[..., 2], scale_m, str(path)), options)
    return DepthFile(depth_m=depth_m, K=K, gray=gray, rgb=rgb, beyond_px=beyond_px)


def _without_far(
    depth_m: Float[np.ndarray, "h w"], options: FileOptions
) -> tuple[Float[np.ndarray, "h w"], int]:
    """Return depth with NaN beyond `max_depth_m`, and the number of pixels beyond it."""
    beyond = depth_m > (np.inf if options.max_depth_m is None else options.max_depth_m)
    return np.where(beyond, np.nan, depth_m), int(beyond.sum())


def _camera_of(point: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3 3"]:
    """Fit by least squares the K that projects each point to its own pixel.

    Raises:
        ValueError: there are too few points, or no pinhole camera fits them well enough, because
            the lens has distortion or the points are in another frame.
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
    """Return width and height [px]: `size_px` if given, else the size in the header."""
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


def z_of_ray_length(length_m: Float[np.ndarray, "h w"], optics: Optics) -> Float[np.ndarray, "h w"]:
    """Return z of the camera frame for distances from the camera along each pixel's ray.

    The ray through a pixel is (x, y, 1), so `z = length / sqrt(x^2 + y^2 + 1)`.
    """
    return length_m / np.linalg.norm(picture_rays(optics), axis=-1)


def in_metres(value: np.ndarray, scale_m: float, name: str) -> Float[np.ndarray, "h w"]:
    """Return depth [m]; NaN where the file holds no distance (see `known_depth`)."""
    if not 0 < scale_m < np.inf:
        raise DatasetError(f"{name}: scale is {scale_m}; give metres per unit, greater than 0")
    known = known_depth(value)
    depth_m = np.where(known, value.astype(np.float64) * scale_m, np.nan)
    if known.any() and np.nanmedian(depth_m) > _FARTHEST_M:
        raise DatasetError(
            f"{name}: the median depth is {np.nanmedian(depth_m):.4g} m, up to {_FARTHEST_M:.0f} "
            "are allowed: if the unit is millimetres, give a scale of 0.001"
        )
    return depth_m


def read_gray(path: Path) -> Float[np.ndarray, "h w"]:
    """Read a picture as gray values from 0 to 1; floats in NPY already have this range."""
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim == 3:
        image = image[..., :3].mean(axis=-1, dtype=np.float64).astype(image.dtype)
    if np.issubdtype(image.dtype, np.integer):
        return image / np.float64(np.iinfo(image.dtype).max)
    return image.astype(np.float64)


def depth_files(folder: Path) -> list[Path]:
    """Return `depth.npy` if there is one (from `graycast rig decode`), else all depth files."""
    if (folder / "depth.npy").is_file():
        return [folder / "depth.npy"]
    files = [file for file in visible_entries(folder) if file.suffix.lower() in DEPTH_FILES]
    if not files:
        kinds = ", ".join(DEPTH_FILES)
        raise DatasetError(f"{folder}: has neither depth files ({kinds}) nor a BOP dataset")
    return files


def read_image(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: check the path")
    refuse_large_picture(path, str(path), DatasetError)
    refuse_turned(path, str(path), DatasetError)
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DatasetError(f"{path}: is not an image, or is damaged: use PNG, TIFF, NPY or PLY")
    return image


def load_npy(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: check the path")
    try:
        return load_array(path)
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read as NPY ({error}): check the file") from error


def load_json(path: Path, remedy: str) -> dict[str, Any]:
    """Return the object in a JSON file as a dictionary.

    Raises:
        DatasetError: the file is missing or damaged, or has no keys; the text names the remedy.
    """
    try:
        content = parse_json(path.read_bytes())
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file: {remedy}") from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as JSON ({error}): check the file") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: holds no keys: {remedy}")
    return content


def _json_K(content: dict[str, Any] | list[Any]) -> Float[np.ndarray, "rows columns"]:
    """Read K from a list, from `fx`, `fy`, `cx`, `cy`, from `K`, or from the first BOP `cam_K`."""
    if isinstance(content, list):
        return np.array(content, dtype=np.float64, ndmin=2)
    if "fx" in content:
        fx, fy, cx, cy = (float(content[key]) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if "K" in content:
        return np.array(content["K"], dtype=np.float64).reshape(3, 3)
    entry = content if "cam_K" in content else next(iter(content.values()))
    return np.array(entry["cam_K"], dtype=np.float64).reshape(3, 3)
