"""Graycast's own rig file: YAML that holds exactly what a `Rig` holds."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import Field

from ..errors import ConfigError
from ..frames import rigid
from ..optics import Optics
from ..rig import PRESETS, RESOLUTIONS, Rig, preset
from ..settings import Settings, check_settings, parse_yaml, read_text
from .reading import build_optics, build_rig, check_rotation, is_file_storage

Row = tuple[float, float, float]


class OpticsModel(Settings):
    """Intrinsics of a camera or projector; the centre of the top-left pixel is (0, 0)."""

    width_px: int = Field(ge=1, description="Image width.")
    height_px: int = Field(ge=1, description="Image height.")
    fx_px: float = Field(gt=0, description="Focal length along x.")
    fy_px: float = Field(gt=0, description="Focal length along y.")
    cx_px: float = Field(description="Principal point, x.")
    cy_px: float = Field(description="Principal point, y.")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0),
        description="Brown-Conrady (k1, k2, p1, p2, k3), OpenCV's order.",
    )


class RigModel(Settings):
    """A camera and a projector that hold still to each other."""

    name: str = Field(min_length=1, description="Name in reports and datasets.")
    camera: OpticsModel
    projector: OpticsModel
    R_cam_proj: tuple[Row, Row, Row] = Field(
        description="Rotation, row by row: projector to camera coordinates."
    )
    t_cam_proj_m: Row = Field(description="The projector's centre in camera coordinates [m].")
    near_m: float = Field(gt=0, description="Nearest depth of the working range.")
    far_m: float = Field(gt=0, description="Farthest depth of the working range.")
    intensity_w_sr: float = Field(
        default=10.0, gt=0, description="Radiant intensity of a white projector pixel [W/sr]."
    )
    band_weights: Row = Field(
        default=(1 / 3, 1 / 3, 1 / 3), description="Shares of red, green and blue; sum 1."
    )
    picture_level: float = Field(
        default=0.0, ge=0, le=1, description="Projector's level while the colour picture is taken."
    )


def rig_schema() -> dict[str, Any]:
    """JSON Schema of a rig file, from which editors complete."""
    return RigModel.model_json_schema()


def save_rig(rig: Rig, path: Path) -> None:
    """Write a rig file; `load_rig` gives the same numbers back to the last bit.

    Raises:
        ConfigError: the file cannot be written; a file that was there is left as it was.
    """
    content = {
        "name": rig.name,
        "camera": _optics_content(rig.camera),
        "projector": _optics_content(rig.projector),
        "R_cam_proj": rig.T_cam_proj[:3, :3].tolist(),
        "t_cam_proj_m": rig.T_cam_proj[:3, 3].tolist(),
        "near_m": float(rig.near_m),
        "far_m": float(rig.far_m),
        "intensity_w_sr": float(rig.intensity_w_sr),
        "band_weights": [float(weight) for weight in rig.band_weights],
        "picture_level": float(rig.picture_level),
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    aside = path.with_name(path.name + ".part")
    try:
        aside.write_text(text, encoding="utf-8")
        os.replace(aside, path)
    except OSError as error:
        with suppress(OSError):
            aside.unlink(missing_ok=True)
        why = error.strerror or error
        raise ConfigError(
            f"{path}: the rig cannot be written ({why}): choose a writable folder"
        ) from error


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        ConfigError: the file is missing or not a rig; the text names the file, the key, the remedy.
    """
    text = read_text(path)
    if is_file_storage(text) or path.suffix.lower() in (".xml", ".npz"):
        raise ConfigError(
            f"{path}: looks like an OpenCV calibration, not a rig file: import it and save the rig"
        )
    content = parse_yaml(text, path)
    model = check_settings(content, RigModel, path)
    R_cam_proj = np.array(model.R_cam_proj)
    check_rotation(R_cam_proj, f"{path}: R_cam_proj")
    return build_rig(
        path,
        name=model.name,
        camera=build_optics(path, "camera", **model.camera.model_dump()),
        projector=build_optics(path, "projector", **model.projector.model_dump()),
        T_cam_proj=rigid(R_cam_proj, np.array(model.t_cam_proj_m)),
        near_m=model.near_m,
        far_m=model.far_m,
        intensity_w_sr=model.intensity_w_sr,
        band_weights=model.band_weights,
        picture_level=model.picture_level,
    )


def resolve_rig(text: str, *, folder: Path, resolution: str = "low") -> Rig:
    """The rig that a configuration means by `rig: text`.

    Args:
        text: a name in `PRESETS`, or a rig file, relative to `folder`.
        folder: where the configuration lies.
        resolution: of a preset; a file states its own.

    Raises:
        ConfigError: neither a preset nor a readable rig file, or no such resolution.
    """
    if resolution not in RESOLUTIONS:
        choices = " or ".join(RESOLUTIONS)
        raise ConfigError(f"resolution: no resolution {resolution!r}: choose {choices}")
    if text in PRESETS:
        return preset(text, resolution)
    path = folder / text
    if path.is_file() or "/" in text or Path(text).suffix in (".yaml", ".yml", ".json"):
        return load_rig(path)
    choices = ", ".join(PRESETS)
    raise ConfigError(f"rig: no rig {text!r}: choose one of {choices}, or name a file in {folder}")


def _optics_content(optics: Optics) -> dict[str, Any]:
    return {
        "width_px": int(optics.width_px),
        "height_px": int(optics.height_px),
        "fx_px": float(optics.fx_px),
        "fy_px": float(optics.fy_px),
        "cx_px": float(optics.cx_px),
        "cy_px": float(optics.cy_px),
        "distortion": [float(term) for term in optics.distortion],
    }
