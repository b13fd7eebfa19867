"""Readers of depth maps, one by one, from files and from the scene folders of BOP datasets."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import UInt8
from pydantic import BaseModel

from ...base.errors import DatasetError
from ...base.folder import visible_entries
from ...dataset.files.records import Images
from ...dataset.files.safe_reading import Unreadable
from ...dataset.files.scene_folder import SCANNER, AnyScanner, AnyView, SceneFolder
from ..depth_file import (
    NO_OPTIONS,
    FileOptions,
    depth_files,
    in_metres,
    load_json,
    load_npy,
    read_depth,
    read_gray,
    read_image,
)
from .scan import DepthScan

_M_PER_MM = 1e-3

R = TypeVar("R", bound=BaseModel)


def read_scans(
    paths: Sequence[Path],
    *,
    options: FileOptions = NO_OPTIONS,
    gray: Sequence[Path] = (),
    reason: Sequence[Path] = (),
    reason_names: Mapping[int, str] | None = None,
) -> Iterator[DepthScan]:
    """Yield depth maps; each map is read only when it is needed.

    Args:
        paths: depth files, folders of depth files (read in the order of names), and BOP datasets or
            scene folders, which contain their own intrinsics, scale, pictures and reasons.
        options: facts that depth files do not state.
        gray: pictures or folders of pictures, one per depth file in the same order; empty for no
            pictures. Integers are scaled to 0 to 1, and colours are averaged.
        reason: 8-bit images or folders of images, one per depth file in the same order, or empty.
        reason_names: meaning of each number in the reason images.

    Raises:
        DatasetError: a file is missing, damaged or of a wrong form, or an option is missing.
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
    gray, reason = _pictures(gray), _pictures(reason)
    for name, pictures in (("gray", gray), ("reason", reason)):
        if pictures and len(pictures) != len(files):
            counts = f"{len(pictures)} {name} images for {len(files)} depth files"
            raise DatasetError(f"{counts}: give one for each depth file in the same order, or none")
    for file, gray_file, reason_file in zip_longest(files, gray, reason):
        depth = read_depth(file, options)
        yield _scan(
            name=str(file),
            depth_m=depth.depth_m,
            K=depth.K,
            gray=depth.gray if gray_file is None else read_gray(gray_file),
            reason=None if reason_file is None else _read_reason(reason_file),
            reason_names=reason_names or {},
        )


def _pictures(paths: Sequence[Path]) -> list[Path]:
    """Return the paths, with each folder replaced by its files in the order of names."""
    files = []
    for path in paths:
        inside = visible_entries(path) if path.is_dir() else [path]
        if not inside:
            raise DatasetError(f"{path}: is an empty folder: give a folder with pictures")
        files += inside
    return files


def _scenes(path: Path) -> list[Path]:
    """Return the scene folders: the path itself, else those one level below, else two below."""
    for pattern in (".", "*", "*/*"):
        if scenes := sorted({f.parent for f in path.glob(f"{pattern}/scene_camera*.json")}):
            return scenes
    return []


def _read_scene(scene: Path) -> Iterator[DepthScan]:
    """Yield the depth maps of a scene folder, from the scanner if it has any, else the camera."""
    files = SceneFolder(scene)
    suffix = SCANNER if (scene / f"scene_camera{SCANNER}.json").is_file() else ""
    views = _record(files, f"scene_camera{suffix}", AnyView)
    scanner: Mapping[int, AnyScanner] = {}
    if suffix and (scene / f"scene{SCANNER}.json").is_file():
        scanner = _record(files, f"scene{SCANNER}", AnyScanner)
    baseline_m = _baseline_m(scene)
    for number, view in sorted(views.items()):
        path = _find(files, f"depth{suffix}", number) or files.png_path(f"depth{suffix}", number)
        depth_m = in_metres(read_image(path), view.depth_scale * _M_PER_MM, str(path))
        own = _find(files, f"gray{suffix}", number)
        picture = own or _find(files, f"rgb{suffix}", number)
        gray = None if picture is None else read_gray(picture)
        colour = _find(files, "rgb", number)
        if gray is None and colour is not None:
            beside = read_gray(colour)  # A picture of another shape may be from another camera.
            gray = beside if beside.shape == depth_m.shape else None
        why = files.png_path(f"reason{suffix}", number)
        reasons = scanner[number].reasons if number in scanner else {}
        yield _scan(
            name=str(path),
            depth_m=depth_m,
            K=np.reshape(view.cam_K, (3, 3)),
            gray=gray,
            reason=_read_reason(why) if suffix and why.is_file() else None,
            reason_names={code: name for name, code in reasons.items()},
            baseline_m=baseline_m,
        )


def _find(files: SceneFolder, kind: str, number: int) -> Path | None:
    """Return the path of a scene's picture; None if the picture does not exist."""
    try:
        return files.find_picture(kind, number)
    except Unreadable as error:
        raise DatasetError(f"{files.path}/{error}") from error


def _record(files: SceneFolder, name: str, form: type[R]) -> dict[int, R]:
    """Return the entries of a JSON file of a scene by image number."""
    try:
        return files.record(name, Images[form])  # type: ignore[valid-type]
    except Unreadable as error:
        raise DatasetError(
            f"{files.path}/{error}: each image needs cam_K (9 numbers) and depth_scale"
        ) from error


def _baseline_m(scene: Path) -> float | None:
    """Return the baseline [m] of the rig of a Graycast dataset; None for other datasets."""
    claim = scene.parent.parent / "graycast.json"
    if not claim.is_file():
        return None
    T_cam_proj = load_json(claim, "give a file of intrinsics").get("rig", {}).get("T_cam_proj")
    if np.shape(T_cam_proj) != (4, 4):
        return None
    return float(np.linalg.norm(np.array(T_cam_proj)[:3, 3]))


def _scan(**fields: Any) -> DepthScan:
    try:
        return DepthScan(**fields)
    except ValueError as error:
        raise DatasetError(str(error)) from error


def _read_reason(path: Path) -> UInt8[np.ndarray, "h w"]:
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise DatasetError(
            f"{path}: is {image.dtype} {image.shape}: give maps of reasons with one channel of 8 "
            "bits"
        )
    return image
