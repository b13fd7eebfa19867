"""Depth maps, pictures and camera matrices of any scanner, from files: NPY, PNG, TIFF, PLY."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from ..base.errors import DatasetError
from ..base.file_limits import load_array, parse_json, refuse_large_picture
from .organised import camera_of, read_ply

DEPTH_FILES = (".npy", ".png", ".ply", ".tif", ".tiff")
_FARTHEST_M = 100.0


def read_intrinsics(text: str) -> Float[np.ndarray, "3 3"]:
    """K from 'fx,fy,cx,cy' [px] or from a file: NPY or text with 3 x 3 numbers, or JSON with
    `cam_K` or `fx`, `fy`, `cx`, `cy`, as BOP has them, or with the 3 x 3 numbers as a list.

    Raises:
        DatasetError: it is none of these.
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


def read_depth(
    path: Path,
    scale_m: float | None,
    size_px: tuple[int, int] | None,
    K: Float[np.ndarray, "3 3"] | None,
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"] | None, Float[np.ndarray, "3 3"]]:
    """Depth [m], the brightness that the file itself has, and K."""
    gray = None
    if path.suffix.lower() == ".ply":
        try:
            cloud = read_ply(path, size_px)
            K = camera_of(cloud.point) if K is None else K
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise DatasetError(f"{path}: {error}") from error
        value, gray = cloud.point[..., 2], cloud.gray
    else:
        value = load_npy(path) if path.suffix.lower() == ".npy" else read_image(path)
    if K is None:
        raise DatasetError(
            f"{path}: the file does not state its camera: give the intrinsics (--intrinsics "
            "fx,fy,cx,cy)"
        )
    if value.ndim == 3 and value.shape[2] == 1:  # one channel, as pictures of a batch are kept
        value = value[..., 0]
    if value.ndim != 2:
        raise DatasetError(
            f"{path}: has the shape {value.shape}: give a depth map with rows and columns"
        )
    if value.dtype.kind not in "uif" or value.dtype.itemsize == 1:
        raise DatasetError(
            f"{path}: has {value.dtype} numbers: give integers of 16 bits or floating-point numbers"
        )
    if value.dtype.kind in "ui" and scale_m is None:
        raise DatasetError(
            f"{path}: has {value.dtype} numbers: give the scale in metres per unit (such as "
            "--scale 0.001)"
        )
    return in_metres(value, 1.0 if scale_m is None else scale_m, str(path)), gray, K


def in_metres(value: np.ndarray, scale_m: float, name: str) -> Float[np.ndarray, "h w"]:
    """Depth [m] in which 0 and what is not finite is NaN."""
    if not 0 < scale_m < np.inf:
        raise DatasetError(f"{name}: scale is {scale_m}; give metres per unit, greater than 0")
    known = np.isfinite(value) & (value != 0)
    depth_m = np.where(known, value.astype(np.float64) * scale_m, np.nan)
    if known.any() and np.nanmedian(depth_m) > _FARTHEST_M:
        raise DatasetError(
            f"{name}: the median depth is {np.nanmedian(depth_m):.4g} m, up to {_FARTHEST_M:.0f} "
            "are allowed: if the unit is millimetres, give a scale of 0.001"
        )
    return depth_m


def read_gray(path: Path) -> Float[np.ndarray, "h w"]:
    """A picture as shares of its type's range; floats in NPY are such shares already."""
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim == 3:
        image = image[..., :3].mean(axis=-1, dtype=np.float64).astype(image.dtype)
    if np.issubdtype(image.dtype, np.integer):
        return image / np.float64(np.iinfo(image.dtype).max)
    return image.astype(np.float64)


def depth_files(folder: Path) -> list[Path]:
    """`depth.npy` alone where `graycast rig decode` wrote it, else all that may be depth."""
    if (folder / "depth.npy").is_file():
        return [folder / "depth.npy"]
    found = sorted(f for f in folder.iterdir() if f.suffix.lower() in DEPTH_FILES)
    if not found:
        kinds = ", ".join(DEPTH_FILES)
        raise DatasetError(f"{folder}: has neither depth files ({kinds}) nor a BOP dataset")
    return found


def read_image(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: check the path")
    refuse_large_picture(path, str(path), DatasetError)
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


def load_json(path: Path) -> dict[str, Any]:
    try:
        content = parse_json(path.read_bytes())
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as JSON ({error}): check the file") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: holds no keys: give a file of intrinsics")
    return content


def _json_K(content: dict[str, Any] | list[Any]) -> Float[np.ndarray, "rows columns"]:
    """BOP's `camera.json`, an entry of `scene_camera.json`, or the first of all; K; or a list."""
    if isinstance(content, list):
        return np.array(content, dtype=np.float64, ndmin=2)
    if "fx" in content:
        fx, fy, cx, cy = (float(content[key]) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if "K" in content:
        return np.array(content["K"], dtype=np.float64).reshape(3, 3)
    entry = content if "cam_K" in content else next(iter(content.values()))
    return np.array(entry["cam_K"], dtype=np.float64).reshape(3, 3)
