"""What a certificate states without a scan: the rig, its fields, its blur, the conditions."""

import platform
from dataclasses import asdict
from typing import Any

import numpy as np

from ...base.frames import transform_points
from ...camera.faults import FaultSpec
from ...rig.optics import Optics, blur_radius_px
from ...rig.pair import Rig
from .artefacts import common_rectangle_m
from .certificate import BlurResult
from .lab import Lab

BLUR_DEPTHS = 21


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
    """Width and height of the common rectangle at the near end, the middle and the far end."""
    fields = {}
    for name, share in (("near", 0.0), ("middle", 0.5), ("far", 1.0)):
        field = common_rectangle_m(lab.rig, lab.volume.depth_m(share))
        width_m, height_m = (0.0, 0.0) if field is None else (field[1] - field[0]).tolist()
        fields[name] = (width_m, height_m)
    return fields


def rig_figures(rig: Rig) -> dict[str, Any]:
    def optics(one: Optics) -> dict[str, Any]:
        return {
            "width_px": one.width_px,
            "height_px": one.height_px,
            "fx_px": one.fx_px,
            "aperture_m": one.aperture_m,
            "focus_m": one.focus_m,
            "psf_px": one.psf_px,
        }

    return {
        "name": rig.name,
        "baseline_m": rig.baseline_m,
        "axes_angle_rad": rig.axes_angle_rad,
        "projector_m": rig.T_cam_proj[:3, 3].tolist(),
        "camera": optics(rig.camera),
        "projector": optics(rig.projector),
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
        "ambient_w_sr_m2": scope.ambient_w_sr_m2,
        "samples": scope.samples,
        "path_vertices": scope.depth,
        "captures": scope.captures,
        "exposures": list(scanner.exposure.factors),
        "code": kinds,
        "filters": asdict(scanner.filters),
        "faults": asdict(scanner.faults) if scanner.faults != FaultSpec() else {},
        "calibration_differs": lab.rig is not scanner.rig,
        "renderer": f"{lab.renderer.name} on {lab.renderer.device}, {platform.machine()}",
        "seed": seed,
    }
