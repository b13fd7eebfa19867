"""Detect motion during a stack: of the camera, the projector, or the scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .white_sums import Displacement, WhiteSum, displacements

LEAST_PX = 0.08  # Smallest motion [px of the compared pictures]; healthy stacks have 0.025 at most.
SURE_SIGMAS = 5.0  # A motion must be at least this many times its sigma.
SPREAD = 6.0  # A jump must be at least this many times the median deviation of all motions.
EXPLAINS_PX = 0.5  # A motion this large makes correct frames and rigs look wrong.
MOST_NAMED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A sudden motion between the frames `before` and `after`, minus the steady motion."""

    before: int
    after: int
    x_px: float
    y_px: float

    @property
    def length_px(self) -> float:
        """Length of the motion [px]."""
        return float(np.hypot(self.x_px, self.y_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class StackMotion:
    """The motion in a stack: jumps, the length of steady motion, and the extent of uneven motion.

    A length is 0 if there is no such motion.
    """

    jumps: tuple[Jump, ...] = ()
    steady_px: float = 0.0
    uneven_px: float = 0.0

    @property
    def explains(self) -> bool:
        """Whether the motion alone can make frames contradict, or make the right rig look wrong."""
        lengths_px = (self.steady_px, self.uneven_px, *(jump.length_px for jump in self.jumps))
        return max(lengths_px) >= EXPLAINS_PX


def stack_motion(sums: Sequence[WhiteSum]) -> StackMotion:
    """Return the motion between the white sums of a stack.

    The median motion is steady; a motion far from it is a jump. A jump within a white sum moves
    this sum by a part and the next one by the rest, so two jumps in a row in the same direction are
    joined. If half of the motions or more are far from the median, because the camera shakes or
    creeps during half of the stack, then the median is no steady motion, and no motion is much
    larger than the others: the motion is uneven.
    """
    steps = displacements(sums)
    if not steps:
        return StackMotion()
    scale = sums[0].scale
    motion_px = np.array([(s.motion.x_px, s.motion.y_px) for s in steps])
    sigma_px = np.array([s.motion.sigma_px for s in steps])
    median_px = np.median(motion_px, axis=0) if len(steps) > 2 else np.zeros(2)
    off_px = np.linalg.norm(motion_px - median_px, axis=1)
    usual_px = float(np.median(off_px)) if len(steps) > 2 else 0.0
    limit_px = np.maximum(SURE_SIGMAS * sigma_px, max(LEAST_PX * scale, SPREAD * usual_px))
    jumps: list[Jump] = []
    for k in np.flatnonzero(off_px > limit_px):
        x_px, y_px = motion_px[k] - median_px
        before, after = _between(steps[k])
        if jumps and k and off_px[k - 1] > limit_px[k - 1]:
            last = jumps[-1]
            if last.x_px * x_px + last.y_px * y_px > 0:
                inside = steps[k].before
                before, after = min(inside), max(inside)
                x_px, y_px = x_px + last.x_px, y_px + last.y_px
                jumps.pop()
        jumps.append(Jump(before=before, after=after, x_px=float(x_px), y_px=float(y_px)))
    sigma_of_median_px = float(np.median(sigma_px)) / np.sqrt(len(steps)) + usual_px
    steady_px = float(np.linalg.norm(median_px))
    if steady_px < max(SURE_SIGMAS * sigma_of_median_px, LEAST_PX * scale):
        steady_px = 0.0
    uneven = usual_px > max(SURE_SIGMAS * float(np.median(sigma_px)), LEAST_PX * scale)
    return StackMotion(
        jumps=tuple(jumps),
        steady_px=steady_px * len(steps),
        uneven_px=_extent_px(motion_px) if uneven and not steady_px else 0.0,
    )


def _extent_px(motion_px: Float[np.ndarray, "n 2"]) -> float:
    """Return the diagonal of the bounding box of all positions of the picture."""
    place_px = np.concatenate([np.zeros((1, 2)), np.cumsum(motion_px, axis=0)])
    return float(np.linalg.norm(np.ptp(place_px, axis=0)))


def _between(step: Displacement) -> tuple[int, int]:
    """Return the frames between which a motion happened; the outermost of interlaced groups."""
    last, first = max(step.before), min(step.after)
    if last < first:
        return last, first
    if max(step.after) < min(step.before):
        return max(step.after), min(step.before)
    both = (*step.before, *step.after)
    return min(both), max(both)


def describe_motion(motion: StackMotion, names: Sequence[str]) -> list[str]:
    """Return a warning for each motion; `names` has the names of the pictures."""
    remedy = "fasten camera, projector and scene, and take the stack again"
    warnings = [
        f"the picture moved by {jump.length_px:.1f} px between pictures {jump.before + 1} and "
        f"{jump.after + 1} ({names[jump.before]}, {names[jump.after]}): {remedy}"
        for jump in motion.jumps[:MOST_NAMED]
    ]
    if len(motion.jumps) > MOST_NAMED:
        more = len(motion.jumps) - MOST_NAMED
        warnings.append(f"the picture moved {more} more times in the course of the stack: {remedy}")
    if motion.steady_px:
        warnings.append(
            f"the picture moves steadily, by {motion.steady_px:.1f} px from the first pictures to "
            f"the last: {remedy}"
        )
    if motion.uneven_px:
        warnings.append(
            "the picture moves during most of the stack, and not evenly: its places are up to "
            f"{motion.uneven_px:.1f} px apart: {remedy}"
        )
    return warnings
