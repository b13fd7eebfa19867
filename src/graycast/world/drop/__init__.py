"""Simulation of parts that fall into the bin until they rest, and of a tool that lifts one out."""

from .body import Body, parts_outside
from .decomposition import Decomposition, prepare
from .lift import Hold, Lift, lift
from .rest import simulate
from .settle import PARTS_MAX, DropLimits, drop, flaws, hull_notes, make_bodies

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
    "simulate",
]
