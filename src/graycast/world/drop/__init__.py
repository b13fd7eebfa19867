"""Simulation of parts that fall into the bin until they rest.

Also simulates a tool that lifts a part out of the heap, and a jolt of the bin.
"""

from .body import Body, parts_outside
from .decomposition import Decomposition, prepare
from .lift import Hold, Lift, lift
from .rest import resettle, simulate
from .settle import PARTS_MAX, DropLimits, drop, flaws, hull_notes, make_bodies
from .shake import shake

__all__ = [
    "PARTS_MAX",
    "Body",
    "Decomposition",
    "DropLimits",
    "Hold",
    "Lift",
    "drop",
    "flaws",
    "hull_notes",
    "lift",
    "make_bodies",
    "parts_outside",
    "prepare",
    "resettle",
    "shake",
    "simulate",
]
