"""Readers of real pictures and depth maps that are paired by their file names."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, UnidentifiedImageError

from ..base.errors import DatasetError
from ..base.file_limits import refuse_large_picture
from ..base.folder import visible_entries
from ..dataset.files.safe_reading import Unreadable, read_png
from ..dataset.files.scene_folder import PICTURES
from ..dataset.write.picture_bytes import DEPTH_MAX, depth_scale_mm
from .depth_file import (
    DEPTH_FILES,
    NO_CAMERA,
    FileOptions,
    load_npy,
    read_depth,
    read_gray,
    read_image,
)

FOLDERS = {"rgb": PICTURES, "gray": (*PICTURES, ".npy"), "depth": DEPTH_FILES}
_NEAREST_M = 0.01  # No scanner measures a smaller distance.


@dataclass(frozen=True, slots=True, kw_only=True)
class RealPicture:
    """Files of one view that share a name; None for a file that does not exist."""

    stem: str
    rgb: Path | None
    gray: Path | None
    depth: Path | None

    @property
    def files(self) -> dict[str, Path]:
        named = {"rgb": self.rgb, "gray": self.gray, "depth": self.depth}
        return {name: path for name, path in named.items() if path is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotData:
    """Pictures and depth of one view; `rgb` may come from the colours of an organised cloud.

    `DepthFile` explains `largest_px` and `beyond_px`.
    """

    rgb: UInt8[np.ndarray, "h w 3"] | None
    gray: UInt8[np.ndarray, "h w"] | None
    depth_m: Float[np.ndarray, "h w"] | None
    K: Float[np.ndarray, "3 3"]
    largest_px: int = 0
    beyond_px: int = 0

    @property
    def size_px(self) -> tuple[int, int]:
        pictures = (self.rgb, self.gray, self.depth_m)
        height_px, width_px = next(image for image in pictures if image is not None).shape[:2]
        return height_px, width_px

    @property
    def holds(self) -> tuple[str, ...]:
        named = {"rgb": self.rgb, "gray_sl": self.gray, "depth_sl": self.depth_m}
        return tuple(name for name, image in named.items() if image is not None)


def find_shots(folder: Path) -> list[RealPicture]:
    """Pair the files in a folder's subfolders `rgb`, `gray` and `depth` by name.

    Raises:
        DatasetError: there are no pictures, two files in one subfolder share a name, or a name is
            missing in one of the subfolders that have pictures.
    """
    files_of: dict[str, dict[str, Path]] = {}
    for name, endings in FOLDERS.items():
        inside = visible_entries(folder / name) if (folder / name).is_dir() else []
        files = [path for path in inside if path.suffix.lower() in endings]
        by_stem = {path.stem: path for path in files}
        if len(by_stem) < len(files):
            twice = next(p for p in files if by_stem[p.stem] != p)
            raise DatasetError(f"{twice}: another file has the same name: keep one of them")
        if inside and not files:
            raise DatasetError(f"{folder / name}: has none of {', '.join(endings)}")
        if files:
            files_of[name] = by_stem
    if not files_of:
        raise DatasetError(
            f"{folder}: has no pictures: put them into the folders rgb, gray and depth in it, "
            "the files of one picture under one name"
        )
    stems = sorted({stem for by_stem in files_of.values() for stem in by_stem})
    for name, by_stem in files_of.items():
        if missing := [stem for stem in stems if stem not in by_stem]:
            other = next(n for n in files_of if missing[0] in files_of[n])
            raise DatasetError(
                f"{folder}: {other} has a picture {missing[0]}, and {name} has none: add it, or "
                "remove the other"
            )
    return [
        RealPicture(stem=stem, **{name: files_of.get(name, {}).get(stem) for name in FOLDERS})
        for stem in stems
    ]


def read_shot(shot: RealPicture, options: FileOptions) -> ShotData:
    """Read and check all files of one view.

    Raises:
        DatasetError: a file is damaged or has a wrong size or form, or an option is missing.
    """
    for path in shot.files.values():
        refuse_damaged(path)
    rgb = None if shot.rgb is None else read_rgb(shot.rgb)
    gray = None if shot.gray is None else np.rint(read_gray(shot.gray) * 255).astype(np.uint8)
    depth_m, K, largest_px, beyond_px = None, options.K, 0, 0
    if shot.depth is not None:
        depth = read_depth(shot.depth, options)
        depth_m, K = depth.depth_m, depth.K
        largest_px, beyond_px = depth.largest_px, depth.beyond_px
        if beyond_px and np.isnan(depth_m).all():
            raise DatasetError(
                f"{shot.depth}: has no depth up to --max-depth {options.max_depth_m:g}: give a "
                "larger one"
            )
        _refuse_impossible(depth_m, shot.depth)
        rgb = depth.rgb if rgb is None else rgb
    if K is None:
        raise DatasetError(f"{shot.stem}: {NO_CAMERA}")
    _refuse_sizes(shot, {"rgb": rgb, "gray": gray, "depth": depth_m})
    return ShotData(
        rgb=rgb, gray=gray, depth_m=depth_m, K=K, largest_px=largest_px, beyond_px=beyond_px
    )


def depth_step_mm(deepest_m: float, scale_m: float | None) -> float:
    """Return the depth step [mm] with which 16-bit pictures store depth.

    Depth from integers keeps its own scale, so that nothing is rounded. Depth from floats gets the
    finest step with which 16 bits reach the largest depth, like simulated depth.

    Args:
        deepest_m: the largest depth to store.
        scale_m: metres per unit if all files have integers; None if some have floats.

    Raises:
        DatasetError: 16 bits cannot store the largest depth.
    """
    if scale_m is not None and deepest_m / scale_m <= DEPTH_MAX + 0.5:
        return float(f"{scale_m * 1e3:.12g}")
    try:
        return depth_scale_mm(deepest_m or _NEAREST_M)  # If there is no depth, any step will do.
    except ValueError as error:
        raise DatasetError(
            f"the deepest point lies at {deepest_m:.4g} m, and 16-bit depth ends at 65.534 m: "
            "correct the scale, remove such points, or leave them out with --max-depth"
        ) from error


def is_whole(path: Path) -> bool:
    """Return whether a depth file has integers, which need a scale."""
    if path.suffix.lower() == ".ply":
        return False
    value = load_npy(path) if path.suffix.lower() == ".npy" else read_image(path)
    return value.dtype.kind in "ui"


def read_rgb(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read a colour picture in 8-bit sRGB, without its alpha channel.

    Raises:
        DatasetError: the file is missing or damaged, or does not have colour channels of 8 bits.
    """
    image = read_image(path)
    if image.ndim != 3 or image.shape[2] not in (3, 4) or image.dtype != np.uint8:
        raise DatasetError(
            f"{path}: is {image.dtype} {image.shape}: colour pictures have 3 channels of 8 bits: "
            "convert it, or put pictures of one channel into the folder gray of import-real"
        )
    return np.ascontiguousarray(image[..., 2::-1])


