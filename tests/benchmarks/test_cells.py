"""The scenes of the studies."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import cells
from graycast.base.frames import pixel_grid
from graycast.rig.optics import rays
from graycast.rig.pair import preset_rig


def test_a_crop_has_the_same_rays_as_the_whole_picture():
    camera = replace(preset_rig("like-phoxi-m").camera, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    crop = cells.cropped(camera, (258, 194))
    whole = rays(camera, pixel_grid(772, 1032))
    assert np.abs(rays(crop, pixel_grid(194, 258)) - whole[289:483, 387:645]).max() < 1e-12


def test_a_crop_beyond_the_picture_is_refused():
    with pytest.raises(ValueError, match="2000 x 100 does not fit into the camera's 1032 x 772 px"):
        cells.cropped(preset_rig("like-phoxi-m").camera, (2000, 100))


def test_the_photon_noise_of_the_quiet_sensor_is_at_most_two_digital_numbers():
    """The photon noise is computed at the top of the sensor's range."""
    sensor = cells.QUIET_SENSOR
    variance_dn2 = sensor.gain_dn_per_e**2 * sensor.full_well_e
    assert np.sqrt(variance_dn2) < 2.1
    assert np.sqrt(variance_dn2) / sensor.max_dn < 4e-5


def test_the_timed_stack_has_24_patterns():
    assert len(cells.PHASE_BOTH.code(1024, 768).frames) == 24
