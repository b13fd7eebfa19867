"""Uneven projector lines: noise is common along them, follows a closed form, and is in sigma."""

from dataclasses import replace

import numpy as np
import pytest
from stage import centred, in_camera, lambert, make_rig, wall

from graycast.camera.line_noise import with_line_noise
from graycast.camera.scanner import ExposureSpec, Scanner, measure, take
from graycast.camera.sensor import SensorSpec
from graycast.camera.sigma import line_noise_px
from graycast.rendering import Quality
from graycast.rendering.reference import ReferenceRenderer
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT

SHARE, PERIOD_PX, STEPS = 0.02, 16.0, 4


@pytest.fixture(scope="module")
def scanner():
    """Return parallel devices with equal pixels: each camera pixel sees one projector line."""
    rig = make_rig(centred(96, 72, 160.0), centred(192, 144, 160.0), line_noise=SHARE)
    return Scanner(
        rig=rig,
        code=CodeSpec(codec="gray_phase", axes=("column",), period_px=PERIOD_PX, steps=STEPS),
        exposure=ExposureSpec(target=0.8),
        sensor=SensorSpec(full_well_e=1e6, gain_dn_per_e=0.0039, read_noise_e=1.0),
    )


@pytest.fixture(scope="module")
def radiance(scanner):
    return light_of(scanner)


def light_of(scanner):
    rendering = ReferenceRenderer().render(
        in_camera(scanner.rig, wall(1.0, lambert(0.6))),
        EMPTY_LAYOUT,
        scanner.light_code().render(),
        quality=Quality(samples=1, depth=1),
        seed=0,
    )
    return rendering.radiance


def places(scanner, radiance, seeds):
    """Return decoded columns of several captures, and stated depth sigma over the code's own."""
    captures = [take(scanner, radiance, seed=seed) for seed in seeds]
    scans = [measure(scanner, capture, path_noise=None) for capture in captures]
    inner = np.s_[2:-2, 2:-2]
    return np.stack([codes.column[inner] for codes, _ in scans]), scans


def test_the_renderer_returns_the_projector_line_that_lights_each_pixel(scanner, radiance):
    """Oracle: similar triangles, u_proj = u_cam - f b / z."""
    rig = scanner.rig
    expected = np.arange(96) - 47.5 - 160.0 * rig.T_cam_proj[0, 3] / 1.0 + 95.5
    np.testing.assert_allclose(
        radiance.place_px[0], np.broadcast_to(expected, (72, 96)), atol=1e-4, rtol=0
    )


def test_a_glint_does_not_change_the_line_noise_of_other_pixels(scanner, radiance):
    """Law: light adds pixel by pixel, so a facet that mirrors the projector, 26,000 times as bright
    as white paper, changes no other pixel at a fixed exposure.
    """
    fixed = replace(scanner, exposure=ExposureSpec(exposure_s=2e-3))
    pattern = radiance.pattern.copy()
    pattern[:, 36, 48] *= 26_000
    one, other = (
        take(fixed, light, seed=4).frames
        for light in (radiance, replace(radiance, pattern=pattern))
    )
    same = np.ones((72, 96), dtype=bool)
    same[36, 48] = False
    np.testing.assert_array_equal(one[:, same], other[:, same])
    assert (one[:, ~same] < other[:, ~same]).any()


def test_a_dark_scene_with_a_fixed_exposure_gives_a_dark_picture(scanner, radiance):
    dark = replace(
        radiance,
        pattern=np.zeros_like(radiance.pattern),
        place_px=np.full_like(radiance.place_px, np.nan),
    )
    fixed = replace(scanner, exposure=ExposureSpec(exposure_s=2e-3))
    frames = take(fixed, dark, seed=1).frames
    assert frames.max() < scanner.sensor.offset_dn + 5


def test_line_noise_without_known_projector_positions_is_refused(scanner, radiance):
    with pytest.raises(ValueError, match=r"line_noise 0\.02.*place_px"):
        take(scanner, replace(radiance, place_px=None), seed=1)


@pytest.mark.slow
def test_line_noise_moves_a_whole_projector_line_by_the_closed_form(scanner, radiance):
    """Oracle, by hand: (p / 2 pi) share sqrt(5 / (2 N)), from sums over sin and cos.

    Half and twice the value fail clearly.
    """
    column, _ = places(scanner, radiance, range(20))
    error = column - column.mean(axis=0)
    expected = PERIOD_PX / (2 * np.pi) * SHARE * np.sqrt(5 / (2 * STEPS))
    common = error.mean(axis=1)  # over the rows: the common error of a line
    assert common.std() == pytest.approx(expected, rel=0.05)
    rest = error - common[:, None, :]
    assert rest.std() < 0.2 * expected  # photons and rounding
    neighbours = np.corrcoef(common[:, :-1].ravel(), common[:, 1:].ravel())[0, 1]
    assert abs(neighbours) < 0.1  # each line has its own error


