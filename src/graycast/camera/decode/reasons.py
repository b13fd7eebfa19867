"""Reasons of missing depth: their names, colours and meanings, and their shares of pixels."""

from collections import Counter
from collections.abc import Iterable, Mapping
from enum import IntEnum

import numpy as np
from jaxtyping import UInt8


class Reason(IntEnum):
    """The reason why a pixel has no depth; 0 is a pixel that has depth.

    These functions set it (modules of `camera/decode`; the last one is in `camera/stack`). A pixel
    with a larger probability than `max_p_wrong` gets the reason of the evidence against it, from
    `evidence/wrong.py`, `spoken_against`.

        SHADOW             positions._judge_row
        LOW_MODULATION     positions._judge_row
        SATURATED          bits.lose_bits, phases.lose_phases, positions._judge_row
        CONTRADICTORY      bits._weigh_doubts, positions._count
        INTERREFLECTION    bits._weigh_doubts, phases.count_by_gray, positions._count,
                           positions._judge_row
        OUTSIDE_PROJECTOR  positions._outside, triangulation.triangulate
        OUT_OF_RANGE       triangulation.triangulate
        OUTLIER            triangulation.triangulate, filters._filter_surfaces,
                           visibility.without_hidden, believed_depth.less_outliers
    """

    DECODED = 0
    SHADOW = 1
    LOW_MODULATION = 2
    SATURATED = 3
    CONTRADICTORY = 4
    INTERREFLECTION = 5
    OUTSIDE_PROJECTOR = 6
    OUT_OF_RANGE = 7
    OUTLIER = 8

    @property
    def color(self) -> str:
        """Colour of the reason in all maps of reasons."""
        return _APPEARANCE[self][0]

    @property
    def meaning(self) -> str:
        """Explanation of the reason on web pages."""
        return _APPEARANCE[self][1]

    @property
    def label(self) -> str:
        """Name of the reason in figures and files."""
        return self.name.lower()

    @property
    def words(self) -> str:
        return self.label.replace("_", " ")


# With a rig, a pixel with one of these reasons has a position in the projector's picture.
POSITIONED = (Reason.DECODED, Reason.OUT_OF_RANGE, Reason.OUTLIER)

_APPEARANCE = {
    Reason.DECODED: ("#dcdad2", "there is a depth"),
    Reason.SHADOW: (
        "#25283d",
        "the projector does not reach the pixel: the frames differ only by noise",
    ),
    Reason.LOW_MODULATION: ("#6b6e87", "the projector's light is too weak to be decoded reliably"),
    Reason.SATURATED: ("#f2b134", "bits or phases are lost because the sensor saturates"),
    Reason.CONTRADICTORY: (
        "#c8385a",
        "the bits or phases do not fit any single projector position",
    ),
    Reason.INTERREFLECTION: (
        "#e07b39",
        "coarse and fine code contradict each other, or stripes lack contrast: "
        "usually indirect light",
    ),
    Reason.OUTSIDE_PROJECTOR: (
        "#3b8ea5",
        "the code is outside of the projector's picture, or everything that the pixel could see in "
        "the working range is",
    ),
    Reason.OUT_OF_RANGE: ("#7d5ba6", "the depth is outside of the rig's working range"),
    Reason.OUTLIER: ("#4f9d69", "the point is off its epipolar line, or a filter removed it"),
}
REASON_COLOR = {reason.label: reason.color for reason in Reason}


def reason_counts(reason: UInt8[np.ndarray, "*pixels"]) -> dict[str, int]:
    """Return the number of pixels with each reason."""
    return {known.label: int((reason == known).sum()) for known in Reason}


def reason_shares(reason: UInt8[np.ndarray, "*pixels"]) -> dict[str, float]:
    """Return the share of pixels with each reason; empty without pixels."""
    return pooled_shares([reason_counts(reason)])


def pooled_shares(counts: Iterable[Mapping[str, int]]) -> dict[str, float]:
    """Return the share of each reason among the pixels of all pictures; empty without pixels.

    Every summary, table and page reports the share `decoded` of the parts' visible pixels. Each
    picture has the weight of its pixels, so this is not the mean of the pictures' shares.

    Args:
        counts: `reason_counts` of each picture.
    """
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    pixels = total.total()
    return {name: count / pixels for name, count in total.items()} if pixels else {}


LITTLE_DEPTH = 0.5  # With less depth on the parts, a detector learns holes. This is our choice.


def little_depth_note(of_parts: Mapping[str, float]) -> str:
    """Return a note with the main reason if fewer than half of the parts' pixels have depth."""
    if "decoded" not in of_parts or of_parts["decoded"] >= LITTLE_DEPTH:
        return ""
    missing = {reason: of_parts.get(reason.label, 0.0) for reason in Reason if reason}
    main = max(missing, key=lambda reason: missing[reason])
    return (
        f"{of_parts['decoded']:.1%} of the parts' pixels have depth; the main reason of missing "
        f"depth is {main.words} ({missing[main]:.1%})"
    )
