"""A folder of picks as a web page that replays it, and as a film."""

from .build import write_pick_report

__all__ = ["write_pick_report"]
