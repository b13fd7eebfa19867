"""A scanner from light to depth: accuracy of each code on the same rig, and its settings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from stage import in_camera, lambert, leaning_wall

from graycast.camera import scanner as scanner_module
from graycast.camera.decode import triangulate
from graycast.camera.scanner import ExposureSpec, Scanner, measure, preset, scan, scan_seconds, take
from graycast.camera.sensor import Capture, SensorSpec
from graycast.rendering import Quality
from graycast.rig.pair import preset_rig
from graycast.rig.pattern import CODECS, CodeSpec
from graycast.rig.shelf import SHELF, shelf_entry
from graycast.world.scene import EMPTY_LAYOUT, Sphere

DISTANCE_M = 0.75


@pytest.fixture(scope="module")
def rig():
    """Return a window of the PhoXi M's camera, with f/4 and a projector blur of a pixel."""
    rig = preset("like-phoxi-m").rig
    camera = replace(rig.camera, width_px=200, height_px=160, cx_px=99.5, cy_px=79.5)
    # Speckle and line noise have their own tests (test_scanner_speckle.py, test_line_noise.py).
    quiet = {"speckle_contrast": 0.0, "line_noise": 0.0}
    return replace(rig, camera=replace(camera, focus_m=DISTANCE_M), **quiet)


@pytest.fixture(scope="module")
def shots(rig, mitsuba_renderer):
    """Return, for each code, depth map and its error [m] on smooth lit surfaces (a wall, a ball).

    Sigma is the propagated noise of the sensor; the sampling of light adds about 0.005 px at 512
    paths, and the grid of the projector's pixels as much. At a third of the range both are smaller.
    """
    grey = lambert(0.6)
    ball = Sphere(center_m=(0.0, 0.0, DISTANCE_M - 0.12), radius_m=0.07, material=grey)
    wall = leaning_wall((0.25, 0.15, 1.0), DISTANCE_M, grey, half_m=0.4)
    scene = in_camera(rig, wall, ball)
    sensor = replace(preset("like-phoxi-m").sensor, read_noise_e=5.0)
    scans = {}
    for codec in CODECS:
        code = CodeSpec(codec=codec, axes=("column",))
        scanner = Scanner(rig=rig, code=code, sensor=sensor, exposure=ExposureSpec(target=0.35))
        rendering = mitsuba_renderer.render(
            scene,
            EMPTY_LAYOUT,
            scanner.light_code().render(),
            quality=Quality(samples=512, depth=1),
            seed=1,
        )
        codes = scan(scanner, rendering.radiance, seed=3).codes
        depth = triangulate(codes, rig)  # the code's own sigma, without the bend of the ball's rim
        truth_m = rendering.truth.depth_m
        step_m = ndimage.maximum_filter(truth_m, 5) - ndimage.minimum_filter(truth_m, 5)
        error_m = np.where(step_m < 0.02, depth.depth_m - truth_m, np.nan)
        scans[codec] = depth, error_m
    return scans


@pytest.mark.slow
@pytest.mark.parametrize(
    "codec", ["gray_phase", "gray_line_shift", "multi_frequency", "micro_phase"]
)
def test_errors_of_a_sub_pixel_code_agree_with_sigma(shots, codec):
    """A normal error is within one sigma in 68 % and within two in 95 % of the pixels."""
    depth, error_m = shots[codec]
    known = np.isfinite(error_m)
    assert known.mean() > 0.8
    ratio = np.abs(error_m / depth.sigma_m)[known]
    assert 0.60 <= np.mean(ratio < 1) <= 0.76
    assert 0.93 <= np.mean(ratio < 2) <= 0.975


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["gray", "xor_gray"])
def test_errors_of_a_binary_code_are_below_half_a_column(rig, shots, codec):
    """Half a column, as depth, is sqrt(3) sigma of an even error; a pixel across two columns may
    have either, and has a larger sigma.
    """
    depth, error_m = shots[codec]
    known = np.isfinite(error_m)
    assert known.mean() > 0.8
    straddling = np.quantile(depth.sigma_m[known] / depth.depth_m[known] ** 2, 0.5)
    sure = known & (depth.sigma_m / depth.depth_m**2 < 1.15 * straddling)
    within = np.abs(error_m / depth.sigma_m)[sure] <= np.sqrt(3)
    assert within.mean() > 0.97
    assert np.quantile(np.abs(error_m / depth.sigma_m)[sure], 0.999) < 1.5 * np.sqrt(3)


@pytest.mark.slow
def test_phase_codes_are_ten_times_more_precise_than_plain_gray_code(rig, mitsuba_renderer):
    """On a well exposed wall, the noise of phases falls with the light; Gray code's does not."""
    scene = in_camera(rig, leaning_wall((0.25, 0.15, 1.0), DISTANCE_M, lambert(0.8), half_m=0.4))
    rms_m = {}
    for codec in ("gray", "gray_phase"):
        scanner = Scanner(
            rig=rig,
            code=CodeSpec(codec=codec, axes=("column",)),
            sensor=preset("like-phoxi-m").sensor,
            exposure=ExposureSpec(target=0.9),
        )
        rendering = mitsuba_renderer.render(
            scene,
            EMPTY_LAYOUT,
            scanner.light_code().render(),
            quality=Quality(samples=128, depth=1),
            seed=1,
        )
        depth = scan(scanner, rendering.radiance, seed=3).depth
        rms_m[codec] = np.sqrt(np.nanmean(np.square(depth.depth_m - rendering.truth.depth_m)))
    assert rms_m["gray"] > 10 * rms_m["gray_phase"]


