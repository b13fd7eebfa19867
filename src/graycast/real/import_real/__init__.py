"""Real pictures with hand-drawn labels as a dataset of the same form as simulated ones."""

from .importing import Import, import_real

__all__ = ["Import", "import_real"]
