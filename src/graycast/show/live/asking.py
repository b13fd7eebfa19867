"""Messages between a session and the process that makes the session's pictures."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...cell.config import Config


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """A request to show a cell. A later request replaces it, even if it is not finished."""

    number: int
    config: Config
    unturned: Config  # the configuration with unscaled ambient light and projector power
    ambient: float
    power: float
    frame: int  # index of the captured frame to show


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Data for the page: `header` describes the `arrays`, which are bytes by name."""

    kind: str  # such as "picture", "stage", "world" or "error"
    number: int
    header: Mapping[str, Any]
    arrays: Mapping[str, bytes]