@pytest.mark.slow
@pytest.mark.parametrize("length_px", [1.0, 3.0])
def test_line_errors_correlate_only_over_the_stated_length(scanner, radiance, length_px):
    """The law is exp(-(r / l)^2) along a line; the scatter stays that of whole lines."""
    rig = scanner.rig
    length_m = length_px * (rig.near_m + rig.far_m) / 2 / rig.camera.fx_px
    short = replace(scanner, rig=replace(rig, line_noise_length_m=length_m))
    column, _ = places(short, radiance, range(20))
    error = column - column.mean(axis=0)
    expected = PERIOD_PX / (2 * np.pi) * SHARE * np.sqrt(5 / (2 * STEPS))
    assert error.std() == pytest.approx(expected, rel=0.05)
    for rows in (1, 2, 3, 5):
        alike = np.corrcoef(error[:, :-rows].ravel(), error[:, rows:].ravel())[0, 1]
        assert alike == pytest.approx(np.exp(-((rows / length_px) ** 2)), abs=0.03)
    assert abs(np.corrcoef(error[..., :-1].ravel(), error[..., 1:].ravel())[0, 1]) < 0.03


def test_line_errors_longer_than_the_picture_scatter_by_the_stated_share():
    """With 100 positions, a ring cannot have the law of such lengths exactly."""
    line = np.broadcast_to(np.arange(4000.0), (100, 4000))
    for length_px in (25.0, 50.0, 250.0):
        noisy = with_line_noise(
            np.ones((1, 100, 4000)), line, 0.01, axis="column", length_px=length_px, seed=2
        )
        assert (noisy - 1).std() == pytest.approx(0.01, rel=0.02)


def test_the_correlation_length_applies_equally_to_columns_and_rows(scanner, radiance):
    place = radiance.place_px[0]
    upright = with_line_noise(radiance.pattern, place, 0.1, axis="column", length_px=2.0, seed=1)
    lying = with_line_noise(
        radiance.pattern.swapaxes(1, 2), place.T, 0.1, axis="row", length_px=2.0, seed=1
    )
    np.testing.assert_array_equal(upright, lying.swapaxes(1, 2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [{"period_px": 48.0, "fine_period_px": 16.0}, {"codec": "multi_frequency"}]
)
def test_averaging_several_periods_reduces_scatter_as_stated(scanner, words):
    scanner = replace(scanner, code=replace(scanner.code, **words))
    u, _ = places(scanner, light_of(scanner), range(12))
    stated_px = line_noise_px(scanner.light_code(), "column", SHARE)
    assert np.sqrt(u.var(axis=0, ddof=1).mean()) == pytest.approx(stated_px, rel=0.08)


@pytest.mark.slow
def test_sigma_agrees_with_the_error_of_line_noise(scanner, radiance):
    _, scans = places(scanner, radiance, range(12))
    inner = np.s_[2:-2, 2:-2]
    depth_m = np.stack([depth.depth_m[inner] for _, depth in scans])
    sigma_m = np.stack([depth.sigma_m[inner] for _, depth in scans])
    noise_m = np.sqrt(depth_m.var(axis=0, ddof=1).mean())
    assert 0.9 < noise_m / np.sqrt((sigma_m**2).mean()) < 1.1


def test_a_steady_projector_adds_no_line_noise_and_seeds_give_unequal_errors(scanner, radiance):
    still = replace(scanner, rig=replace(scanner.rig, line_noise=0.0))
    sensor = replace(scanner, rig=replace(scanner.rig, line_noise=1e-9))
    np.testing.assert_array_equal(
        take(still, radiance, seed=3).frames, take(sensor, radiance, seed=3).frames
    )
    place = radiance.place_px[0]
    first, again, other = (
        with_line_noise(radiance.pattern, place, 0.1, axis="column", seed=seed)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_light_without_a_known_projector_line_is_unchanged(scanner, radiance):
    place = radiance.place_px[0].copy()
    place[:, 40:] = np.nan
    noisy = with_line_noise(radiance.pattern, place, 0.1, axis="column", seed=1)
    np.testing.assert_array_equal(noisy[..., 40:], radiance.pattern[..., 40:].astype(np.float32))
    assert not np.array_equal(noisy[..., :40], radiance.pattern[..., :40])
