"""Depth maps from files: NPY, 16-bit PNG, organised PLY, and the scene folders of BOP datasets."""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ..errors import DatasetError
from .ply import camera_of, read_ply
from .scan import Scan

DEPTH_FILES = (".npy", ".png", ".ply", ".tif", ".tiff")
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
_FARTHEST_M = 100.0
_SCANNER = "_sl"  # of the camera type that our own datasets add
_M_PER_MM = 1e-3


def read_scans(
    paths: Sequence[Path],
    *,
    K: Float[np.ndarray, "3 3"] | None = None,
    gray: Sequence[Path] = (),
    reason: Sequence[Path] = (),
    reason_names: Mapping[int, str] | None = None,
    scale_m: float | None = None,
    size_px: tuple[int, int] | None = None,
) -> Iterator[Scan]:
    """Depth maps one after another, each read when it is asked for.

    Args:
        paths: depth files, folders of them (taken in the order of their names), and BOP datasets or
            scene folders, which bring their own intrinsics, scale, pictures and reasons.
        K: intrinsics of all depth files [px]; an organised PLY has its own where this is None.
        gray: a picture per depth file in the same order, or none. 8- and 16-bit ones are taken as
            shares of their type's range, colours are averaged.
        reason: an 8-bit image per depth file in the same order, or none.
        reason_names: what its numbers mean.
        scale_m: metres per unit of the depth files; integers need one, floats are metres.
        size_px: width and height of PLYs that do not say it.

    Raises:
        DatasetError: a file is missing, damaged or of another form, or something is not given.
    """
    files: list[Path] = []
    for path in paths:
        if scenes := _scenes(path):
            for scene in scenes:
                yield from _read_scene(scene)
        elif path.is_dir():
            files += depth_files(path)
        else:
            files.append(path)
    for name, pictures in (("gray", gray), ("reason", reason)):
        if pictures and len(pictures) != len(files):
            counts = f"{len(pictures)} {name} images for {len(files)} depth files"
            raise DatasetError(f"{counts}: give one each, in the same order, or none")
    for file, gray_file, reason_file in zip_longest(files, gray, reason):
        depth_m, own_gray, own_K = read_depth(file, scale_m, size_px, K)
        yield _scan(
            name=str(file),
            depth_m=depth_m,
            K=own_K,
            gray=own_gray if gray_file is None else read_gray(gray_file),
            reason=None if reason_file is None else _read_reason(reason_file),
            reason_names=reason_names or {},
        )


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
            K = np.load(path).astype(np.float64)
        elif path.suffix == ".json":
            K = _json_K(json.loads(path.read_text(encoding="utf-8")))
        elif path.is_file():
            K = np.loadtxt(path, ndmin=2)
        else:
            fx, fy, cx, cy = (float(word) for word in text.split(","))
            K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
        raise DatasetError(f"intrinsics {text}: cannot be read: {wanted}") from error
    if K.shape != (3, 3):
        shape = " x ".join(str(length) for length in K.shape)
        raise DatasetError(f"intrinsics {text}: holds {shape} numbers: {wanted}")
    if not (np.isfinite(K).all() and np.allclose(K[2], [0, 0, 1]) and min(K[0, 0], K[1, 1]) > 0):
        raise DatasetError(f"intrinsics {text}: {K.tolist()} is no camera matrix: {wanted}")
    return K


def read_gray(path: Path) -> Float[np.ndarray, "h w"]:
    """A picture as shares of its type's range; floats in NPY are such shares already."""
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim == 3:
        image = image[..., :3].mean(axis=-1, dtype=np.float64).astype(image.dtype)
    if np.issubdtype(image.dtype, np.integer):
        return image / np.float64(np.iinfo(image.dtype).max)
    return image.astype(np.float64)


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
            f"{path}: its camera is not known: give the intrinsics (--intrinsics fx,fy,cx,cy)"
        )
    if value.ndim != 2:
        raise DatasetError(f"{path}: has the shape {value.shape}: a depth map has rows and columns")
    if value.dtype.kind not in "uif":
        raise DatasetError(f"{path}: has {value.dtype} numbers: depth is integers or floats")
    if value.dtype.kind in "ui" and scale_m is None:
        raise DatasetError(
            f"{path}: has {value.dtype} numbers: give the scale, metres per unit (--scale 0.001)"
        )
    return metres(value, 1.0 if scale_m is None else scale_m, str(path)), gray, K


