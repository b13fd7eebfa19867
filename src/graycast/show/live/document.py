"""The state of a live session: the text of a configuration, and a few separate adjustments.

Ambient light and changes of the rig have no single key in a configuration. They are stored here and
are converted when a picture is requested: to scaled radiances, and to a rig file of the session.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...base.errors import ConfigError
from ...base.frames import axis_rotation
from ...base.settings import check_settings
from ...camera.decode import triangulation_axis
from ...camera.rig_file import named_scanner, scanner_text
from ...cell.config import Config
from ...rig.pair import Rig


@dataclass(frozen=True, slots=True, kw_only=True)
class RigChange:
    """Changes of a rig: two factors, and an angle that is added to the toe-in."""

    power: float = 1.0  # factor of the projector's power
    baseline: float = 1.0
    toe_in_deg: float = 0.0

    def __post_init__(self) -> None:
        for name in ("power", "baseline"):
            if not 0 < getattr(self, name) <= 1000:
                raise ConfigError(
                    f"rig.{name} is {getattr(self, name)}: give a factor greater than 0 and at "
                    "most 1000"
                )
        if not -60 <= self.toe_in_deg <= 60:
            raise ConfigError(f"rig.toe_in_deg is {self.toe_in_deg}: give degrees from -60 to 60")


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """One state of a session; it is immutable, so that undo can return to an earlier state."""

    content: Mapping[str, Any]  # the content of the YAML file
    ambient: float = 1.0  # factor of the radiances of the environment and of all lamps
    rig: RigChange = field(default_factory=RigChange)

    def __post_init__(self) -> None:
        if not 0 <= self.ambient <= 1000:
            raise ConfigError(f"ambient is {self.ambient}: give a factor from 0 to 1000")


def changed(document: Document, key: str, value: Any) -> Document:
    """Return the document with a new value; None removes a key, so that its default applies.

    Args:
        key: `ambient`, a field of `RigChange` after `rig.`, or a key of the configuration in
            dotted form, such as `exposure.target` or `parts.0.material`.

    Raises:
        ConfigError: the configuration has no such key, or a factor is out of its range.
    """
    try:
        if key == "ambient":
            return replace(document, ambient=float(1.0 if value is None else value))
        if key.startswith("rig."):
            name = key.removeprefix("rig.")
            if name not in RigChange.__dataclass_fields__:
                known = ", ".join(RigChange.__dataclass_fields__)
                raise ConfigError(f"the key {key} does not exist: the keys are {known}")
            number = getattr(RigChange(), name) if value is None else float(value)
            return replace(document, rig=replace(document.rig, **{name: number}))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{key} is {value!r}: give a number") from error
    content = deepcopy(dict(document.content))
    _put(content, key, value)
    return replace(document, content=content)


def _put(content: dict[str, Any], key: str, value: Any) -> None:
    *way, last = key.split(".")
    node: Any = content
    for step in way:
        if isinstance(node, list):
            node = _item(node, step, key)
        else:
            if not isinstance(node.get(step), dict | list):
                node[step] = {}
            node = node[step]
    if isinstance(node, list):
        _item(node, last, key)
        node[int(last)] = value
    elif value is None:
        node.pop(last, None)
    else:
        node[last] = value


def _item(node: list[Any], step: str, key: str) -> Any:
    if not step.isdecimal() or int(step) >= len(node):
        raise ConfigError(f"{key}: the list has {len(node)} entries, and {step} is not one of them")
    return node[int(step)]


def checked(document: Document, path: Path) -> Config:
    """Return the document's configuration, without the separate adjustments.

    Raises:
        ConfigError: see `load_config`; the error names the file.
    """
    return check_settings(document.content, Config, path)


def files_of(
    document: Document, path: Path, *, rig_name: str
) -> tuple[Mapping[str, Any], str | None]:
    """Return the files of a document: a configuration, and the text of a rig file if needed.

    Args:
        path: the configuration's file; relative paths refer to its folder.
        rig_name: the name of the document's own rig file in the configuration.

    Raises:
        ConfigError: the configuration is invalid, or the rig cannot be read or changed like this.
    """
    config = checked(document, path)
    content = deepcopy(dict(document.content))
    if document.ambient != 1:
        content["light"] = _brightened(config, document.ambient)
    if document.rig == RigChange():
        return content, None
    named = named_scanner(config.rig, folder=path.parent, resolution=config.resolution)
    try:
        turned = replace(named, rig=turned_rig(named.rig, document.rig))
    except ValueError as error:
        raise ConfigError(f"{path}: rig: {error}") from error
    content["rig"] = rig_name
    content.pop("resolution", None)  # The rig file states the resolution.
    return content, scanner_text(turned)


def _brightened(config: Config, factor: float) -> dict[str, Any]:
    light = config.light.model_dump(mode="json", exclude_none=True)
    for source in (light["environment"], *light["lamps"]):
        source["radiance"] = [factor * value for value in source["radiance"]]
    return light


def turned_rig(rig: Rig, change: RigChange) -> Rig:
    """Return the rig with a brighter projector, a scaled baseline and a larger toe-in.

    Raises:
        ValueError: the baseline is zero, or longer than allowed.
    """
    across = 0 if triangulation_axis(rig) == "column" else 1
    side = 1.0 if rig.T_cam_proj[across, 3] >= 0 else -1.0
    # A positive rotation about y turns the axis towards +x; one about x turns it towards -y.
    sense = -side if across == 0 else side
    T_cam_proj = rig.T_cam_proj.copy()
    turn = axis_rotation("xy"[1 - across], sense * np.radians(change.toe_in_deg))
    if change.toe_in_deg:
        T_cam_proj[:3, :3] = T_cam_proj[:3, :3] @ turn
    T_cam_proj[:3, 3] *= change.baseline
    return replace(rig, T_cam_proj=T_cam_proj, intensity_w_sr=rig.intensity_w_sr * change.power)


def document_text(content: Mapping[str, Any]) -> str:
    """Return a configuration as YAML."""
    return yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=100)