@pytest.mark.slow
def test_exposures_are_merged_if_several_are_configured(rig, flat_light):
    """Ten times the light saturates the longer exposure; the merged result is unsaturated."""
    exposure = ExposureSpec(exposure_s=2e-3, factors=(1.0, 0.1))
    scanner = Scanner(rig=preset_rig("paper"), exposure=exposure)
    bright = flat_light(scanner, dim=5.0, bright=50.0)
    capture = take(scanner, bright, seed=1)
    half = capture.frames.shape[2] // 2
    assert (capture.exposure_s[:, :half] == np.float32(2e-3)).all()
    assert (capture.exposure_s[:, half:] == np.float32(2e-4)).all()
    codes, _ = measure(scanner, capture, path_noise=None)
    assert not (codes.reason == 3).any()


@pytest.mark.slow
def test_exposures_have_independent_noise(flat_light, monkeypatch):
    """Oracle: independent noise is not correlated; for 80,000 pixels, 0.02 is six deviations."""
    taken = []
    monkeypatch.setattr(scanner_module, "merge_exposures", lambda one: taken.extend(one) or one[0])
    exposure = ExposureSpec(exposure_s=2e-3, factors=(1.0, 0.5))
    scanner = Scanner(rig=preset_rig("paper", "small"), exposure=exposure)
    take(scanner, flat_light(scanner, dim=5.0, bright=5.0), seed=1)
    bright, dim = (one.frames[0].ravel()[:80_000].astype(float) for one in taken)
    assert bright.std() > 3 and dim.std() > 3
    assert abs(np.corrcoef(bright, dim)[0, 1]) < 0.02


@pytest.mark.slow
def test_automatic_exposure_measures_all_light_in_the_brightest_frame(flat_light):
    """Lamps give as much light as the projector: both together reach the target."""
    scanner = Scanner(rig=preset_rig("paper", "small"), exposure=ExposureSpec(target=0.6))
    light = flat_light(scanner, dim=5.0, bright=5.0)
    light = replace(light, ambient=np.full_like(light.ambient, 5.0))
    sensor = scanner.sensor
    white = take(scanner, light, seed=1).frames[scanner.light_code().brightest]
    share = (white.mean() - sensor.offset_dn) / (sensor.saturation_dn - sensor.offset_dn)
    assert share == pytest.approx(0.6, abs=0.005)


def test_aperture_and_f_number_must_agree():
    scanner = preset("like-phoxi-s")
    with pytest.raises(ValueError, match=r"f_number is 8, .* makes f/4: make both agree"):
        replace(scanner, sensor=replace(scanner.sensor, f_number=8.0))
    pinhole = replace(scanner.rig.camera, aperture_m=0.0)
    replace(scanner, rig=replace(scanner.rig, camera=pinhole), sensor=SensorSpec(f_number=8.0))


@pytest.fixture
def flat_light():
    """Return light of a scanner's code on two flat halves, each pixel at column 100."""
    from graycast.rendering import Radiance

    def flat(scanner, *, dim, bright):
        code = scanner.light_code()
        level = code.render()[:, 100, 100].astype(np.float32) / 255
        camera = scanner.rig.camera
        shape = (camera.height_px, camera.width_px)
        white = np.full(shape, dim, dtype=np.float32)
        white[:, shape[1] // 2 :] = bright
        zero = np.zeros(shape, dtype=np.float32)
        return Radiance(
            pattern=level[:, None, None] * white,
            white=white,
            ambient=zero,
            white_rgb=np.repeat(white[..., None], 3, axis=-1),
            ambient_rgb=np.zeros((*shape, 3), dtype=np.float32),
            albedo=np.zeros((*shape, 3), dtype=np.float32),
        )

    return flat


def test_a_scan_takes_the_sum_of_its_frame_times():
    """Oracle, by hand: 3 frames, each exposed for 2, 8 and 20 ms and read out 3 times."""
    exposure_s = np.full((6, 8), 0.002, dtype=np.float32)
    exposure_s[2, 3] = 0.020  # No pixel uses the exposure of 8 ms.
    frames, times_s = np.zeros((3, 6, 8), dtype=np.uint16), (0.002, 0.008, 0.020)
    capture = Capture(frames=frames, sensor=SensorSpec(), exposure_s=exposure_s, times_s=times_s)
    seconds = scan_seconds(capture, readout_s=0.01)
    assert seconds == pytest.approx(3 * (0.002 + 0.008 + 0.020 + 3 * 0.01), rel=1e-6)


def test_a_preset_s_raster_has_the_same_size_in_millimetres_at_every_resolution():
    small, low = (preset("like-phoxi-m", resolution) for resolution in ("small", "low"))
    place = [s.faults.raster_px / s.rig.camera.fx_px for s in (small, low)]
    assert place[0] == pytest.approx(place[1], rel=1e-3)


@pytest.mark.parametrize("name", [name for name in SHELF if shelf_entry(name).focus_m is None])
def test_a_preset_without_a_stated_focus_is_equally_sharp_at_both_ends_of_its_range(name):
    """Symptom: a camera focused at the far end blurs near parts by up to 3 px at full resolution.

    Oracle: the blur disc of a point at z has the diameter of the aperture times |1 / z - 1 /
    focus|, in slopes of rays.
    """
    rig = preset(name, "full").rig
    near, far = (1 / z_m - 1 / rig.camera.focus_m for z_m in (rig.near_m, rig.far_m))
    assert near > 0 > far
    assert near == pytest.approx(-far, rel=1e-9)
