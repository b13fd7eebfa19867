"""The pictures of a dataset, compared with their light."""

from dataclasses import replace

import numpy as np
import pytest
from stage import centred, make_rig

from graycast.camera.picture import color_picture, gray_picture
from graycast.camera.scanner import Scanner
from graycast.camera.sensor import SensorSpec, expose, merge_exposures
from graycast.rendering import GroundTruth, Radiance, Rendering

SENSOR = SensorSpec(
    full_well_e=1e6, gain_dn_per_e=0.1, offset_dn=50.0, bit_depth=12, dark_current_e_s=0.0
)
H, W = 48, 64


@pytest.mark.parametrize("times_s", [(1.0,), (0.1, 1.0), (4.0, 1.0, 16.0)])
def test_the_grey_picture_is_proportional_to_the_light_whatever_the_exposures(times_s):
    """White is the light that saturates the sensor in the shortest exposure: 40,450 electrons."""
    light = np.linspace(0.01, 3.0, 256)  # in shares of white
    per_s = light * (SENSOR.saturation_dn - 50) / 0.1 / SENSOR.responsivity / min(times_s)
    stack = np.broadcast_to(per_s.astype(np.float32), (1, 400, 256))
    captures = [
        expose(stack.copy(), None, SENSOR, exposure_s=time_s, seed=k)
        for k, time_s in enumerate(times_s)
    ]
    gray = gray_picture(merge_exposures(captures)).mean(axis=0)
    unsure = np.abs(light - 1) < 0.03  # saturated or not by chance
    expected = 255 * np.minimum(light, 1)
    # The factor 1.3 is for noise over 400 rows; in the dark, too little noise dithers the rounding.
    assert np.abs(gray - expected)[~unsure].max() < 0.5


def test_a_wall_is_equally_grey_at_pixels_of_different_exposures():
    """On the left half of a wall, another frame is so bright that a shorter exposure is used.

    White fills 20 % of the sensor in one second. Rounding costs up to half a level if there is
    little noise.
    """
    wall = np.full((2, H, W), 0.2, dtype=np.float32)
    wall[1, :, : W // 2] = 2.0
    fill_s = (SENSOR.saturation_dn - SENSOR.offset_dn) / SENSOR.gain_dn_per_e
    wall *= np.float32(fill_s / SENSOR.responsivity)
    shots = [
        expose(wall.copy(), None, SENSOR, exposure_s=t, seed=k)
        for k, t in enumerate((0.25, 1.0, 4.0))
    ]
    for reference_s in (0.25, 1.0):
        capture = replace(merge_exposures(shots), reference_s=reference_s)
        assert set(np.unique(capture.exposure_s[:, : W // 2])) == {0.25}
        assert set(np.unique(capture.exposure_s[:, W // 2 :])) == {4.0}
        gray = gray_picture(capture)
        left, right = gray[:, : W // 2].mean(), gray[:, W // 2 :].mean()
        assert abs(left - right) < 0.5
        assert right == pytest.approx(255 * 0.2 * reference_s, abs=0.5)


def flat_rendering(ambient_rgb, white_rgb):
    """Return a rendering that is dark in one half, with this light in the other."""
    half = np.zeros((H, W, 1), dtype=np.float32)
    half[:, W // 2 :] = 1
    no = np.zeros((H, W), dtype=np.float32)
    return Rendering(
        radiance=Radiance(
            pattern=no[None].copy(),
            white=no.copy(),
            ambient=no.copy(),
            ambient_rgb=half * np.float32(ambient_rgb),
            white_rgb=half * np.float32(white_rgb),
            albedo=np.zeros((H, W, 3), dtype=np.float32),
        ),
        truth=GroundTruth(
            depth_m=no.astype(float),
            normal=np.zeros((H, W, 3)),
            instance=np.full((H, W), -1),
            amodal=(),
        ),
    )


@pytest.mark.parametrize(
    ("words", "light"),
    [
        ({}, (4.0, 2.0, 1.0)),
        ({"picture_level": 0.25}, (6.0, 4.0, 3.0)),
        ({"contrast_ratio": 8.0}, (5.0, 3.0, 2.0)),
        ({"picture_level": 0.25, "contrast_ratio": 8.0}, (6.75, 4.75, 3.75)),
    ],
)
def test_the_colour_picture_shows_all_light_and_is_exposed_to_its_target(words, light):
    """Idle light by hand: (1 - 1/contrast) + 1/contrast times white, here 8 in each band.

    The brightest band is exposed to 0.85 of the range; the encoding is IEC 61966-2-1's.
    """
    rig = make_rig(centred(W, H, 50), centred(32, 24, 30), **words)
    scanner = Scanner(rig=rig, sensor=SENSOR)
    rendering = flat_rendering((4.0, 2.0, 1.0), (8.0, 8.0, 8.0))
    picture = color_picture(scanner, rendering, denoiser=None, seed=3)
    share = 0.85 * np.array(light) / max(light)
    expected = 255 * (1.055 * share ** (1 / 2.4) - 0.055)
    lit = picture[:, W // 2 :].reshape(-1, 3).mean(axis=0)
    assert np.abs(lit - expected).max() < 0.3
    assert picture[:, : W // 2].mean() < 2


def test_a_picture_without_light_is_refused_with_a_remedy():
    rig = make_rig(centred(W, H, 50), centred(32, 24, 30))
    black = flat_rendering((0.0, 0.0, 0.0), (8.0, 8.0, 8.0))
    with pytest.raises(ValueError, match=r"colour picture is black: give light\.environment"):
        color_picture(Scanner(rig=rig, sensor=SENSOR), black, denoiser=None, seed=3)
