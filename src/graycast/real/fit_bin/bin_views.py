"""Real views of the empty bin: depth or organised clouds, and the colour pictures beside them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ...base.errors import DatasetError
from ...dataset.records import Images
from ...dataset.safe_reading import Unreadable
from ...dataset.scene_folder import AnyView, SceneFolder
from ...rig.optics import Optics, optics_of, picture_rays, points
from ..depth_file import DEPTH_FILES
from ..picture_pairs import RealPicture, ShotData, find_shots, read_shot

_NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
_LEAST_POINTS = 1000
_NORMALS_ACROSS = 400  # Normals come from pixels a two-hundredth of the picture apart, or 2.


@dataclass(frozen=True, slots=True, kw_only=True)
class FileOptions:
    """Options for the files: `K` [px], distortion, metres per unit of depth, size of clouds."""

    K: Float[np.ndarray, "3 3"] | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    scale_m: float | None = None
    size_px: tuple[int, int] | None = None


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Every n-th pixel of a view: the camera that has no others, and z-depth [m], NaN for none."""

    camera: Optics
    depth_m: Float[np.ndarray, "rows columns"]

    @cached_property
    def ray(self) -> Float[np.ndarray, "rows columns 3"]:
        """Camera frame, unit z."""
        return picture_rays(self.camera)

    @cached_property
    def point_m(self) -> Float[np.ndarray, "rows columns 3"]:
        """What is measured, in the camera frame; NaN where nothing is."""
        return self.ray * self.depth_m[..., None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BinView:
    """One view of the bin; z-depth [m] is NaN where there is none."""

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
        """Every n-th pixel, about `across` along the longer side."""
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
        """About so many measured points, evenly over the picture: place [m] and unit normal.

        Camera frame, normals towards the camera. Pixels beside a gap have no normal and are left
        out.
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
        """The n with which every n-th pixel makes about `across` along the longer side."""
        return max(1, round(max(self.depth_m.shape) / max(across, 1)))


def read_views(
    paths: Sequence[Path], *, rgb: Sequence[Path] = (), options: FileOptions, own: Optics
) -> tuple[BinView, ...]:
    """All views, of one camera that stood still.

    Args:
        paths: depth files, folders in the form of `import_real`, and scene folders of our datasets,
            which bring their own camera and colours.
        rgb: a picture for each depth file in the same order, or none.
        own: the configuration's camera: of files of its size where nothing else is said.

    Raises:
        GraycastError: a file is missing, damaged or of another form, or cameras differ.
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
    K = own.K if by_rig else options.K
    images = read_shot(shot, K=K, scale_m=options.scale_m, size_px=options.size_px)
    if by_rig and images.size_px != (own.height_px, own.width_px):
        raise DatasetError(
            f"{shot.depth}: is {images.size_px[1]} x {images.size_px[0]} pixels, the rig's camera "
            f"{own.width_px} x {own.height_px}: give its intrinsics (--intrinsics fx,fy,cx,cy)"
        )
    lens = options.distortion or (own.distortion if by_rig else _NO_DISTORTION)
    return _view(str(shot.depth), images, lens)


def _read_scene(scene: Path) -> list[BinView]:
    """The scanner's views of a scene of one of our datasets.

    Raises:
        DatasetError: `scene_camera_sl.json` is damaged, or says too little of a camera.
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
        images = read_shot(
            RealPicture(
                stem=str(scene), rgb=files.find_picture("rgb", number), gray=None, depth=depth
            ),
            K=np.reshape(camera.cam_K, (3, 3)),
            scale_m=camera.depth_scale * 1e-3,
            size_px=None,
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
