"""Read the views of a stored scene in the form that merging needs, with the noise of their depths.

A dataset stores no standard deviation of depth. Depth is computed from a projector position, so its
noise is the noise of the position times the derivative of depth. If code maps are stored, they
contain the decoder's noise. Otherwise the noise is estimated, for groups of pixels with similar
light, from the distances between pixels and the planes through their neighbours.

Leaves out: filters that average neighbours. They correlate the noise of neighbouring pixels, which
distances from a plane do not reveal. With such filters, the estimated sigma is too small, and the
sigma from code maps is too large.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float, Num

from ...base.errors import DatasetError
from ...base.frames import inverse, transform_points
from ...base.robust import MAD_SIGMA
from ...camera.decode import triangulation_axis
from ...dataset.files.records import MM_PER_M
from ...dataset.files.safe_reading import Unreadable
from ...dataset.read.example import pose_m
from ...dataset.read.scene_content import scene_content
from ...dataset.read.stored import StoredDataset, StoredScene
from ...dataset.write.claim import rig_of
from ...dataset.write.models import StoredModel
from ...dataset.write.raw import read_code_maps
from ...rig.optics import optics_of, points, project
from ...rig.pair import Rig
from .adding import SurfacePoints, ViewTruth, surface_of
from .view import MeasuredView, planes_of

SURFACE_POINTS = 20000  # number of points on all parts of a scene
_GROUPS, _LEAST = 8, 400  # largest number of groups, and least number of pixels of each group
_NO_PLANES_PX = (
    12**-0.5
)  # standard deviation of a position that is known to one pixel, if there are no planes
_CENTRE = 24 / 25  # share of a pixel's variance in its distance from the plane through 25 pixels
_NUDGE = 1e-4  # step for the numerical derivative of depth, as a share of the depth


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StoredView:
    """A view with its ground truth, and the source of its noise."""

    view: MeasuredView
    truth: ViewTruth
    noise: str  # `code maps` or `neighbours`
    reason_name: dict[int, str]


def read_view(stored: StoredDataset, shot: StoredScene) -> StoredView:
    """Read one picture of a scene.

    Raises:
        DatasetError: the dataset holds real pictures, or a file is missing or damaged.
    """
    if stored.real:
        raise DatasetError(
            f"{stored.folder}: holds real pictures, of which nobody knows where the camera stood: "
            "give a dataset of graycast generate"
        )
    content = scene_content(shot)
    assert content.rgb is not None  # Simulated views have a colour picture.
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
            p_wrong=shot.p_wrong(),
        ),
        truth=ViewTruth(depth_m=_metres(content.depth, step_m), instance=content.label),
        noise=noise,
        reason_name=content.reason_name,
    )


def read_surface(models: dict[int, StoredModel], shot: StoredScene) -> SurfacePoints:
    """Return points on the parts of a scene at their true poses, from one of its pictures.

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
    """Return sigma of z (NaN without depth), including rounding to depth steps, and its source."""
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


def depth_slope_m(depth_m: Float[np.ndarray, "h w"], rig: Rig) -> Float[np.ndarray, "h w"]:
    """Return the derivative of depth by the projector coordinate [m/px]; NaN without depth."""
    point_m = points(rig.camera, depth_m)
    axis = 0 if triangulation_axis(rig) == "column" else 1
    place = [
        project(rig.projector, transform_points(rig.T_proj_cam, at * point_m))
        for at in (1 - _NUDGE, 1 + _NUDGE)
    ]
    with np.errstate(divide="ignore"):
        return np.abs(2 * _NUDGE * depth_m / (place[1] - place[0])[..., axis])


def measured_noise_px(
    depth_m: Float[np.ndarray, "h w"],
    slope_m: Float[np.ndarray, "h w"],
    light: Num[np.ndarray, "h w"],
    rig: Rig,
) -> Float[np.ndarray, "h w"]:
    """Return each pixel's noise [projector px], estimated in groups of pixels of similar light.

    Args:
        light: modulation in any unit.
    """
    _, smooth_m = planes_of(depth_m, rig.camera)
    off_px = np.abs(depth_m - smooth_m) / slope_m
    on_plane = np.isfinite(off_px)
    if not on_plane.any():
        return np.full(depth_m.shape, _NO_PLANES_PX)
    order = np.argsort(light[on_plane], kind="stable")  # The groups have equal size, darkest first.
    groups = np.array_split(order, np.clip(len(order) // _LEAST, 1, _GROUPS))
    strength = [float(np.median(light[on_plane][group])) for group in groups]
    off = [float(np.median(off_px[on_plane][group])) for group in groups]
    return np.interp(light, strength, [MAD_SIGMA * each / np.sqrt(_CENTRE) for each in off])
