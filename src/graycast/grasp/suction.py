"""Does a suction cup seal on a surface, and what does it hold there?

The seal follows Mahler et al., "Dex-Net 3.0", ICRA 2018: the cup is a cone of springs whose lip is
laid on the surface; it seals where no spring is stretched or pressed by more than a tenth, and
where nothing under the cup is open or unknown. The load follows from statics: the vacuum presses
the lip on the surface, and that pressure carries forces across by friction and moments by its
uneven spread.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .patch import Patch

LIP_POINTS = 32  # springs round the lip: a groove of half their length opens the seal
MOST_STRAIN = 0.10  # of a spring in a cup that seals. Source: Dex-Net 3.0, section IV


@dataclass(frozen=True, slots=True, kw_only=True)
class Cup:
    """A round suction cup.

    `height_m` is from the lip to where the bellows are held. `vacuum_pa` is how far the pressure
    inside lies below the air's. `friction` is between lip and part.
    """

    radius_m: float = 0.010
    height_m: float = 0.010
    vacuum_pa: float = 60e3
    friction: float = 0.5

    def __post_init__(self) -> None:
        for name in ("radius_m", "height_m", "vacuum_pa"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be above 0")
        if self.radius_m > 0.2:
            raise ValueError(f"radius_m is {self.radius_m:g}: a cup is smaller; give metres")
        if self.vacuum_pa > 101_325:
            raise ValueError(f"vacuum_pa is {self.vacuum_pa:g}; air presses with 101325 Pa at most")
        if not self.friction >= 0:
            raise ValueError(f"friction is {self.friction}; it is 0 or more")

    @property
    def pull_n(self) -> float:
        """What the vacuum pulls with."""
        return self.vacuum_pa * math.pi * self.radius_m**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Seal:
    """How a cup lies on a surface.

    `strain` is the largest change of a spring's length, as a share of it; NaN where the lip has
    nothing to lie on. `open_share` is the share of the ground under the cup where no surface is, or
    none is known.
    """

    strain: float
    open_share: float

    @property
    def holds(self) -> bool:
        return self.open_share == 0 and self.strain <= MOST_STRAIN


def seal(cup: Cup, patch: Patch) -> Seal:
    """Lay a cup on a surface, its lip along the tool's axis from above.

    The lip's middle is held at the tool's origin, so what matters is how uneven the surface is
    about it. Blind holes within the lip do no harm; holes through and unknown ground do.

    Raises:
        ValueError: the patch is smaller than the cup.
    """
    if (len(patch.height_m) // 2) * patch.step_m < cup.radius_m:
        raise ValueError(f"the patch is smaller than the cup's radius of {cup.radius_m} m")
    inside = patch.within(cup.radius_m)
    around = 2 * np.pi * np.arange(LIP_POINTS) / LIP_POINTS
    free = cup.radius_m * np.stack([np.cos(around), np.sin(around)], axis=-1)
    height_m = patch.at(free)
    missing = np.isnan(height_m).mean()
    open_share = float(max(np.isnan(inside).mean(), missing))
    if missing == 1:
        return Seal(strain=math.nan, open_share=open_share)
    lip = np.concatenate([free, height_m[:, None]], axis=1)
    flat = np.concatenate([free, np.zeros((LIP_POINTS, 1))], axis=1)
    top = np.array([0.0, 0.0, cup.height_m])
    strains = [_strain(lip - top, flat - top)]
    for apart in (1, 2):  # along the lip, and against bending it
        strains.append(_strain(lip - np.roll(lip, apart, 0), flat - np.roll(flat, apart, 0)))
    return Seal(strain=float(np.nanmax(strains)), open_share=open_share)


def _strain(now: Float[np.ndarray, "n 3"], free: Float[np.ndarray, "n 3"]) -> float:
    """The largest change in length; springs beside missing ground are left out."""
    length = np.linalg.norm(free, axis=1)
    change = np.abs(np.linalg.norm(now, axis=1) - length) / length
    return float(np.nanmax(change)) if np.isfinite(change).any() else math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """A force [N] that pulls at a part in a point [m], both in the tool's frame."""

    force_n: Float[np.ndarray, "3"]
    point_m: Float[np.ndarray, "3"]


def load_factor(cup: Cup, load: Load) -> float:
    """How many times the load a sealed cup holds; below 1 it lets go.

    The lip is a ring that is pressed on the surface with N: the vacuum's pull and what the load
    adds along the axis. Three limits, each met first by some load:

    - pull: N > 0.
    - friction: a force t across and a torque m about the axis slide the ring where
      (t / (friction N))^2 + (m / (friction N r))^2 = 1. Source: R. Howe and M. Cutkosky, 1996.
    - tilt: a moment M across the axis lifts one side of a rigid ring where M = N r / 2.

    Returns:
        The largest factor of the load at which all three hold; infinity where no load is too much.
    """
    force = load.force_n
    moment = np.cross(load.point_m, force)
    slide_n = math.hypot(float(force[0]), float(force[1]), float(moment[2]) / cup.radius_m)
    tilt_nm = math.hypot(float(moment[0]), float(moment[1]))
    press_n = float(
        force[2]
    )  # the axis points away from the part, so weight under a cup is below 0
    factors = []
    for demand, share in ((slide_n, cup.friction), (tilt_nm, cup.radius_m / 2), (0.0, 1.0)):
        slope = demand - share * press_n  # factor * demand <= share * (pull + factor * press)
        factors.append(share * cup.pull_n / slope if slope > 0 else math.inf)
    return min(factors)
