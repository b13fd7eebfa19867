"""Scans of which no twin can be made."""

from collections.abc import Sequence

from ...base.errors import GraycastError
from ..realism import DepthScan
from ..realism.depth_steps import count_steps

_LEAST_JUMPS = 20  # Fewer jumps per map do not show which side is in shadow.
_MOST_SHARE = 0.25  # A side is in shadow if its jumps are at most this share of the other side's.


def refuse_without_shadow(scans: Sequence[DepthScan]) -> None:
    """See that depth has a shadow side, as one camera and one projector make it.

    Where a near surface hides a far one from the projector the far one has no depth, so between
    valid neighbours depth never falls off on the side away from the projector. Two cameras that
    match, and a camera beside its light, have jumps on both sides alike.

    Raises:
        GraycastError: there is no such side, or too little in the scans to tell.
    """
    counts = [count_steps(scan) for scan in scans]
    right, left, below, above = (
        sum(getattr(c, f"{side}_farther") for c in counts) / len(counts)
        for side in ("right", "left", "below", "above")
    )
    pairs = {"right and left": (right, left), "below and above": (below, above)}
    shares = {
        name: min(pair) / max(pair) for name, pair in pairs.items() if max(pair) >= _LEAST_JUMPS
    }
    if not shares:
        raise GraycastError(
            f"the scans have {max(right, left, below, above):.0f} depth steps per map, which are "
            f"too few to identify the kind of scanner (at least {_LEAST_JUMPS} are needed): give "
            "scans with parts that stand out"
        )
    if min(shares.values()) > _MOST_SHARE:
        raise GraycastError(
            "the scans have no shadow side: of the depth steps between valid neighbours "
            f"{right:.0f} a map fall to the right, {left:.0f} to the left, {below:.0f} downwards "
            f"and {above:.0f} upwards. Such scans are typical of active stereo and time of "
            "flight. A twin needs structured light, where one direction has almost no such "
            "steps: give raw scans of a structured-light scanner, or use another simulator"
        )
