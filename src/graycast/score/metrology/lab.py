"""The virtual laboratory: the true rig lights a scene, and the scanner scans it."""

import platform
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_erosion

from ...base.frames import transform_points
from ...camera.decode import DepthMap, Reason
from ...camera.exposure import ExposureTimes, exposure_times
from ...camera.faults import FaultSpec
from ...camera.light import camera_light
from ...camera.scanner import Scanner, measure, take
from ...rendering import Quality, Renderer, Rendering
from ...rig.optics import blur_radius_px, picture_rays
from ...rig.pair import Rig, grey_levels
from ...rig.pattern import Code
from ...world.parts import Material
from ...world.scene import EMPTY_LAYOUT, Environment, Quad, Scene, Sphere
from .artefacts import Volume, common_rectangle_m, in_view, working_volume
from .certificate import BlurResult, Scope

ERODED_PX = 3  # width of the strip that is excluded along the outline of each artefact
BLUR_DEPTHS = 21
MIN_DECODED = 0.05  # A smaller share of decoded pixels is due to the settings, not to the shape.


@dataclass(frozen=True, slots=True, kw_only=True)
class Lab:
    """Data for all scenes of a certificate.

    `ray` has the directions of the true camera's pixels, and `scanner_ray` has the directions from
    the scanner's calibration.
    """

    scanner: Scanner
    rig: Rig
    renderer: Renderer
    scope: Scope
    volume: Volume
    code: Code
    pattern: UInt8[np.ndarray, "n ph pw"]
    material: Material
    ray: Float[np.ndarray, "h w 3"]
    scanner_ray: Float[np.ndarray, "h w 3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """One scene: its truth, the light of each frame, and the measurement of each shot.

    `where` is a mask of the pixels in both fields and in the working range, away from outlines.
    """

    truth_m: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    light: Float[np.ndarray, "n h w"]
    where: Bool[np.ndarray, "h w"]
    exposures_s: tuple[float, ...]
    depth_m: Float[np.ndarray, "captures h w"]
    sigma_m: Float[np.ndarray, "h w"]


def open_lab(scanner: Scanner, rig: Rig, scope: Scope, renderer: Renderer) -> Lab:
    """Return a lab; raises ValueError if camera and projector share no field."""
    code = scanner.light_code()
    return Lab(
        scanner=scanner,
        rig=rig,
        renderer=renderer,
        scope=scope,
        volume=working_volume(rig),
        code=code,
        pattern=code.render(lambda share: grey_levels(scanner.rig, share)),
        material=Material(base_color=(scope.albedo,) * 3, specular=0.0),
        ray=picture_rays(rig.camera),
        scanner_ray=picture_rays(scanner.rig.camera),
    )


def shoot(lab: Lab, surfaces: tuple[Quad | Sphere, ...], *, captures: int, seed: int) -> Shots:
    """Render a scene once and scan it `captures` times with different sensor noise.

    Raises:
        ValueError: no artefact is in the volume, or hardly any of it is decoded.
    """
    seeds = np.random.SeedSequence(seed).generate_state(captures + 1).tolist()
    rendering = _render(lab, surfaces, seeds[0])
    where = _in_volume(lab, rendering)
    metered, times = _metered(lab, rendering, where)
    # All shots share the sampling noise of the light paths, so the noise between shots excludes it.
    light = rendering.radiance
    scans = [
        measure(metered, take(metered, light, seed=own), path_noise=None)[1] for own in seeds[1:]
    ]
    _check_decoded(scans[0], where, times.reference_s)
    return Shots(
        truth_m=rendering.truth.depth_m,
        normal=rendering.truth.normal,
        light=camera_light(rendering.radiance, lab.rig)[0],
        where=where,
        exposures_s=times.times_s,
        depth_m=np.stack([scan.depth_m for scan in scans]),
        sigma_m=scans[0].sigma_m,
    )


def _check_decoded(scan: DepthMap, where: Bool[np.ndarray, "h w"], exposure_s: float) -> None:
    share = float(np.isfinite(scan.depth_m[where]).mean())
    if share < MIN_DECODED:
        counts = np.bincount(scan.reason[where], minlength=len(Reason))
        why = Reason(int(counts[1:].argmax()) + 1).label
        raise ValueError(
            f"{share:.1%} of an artefact has depth, and most of the rest is {why} at an exposure "
            f"of {1e3 * exposure_s:.3g} ms: change the exposure, the code or the filters"
        )


def _render(lab: Lab, surfaces: tuple[Quad | Sphere, ...], seed: int) -> Rendering:
    scope = lab.scope
    scene = Scene(
        rig=lab.rig,
        T_world_cam=np.eye(4),  # The world frame is the camera frame.
        surfaces=surfaces,
        environment=Environment(radiance=(0.0, 0.0, 0.0)),
    )
    quality = Quality(samples=scope.samples, depth=scope.depth)
    return lab.renderer.render(scene, EMPTY_LAYOUT, lab.pattern, quality=quality, seed=seed)


def _in_volume(lab: Lab, rendering: Rendering) -> Bool[np.ndarray, "h w"]:
    truth_m = rendering.truth.depth_m
    with np.errstate(invalid="ignore"):  # Depth is NaN where there is no surface.
        inside = (truth_m > lab.volume.near_m) & (truth_m < lab.volume.far_m)
    inside[inside] &= in_view(lab.rig, lab.ray[inside] * truth_m[inside][:, None])
    return binary_erosion(inside, iterations=ERODED_PX)


def _metered(
    lab: Lab, rendering: Rendering, where: Bool[np.ndarray, "h w"]
) -> tuple[Scanner, ExposureTimes]:
    """Return the scanner with exposures that are metered on the artefact, and their times.

    The scanner's own automatic exposure uses the whole picture, which a small sphere does not fill.
    """
    if not where.any():
        raise ValueError(
            f"an artefact has no pixel in the volume of rig {lab.rig.name}: is the camera's "
            f"resolution, {lab.rig.camera.width_px} px, may be too low"
        )
    exposure = lab.scanner.exposure
    stack, background = camera_light(rendering.radiance, lab.scanner.rig)
    light = stack[lab.scanner.light_code().brightest] + background
    times = exposure_times(light[where], lab.scanner.sensor, exposure)
    factors = tuple(time_s / times.reference_s for time_s in times.times_s)
    fixed = replace(exposure, exposure_s=times.reference_s, factors=factors, auto=False)
    return replace(lab.scanner, exposure=fixed), times


def incidence_rad(lab: Lab, shots: Shots) -> Float[np.ndarray, "h w"]:
    """Return the larger angle of incidence of the camera's and the projector's ray, per pixel."""
    point = lab.ray * shots.truth_m[..., None]
    to_projector = transform_points(lab.rig.T_proj_cam, point)
    normal_proj = shots.normal @ lab.rig.T_cam_proj[:3, :3]
    cosine = [
        -(way * normal).sum(axis=-1) / np.linalg.norm(way, axis=-1)
        for way, normal in ((point, shots.normal), (to_projector, normal_proj))
    ]
    return np.arccos(np.clip(np.minimum(*cosine), -1.0, 1.0))


def measured_points(lab: Lab, depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return the scanner's points in the camera frame; NaN without depth."""
    return lab.scanner_ray * depth_m[..., None].astype(np.float64)


# --- figures that need no scan --------------------------------------------------------------------


def blur(lab: Lab) -> tuple[BlurResult, ...]:
    z_m = np.linspace(lab.volume.near_m, lab.volume.far_m, BLUR_DEPTHS)
    axis = np.stack([0 * z_m, 0 * z_m, z_m], axis=-1)
    z_projector_m = transform_points(lab.rig.T_proj_cam, axis)[:, 2]
    rows = zip(
        z_m,
        blur_radius_px(lab.rig.camera, z_m),
        blur_radius_px(lab.rig.projector, z_projector_m),
        strict=True,
    )
    return tuple(
        BlurResult(z_m=float(z), camera_px=float(camera), projector_px=float(projector))
        for z, camera, projector in rows
    )


def fields_m(lab: Lab) -> dict[str, tuple[float, float]]:
    """Return width and height of the common field at the near end, the middle and the far end."""
    fields = {}
    for name, share in (("near", 0.0), ("middle", 0.5), ("far", 1.0)):
        field = common_rectangle_m(lab.rig, lab.volume.depth_m(share))
        width_m, height_m = (0.0, 0.0) if field is None else (field[1] - field[0]).tolist()
        fields[name] = (width_m, height_m)
    return fields


def rig_figures(rig: Rig) -> dict[str, Any]:
    names = ("width_px", "height_px", "fx_px", "aperture_m", "focus_m", "psf_px")
    return {
        "name": rig.name,
        "baseline_m": rig.baseline_m,
        "axes_angle_rad": rig.axes_angle_rad,
        "projector_m": rig.T_cam_proj[:3, 3].tolist(),
        "camera": {name: getattr(rig.camera, name) for name in names},
        "projector": {name: getattr(rig.projector, name) for name in names},
    }


def conditions(lab: Lab, seed: int) -> dict[str, Any]:
    scanner, scope = lab.scanner, lab.scope
    kinds = {
        "codec": scanner.code.codec,
        "frames": len(lab.code.frames),
        "subpixel": lab.code.subpixel,
    }
    return {
        "albedo": scope.albedo,
        "samples": scope.samples,
        "path_vertices": scope.depth,
        "captures": scope.captures,
        "exposures": "automatic" if scanner.exposure.auto else list(scanner.exposure.factors),
        "code": kinds,
        "filters": asdict(scanner.filters),
        "faults": asdict(scanner.faults) if scanner.faults != FaultSpec() else {},
        "calibration_differs": lab.rig is not scanner.rig,
        "renderer": f"{lab.renderer.name} on {lab.renderer.device}, {platform.machine()}",
        "seed": seed,
    }