def metres(value: np.ndarray, scale_m: float, name: str) -> Float[np.ndarray, "h w"]:
    """Depth [m] in which 0 and what is not finite is NaN."""
    if not 0 < scale_m < np.inf:
        raise DatasetError(f"{name}: scale is {scale_m}; metres per unit, above 0")
    known = np.isfinite(value) & (value != 0)
    depth_m = np.where(known, value.astype(np.float64) * scale_m, np.nan)
    if known.any() and np.nanmedian(depth_m) > _FARTHEST_M:
        raise DatasetError(
            f"{name}: the median depth is {np.nanmedian(depth_m):.4g} m, up to {_FARTHEST_M:.0f} "
            "are allowed: are they millimetres? give a scale of 0.001"
        )
    return depth_m


# --- BOP -----------------------------------------------------------------------------------------


def _scenes(path: Path) -> list[Path]:
    """Scene folders at, in, or two levels below a folder."""
    for pattern in (".", "*", "*/*"):
        if found := sorted({f.parent for f in path.glob(f"{pattern}/scene_camera*.json")}):
            return found
    return []


def _read_scene(scene: Path) -> Iterator[Scan]:
    """All images of a scene folder, the scanner's where there is one beside the colour camera."""
    suffix = _SCANNER if (scene / f"scene_camera{_SCANNER}.json").is_file() else ""
    views = load_json(scene / f"scene_camera{suffix}.json")
    own = scene / f"scene{_SCANNER}.json"
    scanner = load_json(own) if suffix and own.is_file() else {}
    baseline_m = _baseline_m(scene)
    for image_id in sorted(views, key=int):
        view, stem = views[image_id], f"{int(image_id):06d}"
        path = scene / f"depth{suffix}" / f"{stem}.png"
        try:
            scale_m = float(view["depth_scale"]) * _M_PER_MM
            K = np.array(view["cam_K"], dtype=np.float64).reshape(3, 3)
        except (KeyError, TypeError, ValueError) as error:
            where = f"{scene / f'scene_camera{suffix}.json'}: image {image_id}"
            raise DatasetError(f"{where} needs cam_K (9) and depth_scale") from error
        picture = _picture(scene, (f"gray{suffix}", f"rgb{suffix}"), stem)
        why = scene / f"reason{suffix}" / f"{stem}.png"
        names = scanner.get(image_id, {}).get("reasons", {})
        yield _scan(
            name=str(path),
            depth_m=metres(read_image(path), scale_m, str(path)),
            K=K,
            gray=None if picture is None else read_gray(picture),
            reason=_read_reason(why) if suffix and why.is_file() else None,
            reason_names={number: name for name, number in names.items()},
            baseline_m=baseline_m,
        )


def _picture(scene: Path, folders: Sequence[str], stem: str) -> Path | None:
    files = (scene / folder / f"{stem}{end}" for folder in folders for end in PICTURES)
    return next((file for file in files if file.is_file()), None)


def _baseline_m(scene: Path) -> float | None:
    """Of the rig that made a dataset of ours."""
    claim = scene.parent.parent / "graycast.json"
    if not claim.is_file():
        return None
    T_cam_proj = load_json(claim).get("rig", {}).get("T_cam_proj")
    if np.shape(T_cam_proj) != (4, 4):
        return None
    return float(np.linalg.norm(np.array(T_cam_proj)[:3, 3]))


# --- files ---------------------------------------------------------------------------------------


def _scan(**fields: Any) -> Scan:
    try:
        return Scan(**fields)
    except ValueError as error:
        raise DatasetError(str(error)) from error


def depth_files(folder: Path) -> list[Path]:
    """`depth.npy` alone where `graycast decode` wrote it, else all that may be depth."""
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
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DatasetError(f"{path}: is not an image, or is damaged: use PNG, TIFF, NPY or PLY")
    return image


def _read_reason(path: Path) -> UInt8[np.ndarray, "h w"]:
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise DatasetError(
            f"{path}: is {image.dtype} {image.shape}: reasons are 8 bit, one channel"
        )
    return image


def load_npy(path: Path) -> np.ndarray:
    if not path.is_file():
        raise DatasetError(f"{path}: no such file: check the path")
    try:
        return np.load(path)
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read as NPY ({error}): check the file") from error


def load_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as JSON ({error}): check the file") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: holds no keys: is it of another kind?")
    return content


def _json_K(content: dict[str, Any] | list[Any]) -> Float[np.ndarray, "rows columns"]:
    """BOP's `camera.json`, an entry of `scene_camera.json`, or the first of all; or a list."""
    if isinstance(content, list):
        return np.array(content, dtype=np.float64, ndmin=2)
    if "fx" in content:
        fx, fy, cx, cy = (float(content[key]) for key in ("fx", "fy", "cx", "cy"))
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if "cam_K" not in content:
        content = next(iter(content.values()))
    return np.array(content["cam_K"], dtype=np.float64).reshape(3, 3)
