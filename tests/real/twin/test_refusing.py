"""Scans without a shadow side are refused, because they are not from structured light."""

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.real.twin.making import refuse_without_shadow

from ..realism.synthetic import plane, plates, scan, scattered_plates


def maps(projector_m, seed=1):
    rng = np.random.default_rng(seed)
    return [scan(plates(projector_m, scattered_plates(rng))) for _ in range(3)]


@pytest.mark.parametrize("projector_m", [(0.2, 0.0, 0.0), (-0.2, 0.0, 0.02), (0.0, -0.25, 0.0)])
def test_a_projector_beside_the_camera_is_accepted(projector_m):
    refuse_without_shadow(maps(projector_m))


def test_a_projector_at_the_position_of_the_camera_is_refused_with_the_reason():
    with pytest.raises(GraycastError, match="no shadow side"):
        refuse_without_shadow(maps((0.0, 0.0, 0.0)))


def test_stereo_with_filled_shadows_is_refused():
    """With filled disparity, both sides of an object have depth steps between valid pixels."""
    rng = np.random.default_rng(2)
    filled = []
    for _ in range(3):
        depth_m = plates((0.0, 0.0, 0.0), scattered_plates(rng))
        filled.append(scan(depth_m + 2e-3 * rng.standard_normal(depth_m.shape)))
    with pytest.raises(
        GraycastError, match="Such scans are typical of active stereo and time of flight"
    ):
        refuse_without_shadow(filled)


def test_scans_with_too_few_depth_steps_are_refused():
    with pytest.raises(
        GraycastError, match="depth steps per map, which are too few to identify the kind of"
    ):
        refuse_without_shadow([scan(plane())] * 3)
