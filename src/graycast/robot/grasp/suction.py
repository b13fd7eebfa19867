"""The seal of a suction cup on a surface, and the load that it holds.

The seal follows Mahler et al., "Dex-Net 3.0", ICRA 2018. The cup is a cone of springs whose lip is
pressed onto the surface. It seals if no spring is stretched or compressed by more than a tenth, and
if the surface under the cup is known and has no gaps. The load follows from statics: the vacuum
presses the lip onto the surface. Friction then resists forces across the axis, and the pressure
resists moments because it can be uneven.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ...base.kernels import kernel
from ...base.public_value import public_value
from .patch import Patch

LIP_POINTS = 32  # number of springs along the lip; a groove of half their spacing breaks the seal
MOST_STRAIN = 0.10  # largest strain of a spring in a sealed cup; source: Dex-Net 3.0, section IV


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Cup:
    """A round suction cup."""

    radius_m: Annotated[float, Field(description="The radius of the lip in metres.")] = 0.010
    height_m: Annotated[
        float, Field(description="The height from the lip to the holder of the bellows, in metres.")
    ] = 0.010
    vacuum_pa: Annotated[
        float, Field(description="The pressure of the air minus the pressure in the cup, in Pa.")
    ] = 60e3
    friction: Annotated[
        float, Field(description="The coefficient of friction between lip and part.")
    ] = 0.5

    def __post_init__(self) -> None:
        for name in ("radius_m", "height_m", "vacuum_pa"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be greater than 0")
        if self.radius_m > 0.2:
            raise ValueError(
                f"radius_m is {self.radius_m:g}: this is too large; give metres, not millimetres"
            )
        if self.vacuum_pa > 101_325:
            raise ValueError(
                f"vacuum_pa is {self.vacuum_pa:g}; it can be at most 101325, the air pressure in Pa"
            )
        if not self.friction >= 0:
            raise ValueError(f"friction is {self.friction}; it must be at least 0")

    @property
    def pull_n(self) -> float:
        """Force with which the vacuum pulls on the part."""
        return self.vacuum_pa * math.pi * self.radius_m**2


@dataclass(frozen=True, slots=True, kw_only=True)
class Seal:
    """The state of a cup on a surface.

    `strain` is the largest relative change of a spring's length; NaN if there is no surface under
    the lip. `open_share` is the share of the area under the cup where the surface is missing or
    unknown.
    """

    strain: float
    open_share: float

    @property
    def holds(self) -> bool:
        return self.open_share == 0 and self.strain <= MOST_STRAIN


def seal(cup: Cup, patch: Patch) -> Seal:
    """Return the seal of a cup that is pressed onto a surface along the tool's axis.

    The centre of the lip is at the tool's origin, so only the unevenness of the surface around it
    matters. Blind holes inside the lip do no harm; through holes and unknown areas break the seal.

    Raises:
        ValueError: the patch is smaller than the cup.
    """
    strain, open_share = seals(cup, patch, aside_m=np.zeros((1, 2)), lean=np.zeros((1, 2)))
    return Seal(strain=float(strain[0]), open_share=float(open_share[0]))


def seals(
    cup: Cup,
    patch: Patch,
    *,
    aside_m: Float[np.ndarray, "k 2"],
    lean: Float[np.ndarray, "k 2"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return `strain` and `open_share` of cups that deviate from the tool's axis.

    Args:
        patch: the surface about the tool's axis.
        aside_m: offsets of the cup's centre along x and y.
        lean: small slopes of the lip's plane along x and y.

    Raises:
        ValueError: the patch is smaller than the cup with its offset.
    """
    if np.abs(aside_m).max() + cup.radius_m > patch.reach_m * (1 + 1e-9):
        raise ValueError(f"the patch of {patch.reach_m} m about the axis is smaller than the cup")
    around = 2 * np.pi * np.arange(LIP_POINTS) / LIP_POINTS
    lip_m = cup.radius_m * np.stack([np.cos(around), np.sin(around)], axis=-1)
    strain, open_share = np.empty(len(aside_m)), np.empty(len(aside_m))
    _lay(patch.height_m, patch.step_m, lip_m, cup.height_m, aside_m, lean, strain, open_share)
    return strain, open_share


