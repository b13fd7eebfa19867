"""Measure a sample's scene with a complete scanner, from the light that each pixel receives."""

from dataclasses import replace

import numpy as np

from graycast.base.frames import axis_rotation, inverse, pixel_grid, rigid, transform_points
from graycast.camera.decode import Reason
from graycast.camera.scanner import Scanner, measure
from graycast.camera.sensor import auto_exposure_s, expose, merge_exposures
from graycast.dataset.files.sample import Raw
from graycast.rig.optics import Optics, project, rays
from graycast.rig.pattern import level_share

PROJECTOR = (256, 192)


def toed_in(rig):
    """Return a rig with a projector 0.2 m beside the camera, aimed at the same point."""
    width_px, height_px = PROJECTOR
    projector = Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=300.0,
        fy_px=300.0,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
        distortion=rig.projector.distortion,
    )
    T_cam_proj = rigid(axis_rotation("y", -0.35), np.array([0.2, 0.0, 0.0]))
    return replace(rig, projector=projector, T_cam_proj=T_cam_proj)


def rolled(rig, angle_rad):
    """Return the rig with its projector rolled about its axis: rows are wrong at left and right."""
    turn = rigid(axis_rotation("z", angle_rad), np.zeros(3))
    return replace(rig, T_cam_proj=rig.T_cam_proj @ turn)


def light(code, rig, depth_m):
    """Return radiance (frames, h, w) without shadows, with a constant added to every pixel."""
    point = rays(rig.camera, pixel_grid(*depth_m.shape)) * depth_m[..., None]
    place = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point))
    inside = ((place > -0.5) & (place < np.array(PROJECTOR) - 0.5)).all(axis=-1)
    albedo = 0.7 + 0.3 * np.sin(0.21 * np.arange(depth_m.shape[1]))
    stack = []
    for frame in code.frames:
        i = 1 if frame.axis == "row" else 0
        size = 1 if frame.axis is None else PROJECTOR[i]
        share = level_share(frame, size, offset_px=code.offset_px[i], stride_px=code.stride_px[i])
        lit = np.interp(place[..., i], np.arange(size), share)  # blurred over a pixel's width
        stack.append(np.where(inside, lit * albedo, 0.0) + 0.02)
    return np.float32(stack)


def picture_of(capture):
    """Return light per second, as a share of saturation in the reference exposure."""
    sensor = capture.sensor
    per_s = (capture.frames[0] - sensor.offset_dn) / capture.exposure_s
    full_per_s = (sensor.saturation_dn - sensor.offset_dn) / capture.reference_s
    return np.rint(255 * np.clip(per_s / full_per_s, 0, 1)).astype(np.uint8)


def scanned(sample, scanner: Scanner, *, seed: int, roll_rad: float = 0.0):
    """Return the sample as this scanner measures it, through all steps.

    `roll_rad` is a roll of the real projector that the rig file does not state.
    """
    stack = light(scanner.light_code(), rolled(scanner.rig, roll_rad), sample.truth.depth_m)
    exposure = scanner.exposure
    time_s = auto_exposure_s(stack[0], scanner.sensor, percentile=99.0, target=exposure.target)
    capture = merge_exposures(
        [
            expose(stack, None, scanner.sensor, exposure_s=factor * time_s, seed=seed + k)
            for k, factor in enumerate(exposure.factors)
        ]
    )
    codes, depth = measure(scanner, capture, path_noise=None)
    shares = {r.name.lower(): float((depth.reason == r).mean()) for r in Reason}
    return replace(
        sample,
        scene=replace(sample.scene, rig=scanner.rig),
        gray=picture_of(capture),
        scanner_depth=depth,
        modulation=codes.modulation,
        manifest={**sample.manifest, "reasons": shares},
        raw=Raw(scanner=scanner, capture=capture, codes=codes),
    )
