"""Checks that apply to both kinds of rig file."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError
from ...base.frames import is_rigid, rigid
from ...rig.optics import Optics, rays
from ...rig.pair import Rig, common_depths_m

RANGE_STEPS = 33  # The number of depths at which the common field of view is tested.


def is_file_storage(text: str) -> bool:
    return text.startswith("%YAML:") or "opencv-matrix" in text or "<opencv_storage" in text[:400]


def check_rotation(R: Float[np.ndarray, "3 3"], where: str) -> None:
    """Refuse a matrix that is not a rotation to 1e-6, instead of making it orthonormal silently."""
    if is_rigid(rigid(R, np.zeros(3))):
        return
    error = np.abs(R @ R.T - np.eye(3)).max()
    numbers = f"det {np.linalg.det(R):.6g}, orthogonality error {error:.2g}"
    raise ConfigError(
        f"{where} is not a rotation ({numbers}): give it with all digits and with determinant +1"
    )


def build_rig(path: Path, **fields: Any) -> Rig:
    """Build a `Rig`, with errors that name the file.

    Raises:
        ConfigError: a value is wrong, or the fields of view do not overlap in the working range.
    """
    try:
        rig = Rig(**fields)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    range_m = np.linspace(rig.near_m, rig.far_m, RANGE_STEPS)
    if not len(common_depths_m(rig.camera, rig.projector, rig.T_cam_proj, range_m)):
        raise ConfigError(
            f"{path}: camera and projector have no common field of view from {rig.near_m:g} to "
            f"{rig.far_m:g} m: check that R_cam_proj and t_cam_proj_m map projector coordinates "
            "to camera coordinates, and check near_m and far_m"
        )
    return rig


def build_optics(path: Path, device: str, **fields: Any) -> Optics:
    """Build `Optics`, and check that the distortion has an inverse over the whole image."""
    try:
        optics = Optics(**fields)
        x = np.linspace(-0.5, optics.width_px - 0.5, 33)
        y = np.linspace(-0.5, optics.height_px - 0.5, 33)
        rays(optics, np.stack(np.meshgrid(x, y), axis=-1))
    except ValueError as error:
        raise ConfigError(f"{path}: {device}: {error}") from error
    return optics
