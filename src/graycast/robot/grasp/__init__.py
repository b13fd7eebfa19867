"""Grips of a part: surfaces under a tool, seals of suction cups, and loads that a grip holds."""

from .grip import Grip, best_first
from .jaws import CLEARANCE_M, Jaws, closing, jaw_load_factor, jaw_places
from .known import suction_places
from .patch import Patch, patch_of_depth, patch_of_mesh
from .robust import CARRIED_M_S2, Burden, Doubt, patch_radius_m, robustness
from .suction import Cup, Seal, load_factor, seal
from .unknown import GripEstimate, suction_in_depth

__all__ = [
    "CARRIED_M_S2",
    "CLEARANCE_M",
    "Burden",
    "Cup",
    "Doubt",
    "Grip",
    "GripEstimate",
    "Jaws",
    "Patch",
    "Seal",
    "best_first",
    "closing",
    "jaw_load_factor",
    "jaw_places",
    "load_factor",
    "patch_of_depth",
    "patch_of_mesh",
    "patch_radius_m",
    "robustness",
    "seal",
    "suction_in_depth",
    "suction_places",
]
