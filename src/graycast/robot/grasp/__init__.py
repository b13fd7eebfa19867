"""Grips of a part: the surface under a tool, the seal of a suction cup, and the load on a grip."""

from .grip import Grip, best_first
from .jaws import CLEARANCE_M, Jaws, closing, jaw_load_factor, jaw_places
from .patch import Patch, patch_of_depth, patch_of_mesh
from .robust import CARRIED_M_S2, Burden, Doubt, patch_radius_m, robustness
from .suction import Cup, Seal, load_factor, seal
from .suction_grips import DepthView, GripEstimate, SuctionSearch, suction_places

__all__ = [
    "CARRIED_M_S2",
    "CLEARANCE_M",
    "Burden",
    "Cup",
    "DepthView",
    "Doubt",
    "Grip",
    "GripEstimate",
    "Jaws",
    "Patch",
    "Seal",
    "SuctionSearch",
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
    "suction_places",
]
