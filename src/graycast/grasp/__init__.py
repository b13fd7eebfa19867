"""Where a part can be gripped: surfaces under a tool, seals of suction cups, what a grip holds."""

from .patch import Patch, patch_of_depth, patch_of_mesh
from .suction import Cup, Load, Seal, load_factor, seal

__all__ = [
    "Cup",
    "Load",
    "Patch",
    "Seal",
    "load_factor",
    "patch_of_depth",
    "patch_of_mesh",
    "seal",
]
