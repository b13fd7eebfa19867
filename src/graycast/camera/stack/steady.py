"""Take back the steady motion of a scene during a stack."""

from dataclasses import replace

import numpy as np

from ...base.progress import ProgressMeter
from ...rig.pair import Rig
from ...rig.pattern import Code
from ..decode import Levels, steady_motion, steady_transforms, take_back
from .stack_pictures import StackPictures

Motion = tuple[float, float, float]


def taken_back(
    pictures: StackPictures,
    code: Code,
    rig: Rig,
    levels: Levels,
    *,
    start_m: Motion,
    progress: ProgressMeter,
) -> tuple[StackPictures, Motion]:
    """Return the pictures of a scene at rest, and its motion from picture to picture [m].

    Args:
        start_m: the assumed motion, from which the search starts; see `steady_motion`.
    """
    time = np.arange(len(code.frames)) - float(_middle(pictures))
    first_m = np.array(start_m)
    motion_m = steady_motion(pictures.frames, code, rig, time, start_m=first_m, progress=progress)
    T_then_now, top_dn = steady_transforms(motion_m, time), levels.saturation_dn
    frames = take_back(
        pictures.frames, code, rig, T_then_now, saturation_dn=top_dn, progress=progress
    )
    x_m, y_m, z_m = motion_m.tolist()
    return replace(pictures, frames=frames), (x_m, y_m, z_m)


def describe_steady(
    pictures: StackPictures, motion_m: Motion | None, *, max_p_wrong: float
) -> list[str]:
    """Return notes about the motion, the picture of the depth and its check; none at rest."""
    if motion_m is None:
        return []
    x_mm, y_mm, z_mm = (1e3 * length_m for length_m in motion_m)
    middle = _middle(pictures)
    unchecked = [
        "moved pictures give more wrong depth than those of a scene at rest: to remove it, set "
        "max_p_wrong in the section decode of the stack file, for instance to 0.05"
    ]
    return [
        f"the scene moves by ({x_mm:.3f}, {y_mm:.3f}, {z_mm:.3f}) mm from picture to picture, "
        f"along x, y and z of the camera; depth is that of picture {middle + 1} "
        f"({pictures.files[middle].name})",
        *(unchecked if max_p_wrong == 1 else []),
    ]


def _middle(pictures: StackPictures) -> int:
    return len(pictures.files) // 2
