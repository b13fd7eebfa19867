"""Variation of scenes: within the tolerances of the cell, or drawn at random, and recorded.

The cell's `Scene` and a random generator give a record of drawn values, plain enough for JSON; the
record alone gives the scene that is dropped and rendered.
"""

from .domain_sections import AdaptedSection, DomainSection, RandomizedSection
from .draw import draw
from .named_files import Domain, domain_files, resolve_domain
from .reach import deepest_m
from .vary import Variation, moved_place, vary

__all__ = [
    "AdaptedSection",
    "Domain",
    "DomainSection",
    "RandomizedSection",
    "Variation",
    "deepest_m",
    "domain_files",
    "draw",
    "moved_place",
    "resolve_domain",
    "vary",
]
