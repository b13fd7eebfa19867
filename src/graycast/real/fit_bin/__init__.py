"""Pose, colours and light of a real bin from views of it when it is empty."""

from ..fitted_config import fitted_text, refuse_existing
from .bending import BentBin, bend_bin, bent_bin
from .bin_views import BinView, empty_view, read_views
from .fitting import (
    BinFit,
    azimuth_of,
    described,
    fit_pose,
    read_frames,
    sections,
    shape_of,
    summary,
    with_bend,
    with_look,
    write_fit,
)
from .look import BinAppearance, Frames, fit_look
from .pose_fit import FaceFit, PoseFit, difference, find_pose, judge, settle
from .registration import register
from .shape import BinShape

__all__ = [
    "BentBin",
    "BinAppearance",
    "BinFit",
    "BinShape",
    "BinView",
    "FaceFit",
    "Frames",
    "PoseFit",
    "azimuth_of",
    "bend_bin",
    "bent_bin",
    "described",
    "difference",
    "empty_view",
    "find_pose",
    "fit_look",
    "fit_pose",
    "fitted_text",
    "judge",
    "read_frames",
    "read_views",
    "refuse_existing",
    "register",
    "sections",
    "settle",
    "shape_of",
    "summary",
    "with_bend",
    "with_look",
    "write_fit",
]
