"""Import of real pictures with hand-drawn labels as a dataset in the form of simulated ones."""

from .importing import Import, import_real

__all__ = ["Import", "import_real"]
