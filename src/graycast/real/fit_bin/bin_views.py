"""Real views of a bin, empty or with parts: depth maps or organised clouds, and colour pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...base.errors import DatasetError
from ...dataset.files.records import Images
from ...dataset.files.safe_reading import Unreadable
from ...dataset.files.scene_folder import AnyView, SceneFolder
from ...rig.optics import Optics, optics_of, picture_rays, points
from ..depth_file import DEPTH_FILES, FileOptions
from ..picture_pairs import RealPicture, ShotData, find_shots, read_shot

SHARED_M = 2e-3  # Two depths that differ by less belong to one surface.
_NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
_LEAST_POINTS = 1000
_NORMALS_ACROSS = 400  # Normals use neighbours 1/400 of the picture's width away on either side.


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Every n-th pixel of a view: a camera with only these pixels, and z-depth [m] or NaN."""

    camera: Optics
    depth_m: Float[np.ndarray, "rows columns"]

    @cached_property
    def ray(self) -> Float[np.ndarray, "rows columns 3"]:
        """Rays in the camera frame, with z = 1."""
        return picture_rays(self.camera)

    @cached_property
    def point_m(self) -> Float[np.ndarray, "rows columns 3"]:
        """Measured points in the camera frame; NaN where depth is missing."""
        return self.ray * self.depth_m[..., None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BinView:
    """One view of the bin; z-depth [m] is NaN where it is missing."""

    name: str
    camera: Optics
    depth_m: Float[np.ndarray, "h w"]
    rgb: UInt8[np.ndarray, "h w 3"] | None = None

    def __post_init__(self) -> None:
        known = int(np.isfinite(self.depth_m).sum())
        if known < _LEAST_POINTS:
            raise DatasetError(
                f"{self.name}: has depth in {known} pixels, {_LEAST_POINTS} are needed: check the "
                "view of the bin and the exposure"
            )

    def grid(self, across: int) -> Grid:
        """Return every n-th pixel, so that the longer side has about `across` pixels."""
        step, camera = self.step(across), self.camera
        depth_m = self.depth_m[::step, ::step]
        rows, columns = depth_m.shape
        coarse = replace(
            camera,
            width_px=columns,
            height_px=rows,
            fx_px=camera.fx_px / step,
            fy_px=camera.fy_px / step,
            cx_px=camera.cx_px / step,
            cy_px=camera.cy_px / step,
        )
        return Grid(camera=coarse, depth_m=depth_m)

    def cloud(self, count: int = 20_000) -> Float[np.ndarray, "n 6"]:
        """Return positions [m] and unit normals of about `count` points in the camera frame.

        The points are on a regular grid of pixels, and normals point to the camera. Pixels next to
        a gap have no normal and are left out.
        """
        height_px, width_px = self.depth_m.shape
        known = np.isfinite(self.depth_m).mean()
        step = max(1, round(float(np.sqrt(known * height_px * width_px / count))))
        reach = max(1, round(width_px / _NORMALS_ACROSS))
        point = points(self.camera, self.depth_m)
        normal = np.full_like(point, np.nan)
        across = point[reach:-reach, 2 * reach :] - point[reach:-reach, : -2 * reach]
        down = point[2 * reach :, reach:-reach] - point[: -2 * reach, reach:-reach]
        inner = np.cross(down, across)
        normal[reach:-reach, reach:-reach] = inner / np.linalg.norm(inner, axis=-1, keepdims=True)
        both = np.concatenate([point, normal], axis=-1)[::step, ::step]
        return both[np.isfinite(both).all(axis=-1)]

    def step(self, across: int) -> int:
        """Return the step between pixels that leaves about `across` pixels on the longer side."""
        return max(1, round(max(self.depth_m.shape) / max(across, 1)))


def read_views(
    paths: Sequence[Path], *, rgb: Sequence[Path] = (), options: FileOptions, own: Optics
) -> tuple[BinView, ...]:
    """Read all views, which must come from one camera that did not move.

    Args:
        paths: depth files, folders in the layout of `import_real`, and scene folders of Graycast's
            datasets, which contain their own camera and colours.
        rgb: a picture for each depth file, in the same order, or no pictures.
        own: the configuration's camera, for depth of the same size that has no intrinsics.

    Raises:
        GraycastError: a file is missing, damaged or of a wrong form, or the cameras differ.
    """
    files = [path for path in paths if not path.is_dir()]
    if rgb and len(rgb) != len(files):
        raise DatasetError(
            f"{len(rgb)} colour pictures for {len(files)} depth files: give one for each depth "
            "file in the same order, or none"
        )
    colours = dict(zip(files, rgb, strict=True)) if rgb else {}
    views: list[BinView] = []
    for path in paths:
        if (path / "scene_camera_sl.json").is_file():
            views += _read_scene(path)
        elif path.is_dir():
            views += [_read(shot, options, own) for shot in find_shots(path)]
        else:
            views.append(_read(_shot(path, colours.get(path)), options, own))
    if not views:
        raise DatasetError("no view is given: name a depth file or a folder")
    for view in views[1:]:
        if view.camera != views[0].camera:
            raise DatasetError(
                f"{view.name}: is of another camera than {views[0].name}: fit the cameras "
                "separately"
            )
    return tuple(views)


def _shot(path: Path, rgb: Path | None) -> RealPicture:
    if path.suffix.lower() not in DEPTH_FILES:
        raise DatasetError(f"{path}: give depth as one of {', '.join(DEPTH_FILES)}")
    return RealPicture(stem=str(path), rgb=rgb, gray=None, depth=path)


def _read(shot: RealPicture, options: FileOptions, own: Optics) -> BinView:
    if shot.depth is None:
        raise DatasetError(f"{shot.stem}: has no depth: put it into the folder depth")
    brings_own = shot.depth.suffix.lower() == ".ply"
    by_rig = options.K is None and not brings_own
    images = read_shot(shot, replace(options, K=own.K) if by_rig else options)
    if by_rig and images.size_px != (own.height_px, own.width_px):
        raise DatasetError(
            f"{shot.depth}: is {images.size_px[1]} x {images.size_px[0]} pixels, the rig's camera "
            f"{own.width_px} x {own.height_px}: give its intrinsics (--intrinsics fx,fy,cx,cy)"
        )
    lens = options.distortion or (own.distortion if by_rig else _NO_DISTORTION)
    return _view(str(shot.depth), images, lens)


def _read_scene(scene: Path) -> list[BinView]:
    """Read the scanner's views in a scene of one of Graycast's datasets.

    Raises:
        DatasetError: `scene_camera_sl.json` or a picture is damaged or incomplete.
    """
    files, views = SceneFolder(scene), []
    try:
        cameras = files.record("scene_camera_sl", Images[AnyView])
    except Unreadable as error:
        raise DatasetError(
            f"{scene}/{error}: the key of an image must be its number, and it needs cam_K (9 "
            "numbers), depth_scale and, where the lens has distortion, 5 terms of it"
        ) from error
    for number, camera in cameras.items():
        depth = files.png_path("depth_sl", number)
        try:
            rgb = files.find_picture("rgb", number)
        except Unreadable as error:
            raise DatasetError(f"{scene}/{error}") from error
        images = read_shot(
            RealPicture(stem=str(scene), rgb=rgb, gray=None, depth=depth),
            FileOptions(K=np.reshape(camera.cam_K, (3, 3)), scale_m=camera.depth_scale * 1e-3),
        )
        views.append(_view(str(depth), images, camera.distortion))
    return views


def _view(name: str, images: ShotData, distortion: Sequence[float]) -> BinView:
    try:
        camera = optics_of(images.K, images.size_px, distortion)
    except ValueError as error:
        raise DatasetError(f"{name}: its camera cannot be used: {error}") from error
    if images.depth_m is None:
        raise DatasetError(f"{name}: has no depth")
    return BinView(name=name, camera=camera, depth_m=images.depth_m, rgb=images.rgb)


# --- the empty bin from views with parts ---------------------------------------------------------


def empty_view(views: Sequence[BinView]) -> BinView:
    """Combine views of a bin with different parts into one view of the empty bin.

    Parts are in front of the bin, so each pixel takes the farthest depth on which two views agree;
    a farther depth in a single view is an error. If all views have pictures, a pixel's colour is
    the mean of the views that see the bin there.

    Leaves out: parts at the same place in two views are mistaken for the bin if the bin is hidden
    there in all other views.

    Raises:
        DatasetError: there are fewer than two views, or they agree at too few pixels.
    """
    if len(views) < 2:
        raise DatasetError(
            f"{len(views)} view is given: give at least two views, because the empty bin is "
            "composed of depth on which two views agree"
        )
    depth_m = np.stack([view.depth_m for view in views])
    shared_m = farthest_shared(depth_m)
    sees = np.abs(depth_m - shared_m) < SHARED_M
    pictures = [view.rgb for view in views if view.rgb is not None]
    return BinView(
        name=f"what {len(views)} views share",
        camera=views[0].camera,
        depth_m=shared_m,
        rgb=_mean_color(pictures, sees) if len(pictures) == len(views) else None,
    )


def farthest_shared(depth_m: Float[np.ndarray, "n h w"]) -> Float[np.ndarray, "h w"]:
    """Return the mean of the farthest two depths that agree; NaN where no two depths agree.

    Only neighbours in the order of depth are compared.
    """
    ordered = np.sort(np.where(np.isnan(depth_m), -np.inf, depth_m), axis=0)[::-1]
    shared = np.full(depth_m.shape[1:], np.nan)
    for farther, nearer in pairwise(ordered):
        with np.errstate(invalid="ignore"):  # Without depth in both, this is infinity - infinity.
            agree = np.isnan(shared) & (farther - nearer < SHARED_M)
        shared[agree] = (0.5 * (farther + nearer))[agree]
    return shared


def _mean_color(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]], sees: Bool[np.ndarray, "n h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Return the mean colour of the views that see the bin; if no view does, of all views."""
    weight = np.where(sees.any(axis=0), sees, True)[..., None].astype(np.float64)
    mean = (np.stack(pictures) * weight).sum(axis=0) / weight.sum(axis=0)
    return np.round(mean).astype(np.uint8)