@kernel()
def _lay(height_m, step_m, lip_m, cup_m, aside_m, lean, strain, open_share):
    radius_m, points = lip_m[0, 0], len(lip_m)
    side = math.hypot(radius_m, cup_m)
    along = np.array([np.linalg.norm(lip_m[0] - lip_m[apart]) for apart in (1, 2)])
    z = np.empty(points)
    for k in range(len(aside_m)):
        for p in range(points):
            z[p] = _between(height_m, (lip_m[p] + aside_m[k]) / step_m)
            z[p] -= lean[k, 0] * lip_m[p, 0] + lean[k, 1] * lip_m[p, 1]
        most = -np.inf
        for p in range(points):
            # Comparisons with NaN are false, so springs over missing depth do not count.
            change = abs(math.hypot(radius_m, z[p] - cup_m) - side) / side
            most = change if change > most else most
            for apart in (1, 2):  # springs along the lip, and springs against its bending
                free = along[apart - 1]
                change = abs(math.hypot(free, z[p] - z[p - apart]) - free) / free
                most = change if change > most else most
        strain[k] = np.nan if most < 0 else most
        missing = np.isnan(z).mean()
        open_share[k] = max(missing, _open_share(height_m, radius_m / step_m, aside_m[k] / step_m))


@kernel()
def _between(height_m, place):
    """Return the height at a place (in grid steps from the centre); NaN outside or at a gap."""
    x, y = place[0] + len(height_m) // 2, place[1] + len(height_m) // 2
    j, i = math.floor(x), math.floor(y)
    if min(i, j) < 0 or max(i, j) >= len(height_m) - 1:
        return np.nan
    u, v = x - j, y - i
    low = (1 - u) * height_m[i, j] + u * height_m[i, j + 1]
    return (1 - v) * low + v * ((1 - u) * height_m[i + 1, j] + u * height_m[i + 1, j + 1])


@kernel()
def _open_share(height_m, radius, about):
    """Return the share of missing nodes in a circle around a place; both are in grid steps."""
    missing, inside, n = 0, 0, len(height_m) // 2
    for y in range(math.ceil(about[1] - radius - 1), math.floor(about[1] + radius + 1) + 1):
        for x in range(math.ceil(about[0] - radius - 1), math.floor(about[0] + radius + 1) + 1):
            far = (x - about[0]) ** 2 + (y - about[1]) ** 2
            if max(abs(x), abs(y)) <= n and far <= (radius * (1 + 1e-9)) ** 2:
                inside += 1
                missing += math.isnan(height_m[y + n, x + n])
    return missing / inside


def load_factor(
    cup: Cup,
    force_n: Float[np.ndarray, "k 3"],
    moment_nm: Float[np.ndarray, "k 3"],
    *,
    friction: Float[np.ndarray, " k"] | None = None,
) -> Float[np.ndarray, " k"]:
    """Return the safety factor of a load on a sealed cup; below 1 the cup loses the part.

    The lip is a ring that presses on the surface with the force N, which is the vacuum's force plus
    the load's force along the axis. There are three limits:

    - pull: N > 0.
    - friction: a force t across the axis and a torque m about it make the ring slide when
      (t / (friction N))^2 + (m / (friction N r))^2 = 1. Source: R. Howe and M. Cutkosky, 1996.
    - tilt: a moment M across the axis lifts one side of a rigid ring when M = N r / 2.

    Args:
        force_n: the force on the part, in the tool's frame.
        moment_nm: the moment of the load about the tool's origin.
        friction: coefficient of friction for each load; the default is the cup's.

    Returns:
        The factor of each load at which the first limit is reached; infinity if none is reached.
    """
    slide_n = np.sqrt(
        force_n[..., 0] ** 2 + force_n[..., 1] ** 2 + (moment_nm[..., 2] / cup.radius_m) ** 2
    )
    tilt_nm = np.hypot(moment_nm[..., 0], moment_nm[..., 1])
    press_n = force_n[..., 2]  # z points away from the part, so a weight under a cup is negative.
    mu = np.full(press_n.shape, cup.friction) if friction is None else friction
    factor = np.full(press_n.shape, np.inf)
    for demand, share in (
        (slide_n, mu),
        (tilt_nm, np.full(press_n.shape, cup.radius_m / 2)),
        (np.zeros(press_n.shape), np.ones(press_n.shape)),
    ):
        slope = demand - share * press_n  # factor * demand <= share * (pull + factor * press)
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.where(slope > 0, share * cup.pull_n / slope, np.inf)
        factor = np.minimum(factor, most)
    return factor
