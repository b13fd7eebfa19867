"""The views of a stored scene as merging wants them."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from ...base.errors import DatasetError
from ...base.frames import inverse
from ...camera.decode import triangulation_axis
from ...dataset.claim import rig_of
from ...dataset.example import pose_m
from ...dataset.models import StoredModel
from ...dataset.raw import read_code_maps
from ...dataset.records import MM_PER_M
from ...dataset.safe_reading import Unreadable
from ...dataset.scene_content import scene_content
from ...dataset.stored import StoredDataset, StoredScene
from ...rig.optics import optics_of
from .adding import SurfacePoints, ViewTruth, surface_of
from .view import MeasuredView
from .view_noise import depth_slope_m, measured_noise_px

SURFACE_POINTS = 20000  # All parts of a scene share them.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredView:
    """A view with what it should have measured, and where its noise is known from."""

    view: MeasuredView
    truth: ViewTruth
    noise: str  # `code maps` or `neighbours`
    reason_name: dict[int, str]


def read_view(stored: StoredDataset, shot: StoredScene) -> StoredView:
    """One picture of a scene.

    Raises:
        DatasetError: the dataset is of real pictures, or a file is missing or damaged.
    """
    if stored.real:
        raise DatasetError(
            f"{stored.folder}: holds real pictures, of which nobody knows where the camera stood: "
            "give a dataset of graycast generate"
        )
    content = scene_content(shot)
    assert content.rgb is not None  # what is simulated has a colour picture
    step_m = content.depth_scale_mm / MM_PER_M
    depth_m = _metres(content.scanner, step_m)
    sigma_m, noise = _sigma_m(stored, shot, depth_m, step_m)
    return StoredView(
        view=MeasuredView(
            name=shot.image_name,
            camera=optics_of(content.view["cam_K"], shot.size_px, content.view["distortion"]),
            T_world_cam=_T_world_cam(content.view),
            depth_m=depth_m,
            sigma_m=sigma_m,
            reason=np.where(np.isfinite(depth_m), 0, content.reason).astype(np.uint8),
            color=content.rgb,
        ),
        truth=ViewTruth(depth_m=_metres(content.depth, step_m), instance=content.label),
        noise=noise,
        reason_name=content.reason_name,
    )


def read_surface(models: dict[int, StoredModel], shot: StoredScene) -> SurfacePoints:
    """The surface of a scene's parts where they lie, from any of its pictures.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    T_world_cam = _T_world_cam(shot.view().model_dump())
    poses = shot.poses()
    placed = [T_world_cam @ pose_m(pose.cam_R_m2c, pose.cam_t_m2c) for pose in poses]
    meshes = [models[pose.obj_id].mesh for pose in poses]
    return surface_of(meshes, placed, points=SURFACE_POINTS)


def _metres(steps: Any, step_m: float) -> Float[np.ndarray, "h w"]:
    return np.where(steps > 0, steps * step_m, np.nan)


def _T_world_cam(view: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    return inverse(pose_m(view["cam_R_w2c"], view["cam_t_w2c"]))


def _sigma_m(
    stored: StoredDataset, shot: StoredScene, depth_m: Float[np.ndarray, "h w"], step_m: float
) -> tuple[Float[np.ndarray, "h w"], str]:
    """Of z, with the rounding to steps; NaN where there is no depth."""
    rig = rig_of(stored.taker(shot.sensor)["rig"])
    slope_m = depth_slope_m(depth_m, rig)
    try:
        maps = read_code_maps(shot.folder, sensor=shot.sensor, number=shot.image)
    except Unreadable as error:
        raise DatasetError(f"{shot.folder}: {error}: run graycast validate") from error
    sigma_px = maps.get(f"sigma_{triangulation_axis(rig)}")
    if sigma_px is not None:
        noise_px, source = sigma_px.astype(np.float64), "code maps"
    else:
        light = shot.picture("modulation_sl")
        noise_px, source = measured_noise_px(depth_m, slope_m, light, rig), "neighbours"
    sigma_m = np.hypot(slope_m * noise_px, step_m / 12**0.5)
    return np.where(np.isfinite(depth_m), sigma_m, np.nan), source
