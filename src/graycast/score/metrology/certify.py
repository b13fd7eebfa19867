"""Certify a virtual scanner by scans of virtual artefacts in its whole volume."""

import math
import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...base.progress import UNWATCHED, ProgressMeter
from ...camera.scanner import Scanner
from ...rendering import Renderer
from ...rig.pair import Rig
from .artefacts import (
    BallBar,
    ball_bars,
    common_rectangle_m,
    grouped,
    plane,
    sphere_centre_m,
    spheres,
)
from .certificate import Certificate, PlaneResult, ProbingResult, Scope, SpacingResult
from .lab import (
    Lab,
    Shots,
    blur,
    conditions,
    fields_m,
    incidence_rad,
    measured_points,
    open_lab,
    rig_figures,
    shoot,
)
from .measures import (
    depth_error_m,
    flatness,
    modulation,
    point_spacing_m,
    probing,
    temporal_noise_m,
)

MIDDLE_SHARE = 0.5  # Noise is measured in this share of the common field's width and height.
MIDDLE_DEPTH = 0.05  # largest relative deviation in depth from the middle of a tilted plane
FLATNESS_TILT_DEG = 30.0
STEEPEST_DEG = 60.0  # largest angle of incidence of camera or projector for points of a sphere
PROBING_SHARE, BAR_SPHERE_SHARE = (
    0.1,
    0.05,
)  # diameters of spheres, as shares of the volume's diagonal
SMALLEST_FIELD_SHARE = 0.35  # largest share of the field at the near end for a sphere's diameter
MAP_WIDTH = 104

