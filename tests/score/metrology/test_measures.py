"""Fits and measures of shapes whose errors are known in closed form."""

import numpy as np
import pytest

from graycast.rig.pattern import gray, gray_phase, micro_phase
from graycast.score.metrology.measures import (
    depth_error_m,
    fit_plane,
    fit_sphere,
    flatness,
    modulation,
    point_spacing_m,
    probing,
    temporal_noise_m,
    without_worst,
)

NORMAL = np.array([0.36, -0.48, 0.8])
U, V = np.array([0.8, 0.6, 0.0]), np.array([-0.48, 0.64, 0.6])  # perpendicular to `NORMAL`


def rippled_plane(amplitude_m, periods=5, n=200):
    """Return a square of 1 m at 0.7 m along its normal, with whole periods of a cosine across it.

    The cosine is even about the centre, so that it does not tilt a fitted plane.
    """
    a, b = (np.mgrid[0:n, 0:n] + 0.5).reshape(2, -1) / n
    ripple = amplitude_m * np.cos(2 * np.pi * periods * (a - 0.5))
    return np.outer(a - 0.5, U) + np.outer(b - 0.5, V) + np.outer(0.7 + ripple, NORMAL)


def cap(radius_m, centre, *, n=3000, opening=np.pi / 3):
    """Return random points that are uniform on the cap of a sphere that faces the origin."""
    rng = np.random.default_rng(2)
    cosine = rng.uniform(np.cos(opening), 1, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    normal = np.stack([sine * np.cos(turn), sine * np.sin(turn), -cosine], axis=-1)
    return np.asarray(centre) + radius_m * normal, normal


def test_a_plane_is_fitted_exactly_to_its_points():
    fit = fit_plane(rippled_plane(0.0, n=20))
    assert np.abs(np.abs(fit.normal @ NORMAL) - 1) < 1e-12
    assert abs(fit.offset_m - 0.7) < 1e-12


def test_the_flatness_error_of_a_ripple_is_its_height_without_the_dropped_points():
    """Distances from a cosine range from -a to a. The 3 in 1000 points beyond a cos(0.003 pi / 2)
    are within 2e-5 of a, so the range is 2 a. The dropped peaks are arbitrary: in the worst case,
    all are at one edge, which moves the plane by 0.3 % of a and tilts it by three times that.
    """
    amplitude = 1e-3
    fit, off = flatness(rippled_plane(amplitude, periods=4))
    assert abs(off.range_m / (2 * amplitude) - 1) < 0.012
    assert abs(off.std_m / (amplitude / np.sqrt(2)) - 1) < 0.012
    assert abs(fit.normal @ NORMAL) > 1 - 1e-6


def test_exactly_three_points_in_a_thousand_are_dropped():
    point = rippled_plane(0.0, n=100)  # Of 10,000 points, 30 may be dropped.
    spikes = np.random.default_rng(0).choice(len(point), 31, replace=False)
    point[spikes[:30]] += 0.02 * NORMAL
    assert flatness(point)[1].range_m < 1e-12
    assert flatness(point)[1].dropped == 30
    point[spikes[30]] += 0.02 * NORMAL
    assert abs(flatness(point)[1].range_m / 0.02 - 1) < 1e-2


@pytest.mark.parametrize(("n", "dropped"), [(10, 0), (333, 0), (334, 1), (10_000, 30)])
def test_the_farthest_points_are_dropped_and_their_number_is_rounded_down(n, dropped):
    distance = -np.arange(n, dtype=float)
    keep = without_worst(distance)
    assert n - keep.sum() == dropped and keep[: n - dropped].all()


def test_a_sphere_is_fitted_from_its_cap():
    centre = np.array([0.3, -0.2, 1.4])
    fit = fit_sphere(cap(0.05, centre)[0])
    assert np.abs(fit.centre_m - centre).max() < 1e-12 and abs(fit.radius_m - 0.05) < 1e-12


def test_a_larger_sphere_has_a_size_error_and_no_form_error():
    fit, off = probing(cap(0.0501, (0.0, 0.0, 1.0))[0])
    assert abs(2 * (fit.radius_m - 0.05) - 0.0002) < 1e-12
    assert off.range_m < 1e-12


def test_a_ripple_on_a_sphere_is_its_form_error_and_not_its_size():
    """Waves around a cap's axis are orthogonal to changes of centre and radius. Dropping any 3
    points in 1000 moves the fit by a few times this share of the wave.
    """
    cosine, turn = (g.ravel() for g in np.meshgrid(np.linspace(0.5, 1, 60), np.arange(720) / 720))
    turn, sine = 2 * np.pi * turn, np.sqrt(1 - cosine**2)
    normal = np.stack([sine * np.cos(turn), sine * np.sin(turn), -cosine], axis=-1)
    radial = 0.05 + 1e-4 * np.sin(12 * turn)
    fit, off = probing([0.0, 0.0, 1.0] + radial[:, None] * normal)
    assert abs(off.range_m / 2e-4 - 1) < 0.012
    assert abs(fit.radius_m - 0.05) < 0.012 * 1e-4


def test_noise_does_not_bias_the_fitted_sphere():
    """The covariance of the fit is sigma^2 (J^T J)^-1 with J = (normal, 1)."""
    sigma = 1e-4
    point, normal = cap(0.05, (0.1, 0.1, 1.0), n=5000)
    noise = np.random.default_rng(1).normal(0, sigma, len(point))
    fit = fit_sphere(point + noise[:, None] * normal)
    jacobian = np.column_stack([normal, np.ones(len(normal))])
    error_m = sigma * np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[3, 3])
    assert abs(fit.radius_m - 0.05) < 4 * error_m


