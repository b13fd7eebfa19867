"""What the page calls the ends of attempts, and their colours."""

from typing import Any

from ...pick.outcome import BEFORE_MOVING, TAKEN, Outcome

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
    Outcome.PICKED: "the part has left the bin with the tool",
    Outcome.TWO_AT_ONCE: "another part has left the bin with it",
    Outcome.LOST_SEAL: "the cup let go on the way",
    Outcome.SLIPPED: "the jaws let go on the way",
    Outcome.NOT_HELD: "the cup did not seal, or the jaws did not close on both sides",
    Outcome.MISSED: "nothing was where the tool went",
    Outcome.WRONG_POSE: "it did not hold, and the pose of the part was wrong",
    Outcome.COLLISION_UNSEEN: "the tool pushed into something that the scanner did not show",
    Outcome.COLLISION_SEEN: "every grip would push the tool into what was measured; no motion",
    Outcome.UNREACHABLE: "no joint angles, or no free way, to any grip; no motion",
    Outcome.GIVEN_UP: "every grip is where one has failed before; no motion",
    Outcome.NOTHING_FOUND: "no part, no pose or no place that the tool would hold; no motion",
}


def outcome_words() -> list[dict[str, Any]]:
    """Of every outcome, in the order of the list that pages show."""
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
