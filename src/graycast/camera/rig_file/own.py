"""Graycast's own rig file: YAML with exactly the content of a `Scanner`."""

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import Field

from ...base.errors import ConfigError, GraycastError
from ...base.folder import write_whole
from ...base.frames import rigid
from ...base.sections import section_of
from ...base.settings import Settings, check_settings, parse_yaml, read_text
from ...rig.former_names import current_name
from ...rig.optics import Optics
from ...rig.pair import PRESETS, RESOLUTIONS, Rig
from ...rig.shelf import no_rig
from ..scanner import Scanner, preset
from .checks import build_optics, build_rig, check_rotation, is_file_storage
from .scanner_sections import ScannerSections, scanner_of

Row = tuple[float, float, float]


OpticsModel = section_of(
    Optics,
    "OpticsModel",
    module=__name__,
    about="Intrinsics of a camera or projector; the centre of the top-left pixel is (0, 0).",
    base=Settings,
    more={},
)
RigModel = section_of(
    Rig,
    "RigModel",
    module=__name__,
    about="A camera and a projector with fixed relative pose, and how they measure.",
    base=ScannerSections,
    more={
        "camera": (OpticsModel, ...),
        "projector": (OpticsModel, ...),
        "T_cam_proj": None,  # A file has two keys for this transform.
        "R_cam_proj": (
            tuple[Row, Row, Row],
            Field(description="The rotation from projector to camera coordinates, row by row."),
        ),
        "t_cam_proj_m": (
            Row,
            Field(description="The position of the projector in camera coordinates [m]."),
        ),
    },
)


def save_scanner(scanner: Scanner, path: Path | str) -> None:
    """Write a rig file; `load_scanner` returns exactly the same numbers.

    Raises:
        ConfigError: the file cannot be written; an existing file is not changed.
    """
    path = Path(path)
    try:
        write_whole(path, scanner_text(scanner).encode())
    except GraycastError as error:
        raise ConfigError(f"the rig {error}") from error


def scanner_text(scanner: Scanner) -> str:
    """Return the text of a scanner's rig file."""
    rig = scanner.rig
    scanner.named_code()
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


def load_scanner(path: Path | str) -> Scanner:
    """Read a rig file.

    Raises:
        ConfigError: the file is missing or not a rig; the message names file, key and remedy.
    """
    path = Path(path)
    text = read_text(path)
    if is_file_storage(text) or path.suffix.lower() in (".xml", ".npz"):
        raise ConfigError(
            f"{path}: looks like an OpenCV calibration, not a rig file: import it and save the rig"
        )
    content = parse_yaml(text, path)
    model = check_settings(content, RigModel, path)
    words = model.model_dump(exclude=set(ScannerSections.model_fields), exclude_none=True)
    R_cam_proj, t_cam_proj_m = np.array(words.pop("R_cam_proj")), words.pop("t_cam_proj_m")
    check_rotation(R_cam_proj, f"{path}: R_cam_proj")
    for device in ("camera", "projector"):
        words[device] = build_optics(path, device, **words[device])
    T_cam_proj = rigid(R_cam_proj, np.array(t_cam_proj_m))
    rig = build_rig(path, T_cam_proj=T_cam_proj, **words)
    try:
        return scanner_of(rig, model)
    except (ConfigError, ValueError) as error:
        raise ConfigError(f"{path}: {error}") from error


def named_scanner(text: str, *, folder: Path, resolution: str = "low") -> Scanner:
    """Return the scanner that a configuration names by `rig: text`.

    Args:
        text: a name in `PRESETS`, a former name of a preset, or a rig file relative to `folder`.
        folder: the folder of the configuration.
        resolution: resolution of a preset; ignored for a file, which has its own.

    Raises:
        ConfigError: the text names no preset or readable rig file, or the resolution is unknown.
    """
    if resolution not in RESOLUTIONS:
        choices = ", ".join(RESOLUTIONS)
        raise ConfigError(f"resolution: no resolution {resolution!r}: choose one of {choices}")
    text = current_name(text)
    if text in PRESETS:
        return preset(text, resolution)
    path = folder / text
    if path.is_file() or "/" in text or Path(text).suffix in (".yaml", ".yml", ".json"):
        return load_scanner(path)
    raise ConfigError(f"rig: {no_rig(text, folder)}")


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Convert values to plain numbers and lists for YAML; leave out None and infinity."""
    plain = {}
    for key, value in values.items():
        if isinstance(value, tuple):
            plain[key] = [v if isinstance(v, str) else float(v) for v in value]
        elif isinstance(value, np.generic):
            plain[key] = value.item()
        elif value is not None and value != math.inf:
            plain[key] = value
    return plain
