"""Import OpenCV stereo calibrations as rigs.

Only this module knows OpenCV's convention `X_proj = R X_cam + T`, and converts it to `T_cam_proj`.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError
from ...base.file_limits import parse_json
from ...base.frames import UNITS_M, inverse, rigid
from ...base.settings import parse_yaml, read_text
from ...rig.optics import Optics
from ...rig.pair import Rig, common_depths_m
from .checks import build_optics, build_rig, check_rotation, is_file_storage

MAX_SKEW = 1e-6  # Largest accepted skew as a share of the focal length; `Optics` has no skew.
MIN_BASELINE_M = 0.001  # A smaller baseline means that the unit is wrong.
_MOST_BYTES = 100_000_000

# The keys of OpenCV's sample stereo_calib, the names in OpenCV's documentation and of the arguments
# of cv2.stereoCalibrate, and the keys of Moreno and Taubin's projector-camera calibration.
_KEYS = {
    "camera matrix": ("M1", "K1", "cameraMatrix1", "cam_K"),
    "camera distortion": ("D1", "distCoeffs1", "cam_kc"),
    "projector matrix": ("M2", "K2", "cameraMatrix2", "pro_K"),
    "projector distortion": ("D2", "distCoeffs2", "pro_kc"),
    "R": ("R",),
    "T": ("T",),
    "camera size": ("image_size", "cam_size"),
    "projector size": ("proj_size", "pro_size"),
}


def import_opencv(
    path: Path,
    *,
    unit: str | None,
    near_m: float | None = None,
    far_m: float | None = None,
    camera_size_px: tuple[int, int] | None,
    projector_size_px: tuple[int, int] | None,
) -> Rig:
    """Read an OpenCV stereo calibration of a camera (first) and a projector (second).

    The file is OpenCV's FileStorage (YAML, XML, JSON), or nested lists in YAML, JSON or NPZ, with
    the keys of `_KEYS` and `X_proj = R X_cam + T`. Other keys are ignored.

    Args:
        unit: unit of T, one of `UNITS_M`; None is mm if `|T| > 10` and metres if `|T| < 2`.
        near_m: nearest depth of the working range, which OpenCV does not state; None: the nearest
            depth at which both fields of view overlap, at least half a baseline.
        far_m: farthest depth of the working range; None: the farthest depth at which they
            overlap, at most twenty baselines.
        camera_size_px: (width, height), which replaces the size in the file.
        projector_size_px: the same for the projector.

    Raises:
        ConfigError: the file is no such calibration; the message names file, key and remedy.
    """
    content = _read_calibration(path)
    R = _array(content, "R", path, shapes=((3, 3),))
    T = _array(content, "T", path, shapes=((3,), (3, 1), (1, 3))).ravel()
    check_rotation(R, f"{path}: {_find(content, 'R', path)}")
    T_m = T * _metres_per_unit(T, unit, f"{path}: {_find(content, 'T', path)}")
    camera = _device(content, "camera", path, camera_size_px)
    projector = _device(content, "projector", path, projector_size_px)
    T_cam_proj = inverse(rigid(R, T_m))
    if near_m is None or far_m is None:
        first_m, last_m = _common_range_m(camera, projector, T_cam_proj, path)
        near_m, far_m = near_m or first_m, far_m or last_m
    return build_rig(
        path,
        name=path.stem,
        camera=camera,
        projector=projector,
        T_cam_proj=T_cam_proj,
        near_m=near_m,
        far_m=far_m,
    )


def missing_distortions(path: Path) -> tuple[str, ...]:
    """Return a warning for each device whose distortion a calibration file does not state.

    For OpenCV this means a lens without distortion, but the key may have another name.

    Raises:
        ConfigError: the file cannot be read.
    """
    content = _read_calibration(path)
    known = {key for keys in _KEYS.values() for key in keys}
    other = ", ".join(str(key) for key in content if key not in known) or "nothing else"
    return tuple(
        f"{path}: states no distortion of the {device}, so its lens is taken to have none; the "
        f"distortion is read from {_listed(f'{device} distortion')}, and the file holds {other}"
        for device in ("camera", "projector")
        if _find(content, f"{device} distortion", path) is None
    )


def _common_range_m(
    camera: Optics, projector: Optics, T_cam_proj: Float[np.ndarray, "4 4"], path: Path
) -> tuple[float, float]:
    """Return the nearest and farthest depth at which the fields of view overlap."""
    baseline_m = float(np.linalg.norm(T_cam_proj[:3, 3]))
    candidates_m = baseline_m * np.geomspace(0.5, 20, 200)
    lit_m = common_depths_m(camera, projector, T_cam_proj, candidates_m).tolist()
    if len(lit_m) < 2:
        raise ConfigError(
            f"{path}: camera and projector have no common field of view between 0.5 and 20 "
            "baselines: give R and T of X_projector = R X_camera + T, or give near and far"
        )
    return lit_m[0], lit_m[-1]


def _device(
    content: Mapping[str, Any], device: str, path: Path, size_px: tuple[int, int] | None
) -> Optics:
    matrix = _array(content, f"{device} matrix", path, shapes=((3, 3),))
    where = f"{path}: {_find(content, f'{device} matrix', path)}"
    if abs(matrix[0, 1]) > MAX_SKEW * abs(matrix[0, 0]):
        raise ConfigError(f"{where} has the skew {matrix[0, 1]:.4g}: calibrate without skew")
    if matrix[1, 0] != 0 or not np.array_equal(matrix[2], [0, 0, 1]):
        raise ConfigError(
            f"{where} is not a camera matrix: give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    width_px, height_px = size_px or _size(content, device, path)
    return build_optics(
        path,
        device,
        width_px=width_px,
        height_px=height_px,
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
        distortion=_distortion(content, f"{device} distortion", path),
    )


def _distortion(content: Mapping[str, Any], role: str, path: Path) -> tuple[float, ...]:
    """Return (k1, k2, p1, p2, k3); all are 0 if the file states no distortion."""
    key = _find(content, role, path)
    if key is None:
        return (0.0,) * 5
    terms = _numbers(content[key], f"{path}: {key}").ravel()
    if len(terms) not in (0, 4, 5, 8, 12, 14):
        raise ConfigError(f"{path}: {key} has {len(terms)} terms: give (k1, k2, p1, p2[, k3])")
    if terms[5:].any():
        beyond = "rational, thin-prism or tilted terms"
        raise ConfigError(f"{path}: {key} has {beyond}: calibrate with (k1, k2, p1, p2, k3) only")
    return tuple(float(term) for term in np.pad(terms, (0, 5))[:5])


def _size(content: Mapping[str, Any], device: str, path: Path) -> tuple[int, int]:
    """Return the size (width, height) that the file states for a device."""
    key = _find(content, f"{device} size", path)
    if key is None:
        raise ConfigError(
            f"{path}: the {device} image size is missing: add {_listed(f'{device} size')}: "
            "[width, height], or give it as an option"
        )
    where = f"{path}: {key}"
    size = _numbers(content[key], where).ravel()
    if size.shape != (2,) or (size != np.rint(size)).any() or (size < 1).any():
        raise ConfigError(f"{where} is {size.tolist()}: give [width, height] in pixels")
    return int(size[0]), int(size[1])


def _metres_per_unit(T: Float[np.ndarray, "3"], unit: str | None, where: str) -> float:
    length = float(np.linalg.norm(T))
    if length == 0:
        raise ConfigError(f"{where} is zero: camera and projector need a baseline to triangulate")
    if unit is None:
        if 2 <= length <= 10:
            raise ConfigError(f"{where} has length {length:.4g}: state its unit with --unit")
        unit = "mm" if length > 10 else "m"
    if unit not in UNITS_M:
        raise ConfigError(f"{where}: no unit {unit!r}: choose one of {', '.join(UNITS_M)}")
    scale = UNITS_M[unit]
    if length * scale < MIN_BASELINE_M:
        baseline = f"a baseline of {1e3 * length * scale:.3g} mm"
        raise ConfigError(f"{where} in {unit} gives {baseline}: state its unit")
    return scale


def _find(content: Mapping[str, Any], role: str, path: Path) -> str | None:
    """Return the only key in the file that has a given role, or None."""
    keys = [key for key in _KEYS[role] if key in content]
    if len(keys) > 1:
        raise ConfigError(f"{path}: {' and '.join(keys)} both state the {role}: keep one")
    return keys[0] if keys else None


def _listed(role: str) -> str:
    return " or ".join(_KEYS[role])


def _array(
    content: Mapping[str, Any], role: str, path: Path, *, shapes: tuple[tuple[int, ...], ...]
) -> Float[np.ndarray, "..."]:
    key = _find(content, role, path)
    if key is None:
        keys = ", ".join(str(key) for key in list(content)[:8]) or "nothing"
        accepted = ", ".join(map(_listed, _KEYS))
        raise ConfigError(
            f"{path}: no {role} (the file holds {keys}): name its key {_listed(role)}; the keys "
            f"that are read, from camera and projector in one file, are {accepted}"
        )
    array = _numbers(content[key], f"{path}: {key}")
    if array.shape not in shapes:
        wanted = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
        raise ConfigError(f"{path}: {key} has the shape {array.shape}: give {wanted} numbers")
    return array


def _numbers(value: Any, where: str) -> Float[np.ndarray, "..."]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where} is not an array of numbers: give nested lists") from error
    if not np.isfinite(array).all():
        raise ConfigError(f"{where} has numbers that are not finite: calibrate again")
    return array


def _read_calibration(path: Path) -> Mapping[str, Any]:
    if path.suffix.lower() == ".npz":
        return _read_npz(path)
    text = read_text(path)
    if is_file_storage(text):
        return _read_file_storage(path)
    if path.suffix.lower() != ".json":
        return parse_yaml(text, path)
    try:
        content = parse_json(text)
    except ValueError as error:
        raise ConfigError(f"{path}: is not JSON ({error}): correct that line") from error
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: holds no keys: give K, D, R and T as a JSON object")
    return content


def _read_npz(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise ConfigError(f"{path}: no such file: check the path")
    try:
        with np.load(path, allow_pickle=False) as arrays:
            unpacked = sum(entry.file_size for entry in arrays.zip.infolist())
            if unpacked > _MOST_BYTES:
                raise ConfigError(
                    f"{path}: unpacks to {unpacked / 1e6:.0f} MB, and a calibration has less than "
                    f"{_MOST_BYTES / 1e6:.0f} MB: save K, D, R and T alone"
                )
            return {key: arrays[key] for key in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile, AttributeError) as error:
        raise ConfigError(f"{path}: is not an NPZ file of plain arrays: save it again") from error


def _read_file_storage(path: Path) -> Mapping[str, Any]:
    """Return matrices, numbers and lists of numbers at the top of an OpenCV FileStorage."""
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise ConfigError(f"{path}: OpenCV cannot parse it: the file may be incomplete") from error
    root = storage.root()
    content: dict[str, np.ndarray | list[float] | float | None] = {}
    for key in root.keys():
        node = root.getNode(key)
        if node.isMap():
            content[key] = _matrix(node, f"{path}: {key}")
        elif node.isSeq():
            items = [node.at(i) for i in range(node.size())]
            if all(item.isInt() or item.isReal() for item in items):
                content[key] = [item.real() for item in items]
        elif node.isInt() or node.isReal():
            content[key] = node.real()
    storage.release()
    return content


def _matrix(node: cv2.FileNode, where: str) -> np.ndarray | None:
    try:
        return node.mat()
    except cv2.error as error:
        raise ConfigError(f"{where} is not a matrix that OpenCV can read") from error
