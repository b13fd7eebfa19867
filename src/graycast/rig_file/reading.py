"""What both kinds of rig file need: the checks on the way to a `Rig`."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..errors import ConfigError
from ..frames import is_rigid, rigid
from ..optics import Optics, rays
from ..rig import Rig


def is_file_storage(text: str) -> bool:
    return text.startswith("%YAML:") or "opencv-matrix" in text or "<opencv_storage" in text[:400]


def check_rotation(R: Float[np.ndarray, "3 3"], where: str) -> None:
    """Refuse what is not a proper rotation to 1e-6; nothing is made orthonormal silently."""
    if is_rigid(rigid(R, np.zeros(3))):
        return
    error = np.abs(R @ R.T - np.eye(3)).max()
    numbers = f"det {np.linalg.det(R):.6g}, orthogonality error {error:.2g}"
    raise ConfigError(f"{where} is not a rotation ({numbers}): write it with all digits, det +1")


def build_rig(path: Path, **fields: Any) -> Rig:
    """A `Rig` whose refusals name the file."""
    try:
        return Rig(**fields)
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


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
