"""The twin of a scanner one owns: its simulated scans have the statistics of the real ones."""

from .making import check_scans, make_twin
from .twin_files import files_of, summary, write_twin

__all__ = ["check_scans", "files_of", "make_twin", "summary", "write_twin"]
