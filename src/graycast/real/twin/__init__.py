"""Fit of a simulated scanner whose scans have the statistics of a user's real scans."""

from .making import check_scans, make_twin
from .twin_files import files_of, summary, write_twin

__all__ = ["check_scans", "files_of", "make_twin", "summary", "write_twin"]
