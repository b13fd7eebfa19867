"""A folder of picks as a web page that replays it."""

from .picks_page import write_pick_report

__all__ = ["write_pick_report"]
