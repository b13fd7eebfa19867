"""A web page that replays a folder of picks."""

from .picks_page import write_pick_report

__all__ = ["write_pick_report"]
