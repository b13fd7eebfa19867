"""Stacks of pictures from real scanners: description in YAML, decoding and results.

description      the YAML description of a stack: projector, frames, levels and thresholds
stack_pictures   reading of the pictures as they were stored
levels           offset, saturation and noise of an unknown camera, measured in the stack
frame_groups     groups of frames: a pattern with its inverse, and the steps of a period
white_sums       groups of frames that add up to the same white picture
registration     the motion between two pictures of a scene
motion           warns that camera, projector or scene moved during the stack
brightness       warns of a phase step that is brighter or darker than the others
bit_order        warns of Gray bits in wrong order, or swapped with their inverses
step_order       warns of two exchanged pictures of a period
sense            warns of phases in the opposite direction or from another origin
computed         warns of inverses that were computed and not taken
idle_settings    notes settings that have no effect on the stack
rig_fit          warns of a rig that does not fit the stack
diagnosis        all warnings of a stack, with a measure for each fault
steady           takes the steady motion of a scene back, if asked for
believed_depth   depth without points off their epipolar line, and with filters on request
averaging        one point for all camera pixels that see the same projector pixel
decoding         the whole processing of a stack
stack_figures    quality figures of a decoded stack
stack_sheet      the preview of a decoded stack
products         the files of a decoded stack, and its printed summary
"""

from .averaging import Cells, join_pixels, meet_rays
from .decoding import Cloud, StackResult, decode_stack
from .description import (
    StackDescription,
    code_of,
    describe_code,
    describe_frames,
    describe_stack,
    read_description,
    stack_scanner,
)
from .diagnosis import mirror_symptom
from .idle_settings import unread_settings
from .levels import MeasuredLevels, measure_levels
from .products import CODE, describe_result, write_ply, write_result

__all__ = [
    "CODE",
    "Cells",
    "Cloud",
    "MeasuredLevels",
    "StackDescription",
    "StackResult",
    "code_of",
    "decode_stack",
    "describe_code",
    "describe_frames",
    "describe_result",
    "describe_stack",
    "join_pixels",
    "measure_levels",
    "meet_rays",
    "mirror_symptom",
    "read_description",
    "stack_scanner",
    "unread_settings",
    "write_ply",
    "write_result",
]
