"""Depth maps one after another, from files and from the scene folders of BOP datasets."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ...errors import DatasetError
from ..depth_file import (
    PICTURES,
    depth_files,
    load_json,
    load_npy,
    metres,
    read_depth,
    read_gray,
    read_image,
)
from .scan import Scan

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


def read_perfect(path: Path) -> Iterator[Scan]:
    """Depth without a sensor, of the scenes of a dataset that has it beside the scanner's.

    Pictures of another camera than the scanner's are left out, and a dataset of real scans has
    none at all.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    for scene in _scenes(path):
        files = [scene / f"scene_camera{suffix}.json" for suffix in ("", _SCANNER)]
        if not all(file.is_file() for file in files):
            continue
        perfect, scanner = (load_json(file) for file in files)
        for image_id in sorted(scanner, key=int):
            file = scene / "depth" / f"{int(image_id):06d}.png"
            same = perfect.get(image_id, {}).get("cam_K") == scanner[image_id].get("cam_K")
            if same and file.is_file():
                scale_m, K = _scale_and_K(files[0], perfect, image_id)
                depth_m = metres(read_image(file), scale_m, str(file))
                yield _scan(name=str(file), depth_m=depth_m, K=K)


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
        stem = f"{int(image_id):06d}"
        path = scene / f"depth{suffix}" / f"{stem}.png"
        scale_m, K = _scale_and_K(scene / f"scene_camera{suffix}.json", views, image_id)
        depth_m = metres(read_image(path), scale_m, str(path))
        picture = _picture(scene, (f"gray{suffix}", f"rgb{suffix}"), stem)
        gray = None if picture is None else read_gray(picture)
        if gray is None and (colour := _picture(scene, ("rgb",), stem)) is not None:
            seen = read_gray(colour)  # of a colour camera beside the scanner it says nothing here
            gray = seen if seen.shape == depth_m.shape else None
        why = scene / f"reason{suffix}" / f"{stem}.png"
        names = scanner.get(image_id, {}).get("reasons", {})
        yield _scan(
            name=str(path),
            depth_m=depth_m,
            K=K,
            gray=gray,
            reason=_read_reason(why) if suffix and why.is_file() else None,
            reason_names={number: name for name, number in names.items()},
            baseline_m=baseline_m,
        )


def _scale_and_K(
    file: Path, views: Mapping[str, Any], image_id: str
) -> tuple[float, Float[np.ndarray, "3 3"]]:
    """Metres per unit of depth, and K, of an image."""
    try:
        view = views[image_id]
        K = np.array(view["cam_K"], dtype=np.float64).reshape(3, 3)
        return float(view["depth_scale"]) * _M_PER_MM, K
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{file}: image {image_id} needs cam_K (9) and depth_scale") from error


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


def _scan(**fields: Any) -> Scan:
    try:
        return Scan(**fields)
    except ValueError as error:
        raise DatasetError(str(error)) from error


def _read_reason(path: Path) -> UInt8[np.ndarray, "h w"]:
    image = load_npy(path) if path.suffix == ".npy" else read_image(path)
    if image.ndim != 2 or image.dtype != np.uint8:
        raise DatasetError(
            f"{path}: is {image.dtype} {image.shape}: reasons are 8 bit, one channel"
        )
    return image