def _refuse_impossible(depth_m: Float[np.ndarray, "h w"], path: Path) -> None:
    known = depth_m[~np.isnan(depth_m)]
    if not known.size:
        raise DatasetError(f"{path}: has no depth: remove the picture")
    if known.min() <= 0:
        raise DatasetError(
            f"{path}: has a depth of {known.min():.4g} m: give depth along the camera's z axis, "
            "which points into the scene"
        )
    if np.median(known) < _NEAREST_M:
        raise DatasetError(
            f"{path}: the median depth is {np.median(known):.4g} m, {_NEAREST_M} m is the least "
            "allowed: correct the scale; floating-point numbers in metres need none"
        )


def _refuse_sizes(shot: RealPicture, images: Mapping[str, np.ndarray | None]) -> None:
    sizes = {name: image.shape[:2] for name, image in images.items() if image is not None}
    (first, size), *others = sizes.items()
    for name, other in others:
        if other != size:
            raise DatasetError(
                f"{shot.files[name]}: is {other[1]} x {other[0]} pixels, the {first} picture "
                f"{size[1]} x {size[0]}: give depth and pictures of one camera"
            )


def refuse_damaged(path: Path) -> None:
    """Refuse an incomplete picture, which OpenCV's decoders would accept.

    Raises:
        DatasetError: the file is cut off or damaged.
    """
    if path.suffix.lower() not in PICTURES:
        return
    refuse_large_picture(path, str(path), DatasetError)
    try:
        if path.suffix.lower() == ".png":
            read_png(path)
            return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow raises an exception for relevant faults.
            with Image.open(path) as image:
                image.load()
    except UnidentifiedImageError:
        return  # Pillow does not know some TIFFs; OpenCV reports faults in them.
    except (Unreadable, OSError, ValueError, SyntaxError) as error:
        raise DatasetError(f"{path}: is cut off or damaged ({error}): copy it again") from error
