"""A folder of picks as a web page that replays it, and as a film."""

from .build import write_pick_report
from .film import write_film

__all__ = ["write_film", "write_pick_report"]