def test_too_few_points_are_refused():
    with pytest.raises(ValueError, match="needs 4 points"):
        fit_sphere(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="needs 3 points"):
        fit_plane(np.zeros((2, 3)))


@pytest.mark.parametrize("captures", [2, 8])
def test_temporal_noise_equals_the_simulated_sigma(captures):
    """The median of chi-squared over 40,000 pixels has an error of about 1 %."""
    rng = np.random.default_rng(captures)
    truth = rng.uniform(0.9, 1.1, (200, 200))
    depth = (truth + rng.normal(0, 2e-4, (captures, 200, 200))).astype(np.float32)
    depth[0, :20] = np.nan
    everywhere = np.ones((200, 200), dtype=bool)
    chi_error = {2: 0.02, 8: 0.006}[captures]
    assert abs(temporal_noise_m(depth, everywhere) / 2e-4 - 1) < 3 * chi_error
    loud = truth + 1.1 * (depth - truth)
    assert abs(temporal_noise_m(loud, everywhere) / 2e-4 - 1) > 3 * chi_error  # 10 % is detected.


def test_temporal_noise_without_points_is_unknown():
    assert np.isnan(temporal_noise_m(np.zeros((2, 4, 4)), np.zeros((4, 4), dtype=bool)))
    with pytest.raises(ValueError, match="no scatter"):
        temporal_noise_m(np.zeros((1, 4, 4)), np.ones((4, 4), dtype=bool))


def test_point_spacing_is_depth_over_focal_length():
    y, x = np.mgrid[0:30, 0:40] - 15.0
    z = 1.2
    point = np.stack([x / 600 * z, y / 600 * z, np.full_like(x, z)], axis=-1)
    where = np.ones(x.shape, dtype=bool)
    assert abs(point_spacing_m(point, where) / (z / 600) - 1) < 1e-12
    assert np.isnan(point_spacing_m(point, np.zeros_like(where)))


@pytest.mark.parametrize("inverses", [False, True])
def test_blur_reduces_the_modulation_of_a_bit(inverses):
    """All pictures but white and black are blended with the mean by a known share."""
    code = gray(16, 4, axes=("column",), inverses=inverses)
    share = code.render().astype(float)[:, :, :] / 255
    contrast = {frame.name: 1 - 0.2 * max(0, 3 - frame.bit) for frame in code.frames[2:]}
    light = 3.0 + 5.0 * np.stack(
        [
            picture if frame.axis is None else 0.5 + contrast[frame.name] * (picture - 0.5)
            for frame, picture in zip(code.frames, share, strict=True)
        ]
    )
    estimate = modulation(code, light, np.ones(light.shape[1:], dtype=bool))
    assert list(estimate) == [frame.name for frame in code.frames[2:] if not frame.inverse]
    for name, value in estimate.items():
        assert abs(value - contrast[name]) < 1e-12


def test_modulation_of_a_phase_is_twice_its_amplitude():
    code = gray_phase(64, 4, period_px=16.0, steps=5)
    u = np.arange(64)
    light = np.ones((len(code.frames), 4, 64))
    for k, frame in enumerate(code.frames):
        if frame.kind in ("white", "black"):
            light[k] = 2.0 if frame.kind == "white" else 0.5
        elif frame.kind == "phase":
            light[k] = 1.25 + 0.6 * np.cos(2 * np.pi * (u / 16 - frame.step / 5))
    estimate = modulation(code, light, np.ones((4, 64), dtype=bool))
    assert abs(estimate["column_phase_16px_step00"] - 1.2 / 1.5) < 1e-12


def test_incomplete_sets_of_phases_have_no_modulation():
    code = micro_phase(256, 4)
    estimate = modulation(code, np.random.default_rng(0).random((len(code.frames), 4, 4)),
                       np.ones((4, 4), dtype=bool))  # fmt: skip
    assert 1 <= len(estimate) < sum(frame.kind == "phase" for frame in code.frames) - 2


def test_the_depth_error_excludes_the_common_offset_and_the_worst_pixels():
    """Oracle: a uniform law of width w has the standard deviation w / sqrt(12)."""
    error_m = 0.01 + np.linspace(-1e-3, 1e-3, 10_001)
    assert depth_error_m(error_m) == pytest.approx(2e-3 / np.sqrt(12), rel=5e-3)
    error_m[:30] = 5.0  # 3 in 1000 are dropped.
    assert depth_error_m(error_m) == pytest.approx(2e-3 / np.sqrt(12), rel=1e-2)
