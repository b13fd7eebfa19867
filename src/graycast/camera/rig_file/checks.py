"""The checks that both kinds of rig file share."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError
from ...base.frames import is_rigid, rigid
from ...rig.optics import Optics, rays
from ...rig.pair import Rig, common_depths_m

RANGE_STEPS = 33  # A place that both devices see is looked for at so many depths of the range.


def is_file_storage(text: str) -> bool:
    return text.startswith("%YAML:") or "opencv-matrix" in text or "<opencv_storage" in text[:400]


def check_rotation(R: Float[np.ndarray, "3 3"], where: str) -> None:
    """Refuse what is not a proper rotation to 1e-6; nothing is made orthonormal silently."""
    if is_rigid(rigid(R, np.zeros(3))):
        return
    error = np.abs(R @ R.T - np.eye(3)).max()
    numbers = f"det {np.linalg.det(R):.6g}, orthogonality error {error:.2g}"
    raise ConfigError(
        f"{where} is not a rotation ({numbers}): give it with all digits and with determinant +1"
    )


def build_rig(path: Path, **fields: Any) -> Rig:
    """A `Rig` whose refusals name the file, and whose devices look at one place.

    Raises:
        ConfigError: it is no rig, or camera and projector see nothing in common in its range.
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
    """Optics whose distortion can be undone over the whole image."""
    try:
        optics = Optics(**fields)
        x = np.linspace(-0.5, optics.width_px - 0.5, 33)
        y = np.linspace(-0.5, optics.height_px - 0.5, 33)
        rays(optics, np.stack(np.meshgrid(x, y), axis=-1))
    except ValueError as error:
        raise ConfigError(f"{path}: {device}: {error}") from error
    return optics
