"""Real pictures with hand-drawn labels as a dataset of the same form as simulated ones."""

from .importing import Import, import_real
from .pictures import Seen, Shot, find_shots, read_shot

__all__ = ["Import", "Seen", "Shot", "find_shots", "import_real", "read_shot"]