PLACES = (
    (0.0, 0.0, 0.5),
    (-1.0, -1.0, 0.0),
    (1.0, 1.0, 0.0),
    (0.0, 0.0, 0.0),
    (1.0, -1.0, 0.5),
    (-1.0, 1.0, 0.5),
    (1.0, 1.0, 0.5),
    (-1.0, -1.0, 1.0),
    (1.0, 1.0, 1.0),
    (0.0, 0.0, 1.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pose:
    name: str
    z_m: float
    captures: int
    tilt_deg: float = 0.0
    azimuth_deg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """All artefacts, and the spheres of each probing scene; each ball bar has a separate scene."""

    poses: tuple[_Pose, ...]
    probing_radius_m: float
    places_m: Float[np.ndarray, "n 3"]
    place_scenes: list[list[int]]
    bars: tuple[BallBar, ...]

    @property
    def scenes(self) -> int:
        return len(self.poses) + len(self.place_scenes) + len(self.bars)


def certify(
    scanner: Scanner,
    *,
    renderer: Renderer,
    seed: int,
    scope: Scope | None = None,
    rendered_with: Rig | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> Certificate:
    """Measure the accuracy of a scanner over its working volume.

    The scanner is used with its filters and smoothing. In each scene, exposure is metered on the
    artefact, unless the scanner has a fixed exposure. The truth comes from the scene.

    Args:
        renderer: an open renderer.
        seed: seed for light sampling and sensor noise.
        rendered_with: the true rig, which renders the light and defines the working volume. Give it
            if the scanner's rig is an inexact calibration; the default is the scanner's rig.
        progress: meter that receives the number of finished scenes and the next artefact's name.

    Raises:
        ValueError: camera and projector share too small a field, or an artefact is not decoded.

    Leaves out: changes from shot to shot other than sensor noise (vibration, drift, warm-up,
    projector flicker); errors of the artefacts; interreflections, if `scope.depth` is 1.
    """
    start_s = time.perf_counter()
    lab = open_lab(scanner, rendered_with or scanner.rig, scope or Scope(), renderer)
    plan = _plan(lab)
    own_seed = np.random.SeedSequence(seed).generate_state(plan.scenes).tolist()
    done = 0

    def next_seed(what: str) -> int:
        nonlocal done
        progress.stage(what)
        progress.count("scenes", done, plan.scenes)
        done += 1
        return own_seed[done - 1]

    planes, deviation_m = [], np.zeros((0, 0))
    for pose in plan.poses:
        result, map_m = _plane(lab, pose, next_seed(pose.name))
        planes.append(result)
        if len(planes) == lab.scope.distances // 2 + 1:
            deviation_m = map_m
    probed: dict[int, ProbingResult] = {}
    for k, scene in enumerate(plan.place_scenes, 1):
        seed_here = next_seed(f"probing spheres, scene {k} of {len(plan.place_scenes)}")
        probed |= _probe(lab, plan, scene, seed_here)
    spacing = [_space(lab, bar, next_seed(f"ball bar, {bar.name}")) for bar in plan.bars]
    progress.count("scenes", done, plan.scenes)
    return Certificate(
        rig=rig_figures(scanner.rig),
        conditions=conditions(lab, seed),
        near_m=lab.volume.near_m,
        far_m=lab.volume.far_m,
        diagonal_m=lab.volume.diagonal_m,
        field_m=fields_m(lab),
        probing_diameter_m=2 * plan.probing_radius_m,
        bar_length_m=plan.bars[0].length_m,
        bar_diameter_m=2 * plan.bars[0].radius_m,
        planes=tuple(planes),
        probing=tuple(probed[i] for i in sorted(probed)),
        spacing=tuple(spacing),
        blur=blur(lab),
        deviation_m=deviation_m,
        seconds=time.perf_counter() - start_s,
        scenes=plan.scenes,
    )


# --- positions of artefacts ----------------------------------------------------------------------


def _plan(lab: Lab) -> _Plan:
    rig, volume, scope = lab.rig, lab.volume, lab.scope
    field = common_rectangle_m(rig, volume.depth_m(0.0))
    if field is None:
        raise ValueError(
            f"camera and projector of {rig.name} have too small a common field of view at the "
            "near distance"
        )
    most_m = SMALLEST_FIELD_SHARE * float((field[1] - field[0]).min())
    radius_m = min(PROBING_SHARE * volume.diagonal_m, most_m) / 2
    bar_radius_m = min(BAR_SPHERE_SHARE * volume.diagonal_m, most_m) / 2
    wanted = PLACES[: scope.spheres]
    places_m = np.stack([sphere_centre_m(rig, volume, at, radius_m) for at in wanted])
    bars = ball_bars(rig, volume, radius_m=bar_radius_m)[: scope.bars]
    return _Plan(
        poses=_poses(lab),
        probing_radius_m=radius_m,
        places_m=places_m,
        place_scenes=grouped(rig, places_m, radius_m),
        bars=bars,
    )


def _poses(lab: Lab) -> tuple[_Pose, ...]:
    """Return facing planes from near to far, then tilts about the baseline, then other tilts.

    A tilt about the baseline is the same for both devices; other tilts are steeper for one of them.
    """
    captures, volume = lab.scope.captures, lab.volume
    baseline_deg = math.degrees(math.atan2(*lab.rig.T_cam_proj[[1, 0], 3]))
    middle_m = volume.depth_m(0.5)
    facing = [
        _Pose(name=f"facing at {1e3 * z_m:.0f} mm", z_m=z_m, captures=captures)
        for z_m in map(volume.depth_m, np.linspace(0, 1, lab.scope.distances).tolist())
    ]
    about = [
        _Pose(
            name=f"tilted about baseline by {tilt:g} deg",
            z_m=middle_m,
            captures=captures,
            tilt_deg=tilt,
            azimuth_deg=baseline_deg,
        )
        for tilt in lab.scope.tilts_deg
    ]
    across = [
        _Pose(
            name=name,
            z_m=middle_m,
            captures=1,
            tilt_deg=FLATNESS_TILT_DEG,
            azimuth_deg=baseline_deg + turn,
        )
        for name, turn in (
            ("tilted across baseline, towards one side", 90.0),
            ("tilted across baseline, towards the other", -90.0),
            ("tilted about a diagonal", 45.0),
            ("tilted about the other diagonal", -45.0),
        )
    ]
    return *facing, *about, *across


# --- planes ------------------------------------------------------------------------------------


def _plane(lab: Lab, pose: _Pose, seed: int) -> tuple[PlaneResult, Float[np.ndarray, "h w"]]:
    """Return the figures of one plane, and a map of distances from its best fit."""
    surface = plane(
        pose.z_m,
        tilt_rad=math.radians(pose.tilt_deg),
        azimuth_rad=math.radians(pose.azimuth_deg),
        material=lab.material,
    )
    shots = shoot(lab, (surface,), captures=pose.captures, seed=seed)
    first_m = shots.depth_m[0]
    point = measured_points(lab, first_m)
    decoded = shots.where & np.isfinite(first_m)
    middle = _middle(shots, pose.z_m)
    fit, off = flatness(point[decoded])
    noise_m = temporal_noise_m(shots.depth_m, middle) if pose.captures > 1 else math.nan
    measured = middle & np.isfinite(first_m)
    if not measured.any():
        raise ValueError(
            f"the plane {pose.name!r} has no depth in its middle: check the focus and the working "
            "range"
        )
    result = PlaneResult(
        name=pose.name,
        z_m=pose.z_m,
        tilt_deg=pose.tilt_deg,
        azimuth_deg=pose.azimuth_deg,
        flatness_m=off.range_m,
        std_m=off.std_m,
        offset_m=float(np.median(first_m[decoded] - shots.truth_m[decoded])),
        points=off.points,
        dropped=off.dropped,
        decoded_share=float(decoded.sum() / shots.where.sum()),
        noise_m=noise_m,
        error_m=depth_error_m(first_m[measured] - shots.truth_m[measured]),
        sigma_m=float(np.median(shots.sigma_m[measured])),
        spacing_m=point_spacing_m(point, middle),
        exposures_s=shots.exposures_s,
        modulation=modulation(lab.code, shots.light, middle),
    )
    return result, _block_means(np.where(decoded, fit.distance_m(point), np.nan))


def _middle(shots: Shots, z_m: float) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the middle of the common field, limited to depths near `z_m`."""
    rows, columns = (np.flatnonzero(shots.where.any(axis=axis)) for axis in (1, 0))
    window = np.zeros_like(shots.where)
    cut = (1 - MIDDLE_SHARE) / 2
    top, bottom = np.quantile(rows, [cut, 1 - cut]).astype(int)
    left, right = np.quantile(columns, [cut, 1 - cut]).astype(int)
    window[top : bottom + 1, left : right + 1] = True
    with np.errstate(invalid="ignore"):  # Depth is NaN where there is no surface.
        return shots.where & window & (np.abs(shots.truth_m / z_m - 1) <= MIDDLE_DEPTH)


def _block_means(image: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "bh bw"]:
    """Return the means of square blocks of pixels; NaN for blocks that are less than half valid."""
    size = max(1, math.ceil(image.shape[1] / MAP_WIDTH))
    h, w = (length // size for length in image.shape)
    whole = image[: h * size, : w * size].reshape(h, size, w, size)
    blocks = whole.swapaxes(1, 2).reshape(h, w, size * size)
    known = np.isfinite(blocks)
    mean = np.where(known, blocks, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    return np.where(known.mean(axis=-1) >= 0.5, mean, np.nan)


# --- spheres -----------------------------------------------------------------------------------


def _sphere_points(
    lab: Lab, shots: Shots, centre_m: Float[np.ndarray, "n 3"], radius_m: float
) -> list[Float[np.ndarray, "_ 3"]]:
    """Return the measured points on each sphere where the incidence is at most `STEEPEST_DEG`."""
    with np.errstate(invalid="ignore"):  # Depth is NaN where there is no surface.
        good = shots.where & (incidence_rad(lab, shots) <= math.radians(STEEPEST_DEG))
    good &= np.isfinite(shots.depth_m[0])
    true_point = lab.ray[good] * shots.truth_m[good][:, None]
    point = measured_points(lab, shots.depth_m[0])[good]
    distance = np.linalg.norm(true_point[:, None] - centre_m, axis=-1)
    return [point[distance[:, i] < 1.01 * radius_m] for i in range(len(centre_m))]


def _probe(lab: Lab, plan: _Plan, scene: list[int], seed: int) -> dict[int, ProbingResult]:
    centre_m, radius_m = plan.places_m[scene], plan.probing_radius_m
    shots = shoot(lab, spheres(centre_m, radius_m, lab.material), captures=1, seed=seed)
    results = {}
    for i, true_m, point in zip(
        scene, centre_m, _sphere_points(lab, shots, centre_m, radius_m), strict=True
    ):
        fit, off = probing(point)
        results[i] = ProbingResult(
            centre_m=tuple(true_m.tolist()),
            form_m=off.range_m,
            size_m=2 * (fit.radius_m - radius_m),
            std_m=off.std_m,
            centre_error_m=float(np.linalg.norm(fit.centre_m - true_m)),
            points=off.points,
            dropped=off.dropped,
        )
    return results


def _space(lab: Lab, bar: BallBar, seed: int) -> SpacingResult:
    surfaces = spheres(bar.ends_m, bar.radius_m, lab.material)
    shots = shoot(lab, surfaces, captures=1, seed=seed)
    (first, near), (second, far) = (
        probing(point) for point in _sphere_points(lab, shots, bar.ends_m, bar.radius_m)
    )
    first_m, second_m = (tuple(end) for end in bar.ends_m.tolist())
    return SpacingResult(
        name=bar.name,
        ends_m=(first_m, second_m),
        error_m=float(np.linalg.norm(second.centre_m - first.centre_m)) - bar.length_m,
        points=(near.points, far.points),
    )
