"""Variation of scenes, within a cell's tolerances or at random, with a record of the values.

`draw` makes a record of random values, in JSON types, from a cell's `Scene` and a generator. `vary`
makes the scene to drop and render from the cell and the record, without randomness.
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
