"""The evidence for and against each depth, and the probability that it is wrong.

frame_fit      contrast of stripes, and misfit of frames to the pattern
neighbours     positions against those around them
mirror_images  mirrored positions, and brighter pixels with the same position
cues           all numbers of a pixel that count as evidence
wrong          from evidence to a probability, and the pixels that are removed
"""

from .cues import CUES, NAMES, Cue, cues_of
from .wrong import TABLE, Evidence, without_doubt, without_doubtful_positions

__all__ = [
    "CUES",
    "NAMES",
    "TABLE",
    "Cue",
    "Evidence",
    "cues_of",
    "without_doubt",
    "without_doubtful_positions",
]
