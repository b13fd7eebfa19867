"""The robustness of a suction grip: the share of random trials in which it seals and holds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.public_value import public_value
from ...base.streams import stream
from .patch import Patch
from .suction import MOST_STRAIN, Cup, load_factor, seals

CARRIED_M_S2 = 0.5 * 9.81  # largest acceleration of a part that the tool carries
SHAKE = 1.5  # At this acceleration, a part pulls with at most 1.5 times its weight.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Doubt:
    """The uncertainties of a grip as standard deviations of normal distributions.

    `position_m` and `angle_rad` are uncertainties of the tool's pose on the part, from calibration,
    robot and part. `friction_share` is relative. `center_m` is for each axis of the centre of mass.
    """

    position_m: float = 1e-3
    angle_rad: float = 0.02
    friction_share: float = 0.15
    center_m: float = 2e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Burden:
    """The load on a tool, in the tool's frame: a weight, its position, and gravity's direction."""

    weight_n: float
    center_m: Float[np.ndarray, "3"]
    down: Float[np.ndarray, "3"]


def robustness(
    cup: Cup, patch: Patch, burdens: Sequence[Burden], doubt: Doubt, *, seed: int, chances: int = 24
) -> float:
    """Return the share of random trials in which the cup seals and holds, the minimum over burdens.

    The first trial is the planned grip. Errors above three standard deviations are clipped to
    three, so that a patch of radius `patch_radius_m` is large enough.
    """
    # The caller may sample places with the same seed, so the trials use another random stream.
    rng = stream(seed, 1)
    off = np.clip(rng.normal(size=(chances, 8)), -3, 3)
    off[0] = 0
    aside_m = doubt.position_m * off[:, :2]
    strain, open_share = seals(cup, patch, aside_m=aside_m, lean=doubt.angle_rad * off[:, 2:4])
    sealed = (open_share == 0) & (strain <= MOST_STRAIN)
    if not sealed.any():
        return 0.0
    friction = cup.friction * np.maximum(1 + doubt.friction_share * off[:, 4], 0.0)
    shift_m = doubt.center_m * off[:, 5:] - np.pad(aside_m, ((0, 0), (0, 1)))
    shares = []
    for burden in burdens:
        force_n = np.tile(SHAKE * burden.weight_n * burden.down, (chances, 1))
        factor = load_factor(
            cup, force_n, np.cross(burden.center_m + shift_m, force_n), friction=friction
        )
        shares.append(np.mean(sealed & (factor >= 1)))
    return float(min(shares))


def patch_radius_m(cup: Cup, doubt: Doubt) -> float:
    """Return the radius of the patch that `robustness` needs."""
    return cup.radius_m + 3 * doubt.position_m
