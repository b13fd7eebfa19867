"""Graycast's own rig file: YAML that holds exactly what a `Scanner` holds."""

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import Field

from ..errors import ConfigError, GraycastError
from ..folder import write_whole
from ..frames import rigid
from ..rig import PRESETS, RESOLUTIONS
from ..scanner import Scanner, preset
from ..settings import Settings, check_settings, parse_yaml, read_text
from .reading import build_optics, build_rig, check_rotation, is_file_storage
from .sections import ScannerSections, scanner_of

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
    aperture_m: float = Field(0.0, ge=0, description="Diameter of the pupil; 0 is a pinhole.")
    focus_m: float | None = Field(
        None, gt=0, description="Distance in focus, along the axis; left out: far away."
    )
    psf_px: float = Field(0.0, ge=0, description="Radius of the blur at every distance.")
    natural_vignetting: bool = Field(False, description="Darker towards the corners by cosines.")
    fill_factor: float = Field(1.0, gt=0, le=1, description="Share of a pixel's area that works.")


class RigModel(ScannerSections):
    """A camera and a projector that hold still to each other, and how they measure."""

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
    response: tuple[float, ...] = Field(
        (0.0, 1.0), description="Radiance at equally spaced grey levels, shares of white's."
    )
    contrast_ratio: float | None = Field(
        None, gt=1, description="The projector's white over black; left out: black is black."
    )
    veil: float = Field(0.0, ge=0, lt=1, description="Share of stray light in the camera.")
    speckle_contrast: float = Field(
        0.0, ge=0, le=1, description="At a point of the sensor, of a laser on black; 0 for an LED."
    )
    speckle_volume: float = Field(
        0.0,
        ge=0,
        description="How much less a white surface speckles than a black one; 0: as much.",
    )


def rig_schema() -> dict[str, Any]:
    """JSON Schema of a rig file, from which editors complete."""
    return RigModel.model_json_schema()


def save_scanner(scanner: Scanner, path: Path) -> None:
    """Write a rig file; `load_scanner` gives the same numbers back to the last bit.

    Raises:
        ConfigError: the file cannot be written; a file that was there is left as it was.
    """
    try:
        write_whole(path, scanner_text(scanner).encode())
    except GraycastError as error:
        raise ConfigError(f"the rig {error}") from error


def scanner_text(scanner: Scanner) -> str:
    """What a scanner's rig file holds."""
    rig = scanner.rig
    content = {
        "name": rig.name,
        "camera": _plain(asdict(rig.camera)),
        "projector": _plain(asdict(rig.projector)),
        "R_cam_proj": rig.T_cam_proj[:3, :3].tolist(),
        "t_cam_proj_m": rig.T_cam_proj[:3, 3].tolist(),
    }
    of_light = {f.name for f in fields(rig)} - {"name", "camera", "projector", "T_cam_proj"}
    content |= _plain({f.name: getattr(rig, f.name) for f in fields(rig) if f.name in of_light})
    for section in ScannerSections.model_fields:
        content[section] = _plain(asdict(getattr(scanner, section)))
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)


def load_scanner(path: Path) -> Scanner:
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
    elsewhere = {"R_cam_proj", "t_cam_proj_m", *ScannerSections.model_fields}
    words = model.model_dump(exclude=elsewhere, exclude_none=True)
    for device in ("camera", "projector"):
        words[device] = build_optics(path, device, **words[device])
    T_cam_proj = rigid(R_cam_proj, np.array(model.t_cam_proj_m))
    rig = build_rig(path, T_cam_proj=T_cam_proj, **words)
    try:
        return scanner_of(rig, model)
    except (ConfigError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from error


def resolve_scanner(text: str, *, folder: Path, resolution: str = "low") -> Scanner:
    """The scanner that a configuration means by `rig: text`.

    Args:
        text: a name in `PRESETS`, or a rig file, relative to `folder`.
        folder: where the configuration lies.
        resolution: of a preset; a file states its own.

    Raises:
        ConfigError: neither a preset nor a readable rig file, or no such resolution.
    """
    if resolution not in RESOLUTIONS:
        choices = ", ".join(RESOLUTIONS)
        raise ConfigError(f"resolution: no resolution {resolution!r}: choose one of {choices}")
    if text in PRESETS:
        return preset(text, resolution)
    path = folder / text
    if path.is_file() or "/" in text or Path(text).suffix in (".yaml", ".yml", ".json"):
        return load_scanner(path)
    choices = ", ".join(PRESETS)
    raise ConfigError(f"rig: no rig {text!r}: choose one of {choices}, or name a file in {folder}")


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """What a rig file holds: Python's own numbers, lists; nothing for None and for infinity."""
    plain = {}
    for key, value in values.items():
        if isinstance(value, tuple):
            plain[key] = [v if isinstance(v, str) else float(v) for v in value]
        elif isinstance(value, np.generic):
            plain[key] = value.item()
        elif value is not None and value != math.inf:
            plain[key] = value
    return plain
