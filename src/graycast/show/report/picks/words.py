"""Texts and colours of the outcomes of attempts."""

from typing import Any

from ....robot.pick.outcome import BEFORE_MOVING, TAKEN, Outcome

OUTCOME_COLOR = {
    Outcome.PICKED: "#3f9e2f",
    Outcome.TWO_AT_ONCE: "#9cc04a",
    Outcome.LOST_SEAL: "#c8385a",
    Outcome.SLIPPED: "#b0436f",
    Outcome.NOT_HELD: "#e0742e",
    Outcome.MISSED: "#e8a33d",
    Outcome.WRONG_POSE: "#8f5fc0",
    Outcome.COLLISION_UNSEEN: "#5b3fa0",
    Outcome.COLLISION_SEEN: "#5a8fc0",
    Outcome.UNREACHABLE: "#4a6fb0",
    Outcome.GIVEN_UP: "#6b7688",
    Outcome.NOTHING_FOUND: "#9aa3ad",
}
_MEANING = {
    Outcome.PICKED: "the tool took the part out of the bin",
    Outcome.TWO_AT_ONCE: "the tool took another part out of the bin as well",
    Outcome.LOST_SEAL: "the cup lost the part on the way",
    Outcome.SLIPPED: "the jaws lost the part on the way",
    Outcome.NOT_HELD: "the cup did not seal, or the jaws did not close on both sides",
    Outcome.MISSED: "there was no part at the target of the tool",
    Outcome.WRONG_POSE: "the grip did not hold, and the estimated pose of the part was wrong",
    Outcome.COLLISION_UNSEEN: "the tool collided with something that the scanner had not measured",
    Outcome.COLLISION_SEEN: "every grip would hit the measured scene; the robot did not move",
    Outcome.UNREACHABLE: "no grip can be reached without a collision; the robot did not move",
    Outcome.GIVEN_UP: "every grip is at a place where one failed before; the robot did not move",
    Outcome.NOTHING_FOUND: "no part, no pose or no grip was found; the robot did not move",
}


def outcome_words() -> list[dict[str, Any]]:
    """Return the texts and colours of all outcomes, in the order in which pages list them."""
    return [
        {
            "name": str(outcome),
            "color": color,
            "meaning": _MEANING[outcome],
            "taken": outcome in TAKEN,
            "moved": outcome not in BEFORE_MOVING,
        }
        for outcome, color in OUTCOME_COLOR.items()
    ]
