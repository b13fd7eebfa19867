"""A calibration's views from stacks on disk, and its result in words."""

from pathlib import Path

import numpy as np

from ...camera.stack import decode_stack
from .calibration import Calibration
from .observing import BoardView


def read_view(path: Path) -> tuple[BoardView, tuple[int, int]]:
    """One pose of the board from the stack that a YAML file describes; and the projector's size.

    The board is looked for in the white frame, or in the brighter of a bit and its inverse.

    Raises:
        ConfigError, DecodeError: the stack cannot be used; see `decode_stack`.
    """
    result = decode_stack(path)
    codes = result.codes
    view = BoardView(
        name=str(path),
        white=result.picture.mean(axis=2).astype(np.uint8),
        column=codes.column,
        row=codes.row,
        sigma_column=codes.sigma_column,
        sigma_row=codes.sigma_row,
        symptoms=result.warnings,
    )
    return view, (result.code.width_px, result.code.height_px)


def describe_calibration(calibration: Calibration) -> str:
    """Residuals of each view, then the rig with the standard deviation of each number."""
    lines = ["view: corners, left out, undecoded; RMS camera, projector, epipolar [px]; tilt [deg]"]
    for view in calibration.views:
        lines.append(
            f"  {view.name}: {view.corners}, {view.left_out}, {view.undecoded}; "
            f"{view.camera_rms_px:.3f}, {view.projector_rms_px:.3f}, {view.epipolar_rms_px:.3f}; "
            f"{np.degrees(view.tilt_rad):.0f}"
        )
    lines.append(
        f"all: RMS camera {calibration.camera_rms_px:.3f} px, projector "
        f"{calibration.projector_rms_px:.3f} px, epipolar {calibration.epipolar_rms_px:.3f} px"
    )
    camera, projector = calibration.coverage
    lines.append(f"corners cover {camera:.0%} of the camera's picture, {projector:.0%} of the "
                 "projector's")  # fmt: skip
    rig = calibration.rig
    lines.append(f"baseline {rig.baseline_m * 1e3:.3f} mm")
    for name, optics in (("camera", rig.camera), ("projector", rig.projector)):
        lines.append(
            f"{name}: fx {optics.fx_px:.2f}, fy {optics.fy_px:.2f}, cx {optics.cx_px:.2f}, "
            f"cy {optics.cy_px:.2f} px; distortion {_numbers(optics.distortion)}"
        )
    lines += ["standard deviations:"]
    lines += [f"  {name:24} {value:.3g}" for name, value in calibration.deviation.items()]
    lines += [
        f"set to 0, because the corners do not distinguish it from 0: {name} ({value:.3g} +- "
        f"{sigma:.2g})"
        for name, (value, sigma) in calibration.undetermined.items()
    ]
    return "\n".join(lines)


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.5f}" for value in values)
