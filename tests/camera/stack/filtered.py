"""A check that filters of a preset do not change the depth of the pixels that they keep."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from graycast.camera.decode import DepthMap, FilterSpec, Reason
from graycast.camera.scanner import preset
from graycast.camera.stack import decode_stack
from graycast.rig.pair import PRESETS, Rig

PRESET_FILTERS = tuple({preset(name).filters: name for name in PRESETS})  # each value once
_REACH_PX = 2  # reach of the presets' smoothing


def check_depth_of_no_filters(path: Path, rig: Rig, plain: DepthMap, filters: FilterSpec) -> None:
    """Check that filters only remove, repair and smooth; all other pixels keep their exact depth.

    Args:
        plain: result of the stack without filters.
    """

    def decoded(own: FilterSpec) -> DepthMap:
        depth = decode_stack(path, rig, filters=own).depth
        assert depth is not None
        return depth

    removing = decoded(replace(filters, smoothing_px=None, outlier_repair=False))
    left = np.isfinite(removing.depth_m)
    assert left.sum() > 0.8 * np.isfinite(plain.depth_m).sum()
    for name in ("depth_m", "reason"):  # sigma includes no bend next to removed pixels
        assert np.array_equal(getattr(removing, name)[left], getattr(plain, name)[left])
    gone = ~left & np.isfinite(plain.depth_m)
    assert (removing.reason[gone] == Reason.OUTLIER).all()

    whole = decoded(filters)
    smooth = decoded(
        FilterSpec(smoothing_px=filters.smoothing_px, step_angle_deg=filters.step_angle_deg)
    )
    away = ~ndimage.binary_dilation(gone, np.ones((2 * _REACH_PX + 1,) * 2))
    assert (away & left).sum() > 0.5 * left.sum()
    assert np.array_equal(whole.depth_m[away], smooth.depth_m[away], equal_nan=True)
