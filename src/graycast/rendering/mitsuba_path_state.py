"""The state of the paths from the camera.

Imported only by the other Mitsuba files, after a variant was set.
"""

from dataclasses import dataclass

import mitsuba as mi

from ..rig.pattern import Axis
from .mitsuba_caustics import Caustics


@dataclass
class Paths:
    """One path and its pixel's sums per lane: the state of the loop."""

    rng: mi.PCG32
    offset: list[mi.Point2f]  # of the pixel's sample sequences
    sample: mi.UInt32
    vertex: mi.UInt32  # of the path
    alive: mi.Bool  # the path has a next vertex
    throughput: mi.Color3f
    origin: mi.Point3f
    direction: mi.Vector3f
    last_pdf: mi.Float  # of the direction that led here
    last_p: mi.Point3f
    last_n: mi.Normal3f
    spread: mi.Float  # radius of what the vertex stands for [m]
    pattern: list[mi.Float]
    white: mi.Color3f
    ambient: mi.Color3f
    albedo: mi.Color3f
    straight: mi.Float  # light straight from the projector
    placed: mi.Point2f  # that light times its places in the projector's picture
    # By axis: what interreflected light adds to the finest pattern beyond its mean; its squares.
    stray: dict[Axis, mi.Float]
    stray2: dict[Axis, mi.Float]
    odds: mi.Float  # that a path from the projector finds this one, over those of this kind
    passed: mi.UInt32 | None = None  # how often solid glass has sent it on, where there is glass

    def add(self, caustics: Caustics) -> None:
        """The light of the paths from the projector."""
        self.white += caustics.white
        for k, light in enumerate(caustics.pattern):
            self.pattern[k] += light
        for axis, squares in caustics.stray2.items():
            self.stray2[axis] += squares
