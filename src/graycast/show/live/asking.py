"""What a session asks of the process that makes its pictures, and what comes back."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...cell.config import Config


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """Show this cell. A later one replaces it, whatever has been done of it."""

    number: int
    config: Config
    unturned: Config  # the same where ambient light and projector power are as the file says
    ambient: float
    power: float
    frame: int  # which of the captured frames is looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Something for the page: `header` says what it is, `arrays` are bytes by name."""

    kind: str  # "picture", "stage" or "error"
    number: int
    header: Mapping[str, Any]
    arrays: Mapping[str, bytes]
