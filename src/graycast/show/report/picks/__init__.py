"""A folder of picks as a web page that replays it, and as a film."""

from .film import write_film
from .picks_page import write_pick_report

__all__ = ["write_film", "write_pick_report"]
