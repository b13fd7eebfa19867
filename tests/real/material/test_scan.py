"""Saturated pixels of a scan that are on no known plane."""

from types import SimpleNamespace

import numpy as np

from graycast.camera.decode import Reason
from graycast.real.material import MaterialScan


def test_saturated_pixels_are_counted_inside_a_mask():
    reason = np.full((6, 8), Reason.DECODED, dtype=np.uint8)
    reason[:2] = Reason.SATURATED
    reason[2] = Reason.SHADOW
    result = SimpleNamespace(codes=SimpleNamespace(reason=reason))
    surface_m = np.full((6, 8), np.nan)
    surface_m[0, 0] = 0.5
    scan = object.__new__(MaterialScan)  # The other fields of a scan do not matter here.
    object.__setattr__(scan, "result", result)
    object.__setattr__(scan, "surface_m", surface_m)
    mask = np.zeros((6, 8), dtype=bool)
    mask[1:4, 2:5] = True
    assert scan.saturated_pixels() == 15
    assert scan.saturated_pixels(mask) == 3
