"""Pose, colours and light of a real bin from views of it when it is empty."""

from .box import OpenBox, open_box
from .fitting import (
    BinFit,
    azimuth_of,
    described,
    fit_pose,
    read_frames,
    sections,
    summary,
    with_look,
    write_fit,
)
from .look import Frames, Look, fit_look
from .reading import Said, View, read_views
from .registration import FaceFit, PoseFit, difference, find_pose, judge, register, settle
from .writing import fitted_text, refuse_existing

__all__ = [
    "BinFit",
    "FaceFit",
    "Frames",
    "Look",
    "OpenBox",
    "PoseFit",
    "Said",
    "View",
    "azimuth_of",
    "described",
    "difference",
    "find_pose",
    "fit_look",
    "fit_pose",
    "fitted_text",
    "judge",
    "open_box",
    "read_frames",
    "read_views",
    "refuse_existing",
    "register",
    "sections",
    "settle",
    "summary",
    "with_look",
    "write_fit",
]
