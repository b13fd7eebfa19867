"""A picture to export, with all that its content depends on; workers receive these values."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..read.stored import StoredScene
from .options import Options


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureJob:
    """A picture, its index in its set, its scanner's rig and settings, and resolved options."""

    scene: StoredScene
    place: int
    taker: Mapping[str, Any]
    options: Options
