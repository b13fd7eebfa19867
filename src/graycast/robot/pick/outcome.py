"""The possible outcomes of an attempt to pick a part, and the record of an attempt."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float


class Outcome(StrEnum):
    """The outcome of a scan and its grip. With the first four, the arm does not move."""

    NOTHING_FOUND = "nothing found"  # There is no part, no pose, or no place where a tool holds.
    COLLISION_SEEN = "collision seen"  # Every grip would push the tool into the measured heap.
    UNREACHABLE = "unreachable"  # There are no joint angles, or there is no collision-free path.
    GIVEN_UP = "given up"  # Every grip is near a failed one.
    PICKED = "picked"
    TWO_AT_ONCE = "two at once"  # Another part left the bin together with the target.
    MISSED = "missed"  # The tool touched nothing.
    WRONG_POSE = "wrong pose"  # The error of the pose was above `WRONG_RAD` or `WRONG_M`.
    NOT_HELD = "not held"  # The cup did not seal, or the jaws did not close on both sides.
    COLLISION_UNSEEN = "collision unseen"  # The tool hit something that the scan did not show.
    LOST_SEAL = "lost seal"  # A cup lost its part on the way.
    SLIPPED = "slipped"  # Jaws lost their part on the way.


BEFORE_MOVING = (
    Outcome.NOTHING_FOUND,
    Outcome.COLLISION_SEEN,
    Outcome.UNREACHABLE,
    Outcome.GIVEN_UP,
)
# With these outcomes, the tool took the part out of the bin.
TAKEN = (Outcome.PICKED, Outcome.TWO_AT_ONCE)
# A pose with a larger error is wrong; the error is the smallest over the part's symmetries.
WRONG_RAD, WRONG_M = np.radians(10.0), 5e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """A scan and the result of its grip, if there was one.

    Attributes:
        outcome: the outcome of the attempt.
        detail: more about the outcome in words, or an empty string.
        T_world_part: true poses of all parts before the grip.
        present: numbers of the parts that were in the bin before the grip.
        part: number of the part that the tool touched; None if it touched none.
        kind: the assumed kind of the part, an index among the cell's parts; None if unknown.
        score: score of the grip.
        T_world_tool: planned pose of the tool's tip.
        opening_m: opening of the jaws for the grip; None for a suction cup.
        pose_error: error of the estimated pose of the part: angle [rad] and distance [m].
        least_factor: the smallest safety factor of the load on the way.
        lost_s: time from the start of the lift to the loss of the part; None if it was not lost.
        seconds: simulated times of `scan` and `motion`.
        work_s: computing time of each stage on this machine, which differs from run to run.
        time_s, q: times [s] and joint angles [rad] of the arm's motion.
        targets: number of detections.
    """

    outcome: Outcome
    T_world_part: Float[np.ndarray, "n 4 4"]
    present: tuple[int, ...]
    targets: int
    seconds: dict[str, float]
    work_s: dict[str, float]
    detail: str = ""
    part: int | None = None
    kind: int | None = None
    score: float | None = None
    T_world_tool: Float[np.ndarray, "4 4"] | None = None
    opening_m: float | None = None
    pose_error: tuple[float, float] | None = None
    least_factor: float | None = None
    lost_s: float | None = None
    time_s: Float[np.ndarray, " t"] | None = None
    q: Float[np.ndarray, "t joints"] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the record for JSON, without the motion and without `work_s`."""
        return {
            "outcome": str(self.outcome),
            "detail": self.detail,
            "targets": self.targets,
            "part": self.part,
            "kind": self.kind,
            "score": self.score,
            "T_world_tool": None if self.T_world_tool is None else self.T_world_tool.tolist(),
            "opening_m": self.opening_m,
            "pose_error": None
            if self.pose_error is None
            else {"angle_rad": self.pose_error[0], "distance_m": self.pose_error[1]},
            "least_factor": None if self.least_factor == np.inf else self.least_factor,
            "lost_s": self.lost_s,
            "seconds": self.seconds,
            "present": list(self.present),
            "T_world_part": self.T_world_part.tolist(),
        }
