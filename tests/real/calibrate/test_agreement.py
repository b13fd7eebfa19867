"""Calibrations in which a device moved between groups of views, which medians do not show."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from scipy.spatial.transform import Rotation

from graycast.real.calibrate.agreement import fit_agreeing
from graycast.real.calibrate.board import CalibrationError
from graycast.real.calibrate.observing import Observed, ViewCorners, agreeing

from .test_calibrate_terms import SIZE, corners_of, lens

LENSES = lens(1500.0, (0.0,) * 5), lens(1400.0, (0.0,) * 5)
FINE_PX = {"noise_px": 0.02, "code_px": 0.02}


def views_of(count, *, first_seed=5, every=6):
    """Return views of a board with 14 corners each, in closed form and with noise."""
    views = []
    for seed in range(first_seed, first_seed + count):
        corners = corners_of(*LENSES, depth_m=0.55 + 0.02 * (seed % 4), seed=seed, **FINE_PX)
        some = corners.only((corners.view == 0) & (np.arange(len(corners.view)) % every == 0))
        views.append(ViewCorners(name=f"v{len(views)}", corners=some, undecoded=0))
    return tuple(views)


def knocked(view, turn_deg):
    """Return the view of a camera that was rotated about its centre.

    Without distortion, the rotation maps each pixel by `K R K^-1`, for any pose of the board.
    """
    K = np.array([[1500.0, 0.0, 639.5], [0.0, 1500.0, 511.5], [0.0, 0.0, 1.0]])
    turn = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    pixel = np.column_stack([view.corners.camera_px, np.ones(len(view.corners.view))])
    moved = pixel @ (K @ turn @ np.linalg.inv(K)).T
    return replace(view, corners=replace(view.corners, camera_px=moved[:, :2] / moved[:, 2:]))


def shifted(view, by_px):
    """Return the view as if the board had moved between the white picture and the code."""
    px = view.corners.projector_px + np.array(by_px)
    return replace(view, corners=replace(view.corners, projector_px=px))


def calibrated(views):
    observed = agreeing(Observed(views=tuple(views), left_out={}), SIZE, SIZE)
    return fit_agreeing(observed, (SIZE, SIZE), 1, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "count", "turn_deg"), [(3, 6, 0.5), slow(4, 9, 0.1), slow(5, 9, 2.0)]
)
def test_a_calibration_is_refused_if_the_camera_moved_between_two_halves_of_the_views(
    first, count, turn_deg
):
    """Symptom: focal lengths were 15 to 18 % off, 2.8 % was stated, and no view was named."""
    views = [knocked(v, turn_deg) if k >= first else v for k, v in enumerate(views_of(count))]
    names = f"views v0 to v{first - 1} and views v{first} to v{count - 1}"
    words = rf"{names} have the devices (\S+) degrees and \S+ mm apart: a device moved between them"
    with pytest.raises(CalibrationError, match=words) as raised:
        calibrated(views)
    stated_deg = float(str(raised.value).split("have the devices ")[1].split()[0])
    assert stated_deg == pytest.approx(turn_deg, rel=0.2)


@pytest.mark.parametrize(
    ("bad", "by_px"),
    [slow((1, 4, 7), (0.0, 5.0)), slow((0, 5, 9), (4.0, 0.0)), slow((9, 10, 11), (0.0, 6.0))],
)
def test_three_of_twelve_views_that_moved_together_are_left_out(bad, by_px):
    """Symptom: the fit followed the three views, and so the medians of all views were bad."""
    views = [shifted(v, by_px) if k in bad else v for k, v in enumerate(views_of(12))]
    good, fit = calibrated(views)
    assert set(good.left_out) == {f"v{k}" for k in bad}
    for device, truth in zip((fit.camera, fit.projector), LENSES, strict=True):
        name = "camera" if truth is LENSES[0] else "projector"
        assert abs(device.fx_px - truth.fx_px) < 5 * fit.deviation[f"{name}.fx_px"]
        assert fit.deviation[f"{name}.fx_px"] < 2e-3 * truth.fx_px


@pytest.mark.parametrize("turn_deg", [slow(0.005), slow(0.01)])
def test_deviations_include_a_movement_that_is_too_small_to_be_refused(turn_deg):
    """The camera moves so little for half of the views that the residual stays below 0.05 px.

    The error is several times the deviation that follows from the noise of the corners alone.
    """
    still = views_of(8)
    _, before = calibrated(still)
    _, fit = calibrated([knocked(v, turn_deg) if k >= 4 else v for k, v in enumerate(still)])
    error_px = abs(fit.camera.fx_px - LENSES[0].fx_px)
    assert error_px < 4 * fit.deviation["camera.fx_px"]
    assert fit.deviation["camera.fx_px"] > 2 * before.deviation["camera.fx_px"]


@pytest.mark.parametrize("seed", [slow(100 + 20 * k) for k in range(20)])
def test_a_good_calibration_keeps_all_views_and_its_deviations(seed):
    """The views must not be divided, although the noise of corners differs between views."""
    rng = np.random.default_rng(seed)
    views = []
    for view in views_of(int(rng.integers(4, 12)), first_seed=seed):
        noise_px = rng.uniform(0.05, 0.1)
        px = view.corners.camera_px + rng.normal(0, noise_px, view.corners.camera_px.shape)
        views.append(replace(view, corners=replace(view.corners, camera_px=px)))
    good, fit = calibrated(views)
    assert good.left_out == {}
    assert abs(fit.camera.fx_px - LENSES[0].fx_px) < 5 * fit.deviation["camera.fx_px"]
