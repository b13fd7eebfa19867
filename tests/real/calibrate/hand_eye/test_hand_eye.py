"""The fit returns the true poses, its covariance is that of its errors, and mistakes are named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.frames import inverse
from graycast.real.calibrate.board import CalibrationError
from graycast.real.calibrate.hand_eye import calibrate_hand_eye, predict, simulated_errors_m
from graycast.real.calibrate.hand_eye.board_pose import board_poses
from graycast.real.calibrate.hand_eye.fitting import fit_hand_eye, views_of
from graycast.real.calibrate.hand_eye.motion import motion_between
from graycast.real.calibrate.hand_eye.plan import noisy_scans
from graycast.real.calibrate.hand_eye.robot_poses import RobotPoses
from studies.hand_eye import BOARD, NOISE, RIG, SOLVERS, cell, error_m, errors_m, pose

MOUNTS = ("in-hand", "to-hand")
RUNS = 200


def stated(T_base_tool, **readings):
    return RobotPoses(names=None, T_base_tool=T_base_tool, readings=readings)


def calibrate(plan, scans, poses):
    return calibrate_hand_eye(scans, poses, BOARD, RIG.camera, mount=plan.mount)


def fits(plan, runs, *, seed):
    """Yield the views and fits of simulated calibrations."""
    rng = np.random.default_rng(seed)
    for _ in range(runs):
        scans, T_base_tool = noisy_scans(plan, rng)
        views = views_of(board_poses(scans, RIG.camera), T_base_tool, plan.mount)
        yield views, fit_hand_eye(views)


@pytest.mark.parametrize("mount", MOUNTS)
def test_exact_scans_give_the_exact_pose(mount):
    plan = cell(5, mount, seed=0)
    views = views_of(board_poses(plan.scans(), RIG.camera), plan.T_base_tool, mount)
    fit = fit_hand_eye(views)
    np.testing.assert_allclose(fit.T_robot_cam, plan.T_robot_cam, atol=1e-9)
    np.testing.assert_allclose(fit.T_other_board, plan.T_other_board, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS)
def test_the_predicted_error_is_the_spread_of_200_calibrations(mount):
    """The prediction is a closed form; the spread has a standard error of about 4 %."""
    plan = cell(10, mount, seed=0)
    prediction = predict(plan)
    errors = simulated_errors_m(plan, prediction.point_m, RUNS, np.random.default_rng(1))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(prediction.error_m, rel=0.15)


@pytest.mark.slow
def test_twice_the_noise_gives_twice_the_error():
    """The same random numbers are scaled, so the errors are proportional up to second order."""
    single = cell(8, "in-hand", seed=0)
    double = replace(single, noise=replace(NOISE, corner_px=0.1, robot_rad=4e-4, robot_m=2e-4))
    ones, twos = (
        [motion_between(plan.T_robot_cam[None], fit.T_robot_cam[None])[0]
         for _, fit in fits(plan, 20, seed=2)] for plan in (single, double)
    )  # fmt: skip
    np.testing.assert_allclose(np.linalg.norm(twos), 2 * np.linalg.norm(ones), rtol=0.05)
    assert predict(double).error_m == pytest.approx(2 * predict(single).error_m, rel=1e-6)


@pytest.mark.slow
def test_the_stated_covariance_is_that_of_the_errors():
    """The squared error in units of its covariance has the mean 12, the number of unknowns."""
    plan, squares = cell(12, "to-hand", seed=0), []
    for _, fit in fits(plan, 100, seed=3):
        error = np.append(
            motion_between(plan.T_robot_cam[None], fit.T_robot_cam[None]),
            motion_between(plan.T_other_board[None], fit.T_other_board[None]),
        )
        squares.append(error @ np.linalg.solve(fit.covariance, error))
    # The scatter is estimated from 60 degrees of freedom, which raises the mean by a few percent.
    assert np.mean(squares) / 12 == pytest.approx(1.05, abs=0.15)


@pytest.mark.slow
def test_the_leave_one_out_errors_are_those_of_fits_without_the_view():
    plan = cell(8, "in-hand", seed=0)
    views, fit = next(fits(plan, 1, seed=4))
    for i in (0, 5):
        others = views.only(np.arange(8) != i)
        alone = fit_hand_eye(others)
        T_base_tool = alone.T_other_board @ views.T_p_q[i] @ inverse(alone.T_robot_cam)
        e = motion_between(views.T_base_tool[i][None], T_base_tool[None])[0]
        # The refit also estimates the scatter anew, so that the weights change a little.
        np.testing.assert_allclose(fit.left_out[i], e, atol=0.2 * np.abs(fit.left_out[i]).max())


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS)
def test_no_solver_of_opencv_is_better_on_average(mount):
    """Oracle: five solvers of another program, on the same boards and poses."""
    if not hasattr(cv2, "calibrateHandEye"):
        pytest.skip("needs OpenCV 4, as OpenCV 5 has no calibrateHandEye")
    error = errors_m(cell(10, mount, seed=0), 60, np.random.default_rng(5), SOLVERS)
    ours, *theirs = np.sqrt(np.mean(np.square(error), axis=0))
    assert ours < min(theirs)


# --- mistakes ------------------------------------------------------------------------------------


def scaled(T, factor):
    T = T.copy()
    T[:, :3, 3] *= factor
    return T


MISTAKES = {
    "with pose 4 for the first scan": lambda T: np.roll(T, 3, axis=0),
    "in reverse order, they fit": lambda T: T[::-1],
    "the poses are inverted": inverse,
    "millimetres for metres": lambda T: scaled(T, 1000),
    "metres for millimetres": lambda T: scaled(T, 0.001),
}


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("message", MISTAKES)
def test_a_mistake_is_named(message, mount):
    plan = cell(9, mount, seed=0)
    scans, T_base_tool = noisy_scans(plan, np.random.default_rng(6))
    with pytest.raises(CalibrationError, match=message):
        calibrate(plan, scans, stated(MISTAKES[message](T_base_tool)))


@pytest.mark.slow
def test_rotation_vectors_in_degrees_are_named_even_if_they_are_short():
    """Such vectors are shorter than a turn, so only the fit shows the mistake."""
    plan = cell(9, "in-hand", seed=0)
    scans, right = noisy_scans(plan, np.random.default_rng(7))
    degrees = right.copy()
    turn = Rotation.from_matrix(right[:, :3, :3]).as_rotvec()
    degrees[:, :3, :3] = Rotation.from_rotvec(np.degrees(turn)).as_matrix()
    readings = {"the rotation vectors are degrees": right}
    with pytest.raises(CalibrationError, match="fit if the rotation vectors are degrees"):
        calibrate(plan, scans, stated(degrees, **readings))


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS)
def test_a_board_that_moved_between_two_scans_is_named(mount):
    plan = cell(10, mount, seed=0)
    T_cam_board = plan.T_cam_board().copy()
    T_cam_board[6:] = T_cam_board[6:] @ pose((0, 0, 0.002), (0.004, 0, 0.001))
    rng = np.random.default_rng(8)
    scans, _ = noisy_scans(cell(10, mount, seed=0, T_cam_board=T_cam_board), rng)
    _, T_base_tool = noisy_scans(plan, rng)
    with pytest.raises(CalibrationError, match="moved between the scans pose 6 and pose 7"):
        calibrate(plan, scans, stated(T_base_tool))


@pytest.mark.parametrize(("mount", "axis"), [("in-hand", "tool"), ("to-hand", "base")])
def test_rotation_about_one_axis_is_refused_with_its_name(mount, axis):
    plan = cell(6, mount, seed=0)
    turn = np.outer(np.linspace(-0.4, 0.4, 6), [0, 0, 1])
    T = plan.T_base_tool.copy()
    T[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    with pytest.raises(CalibrationError, match=rf"1.00\) in the frame of the {axis}.*nearest: z"):
        calibrate(plan, plan.scans(), stated(T))


@pytest.mark.slow
def test_correct_poses_with_much_noise_are_not_called_a_mistake():
    """The robot is off by 1 mm and 0.1 degrees, which is worse than any industrial robot."""
    for seed in range(5):
        noise = replace(NOISE, corner_px=0.3, robot_rad=2e-3, robot_m=1e-3)
        plan = cell(8, MOUNTS[seed % 2], seed=seed, noise=noise)
        scans, T_base_tool = noisy_scans(plan, np.random.default_rng(seed))
        calibrate(plan, scans, stated(T_base_tool))


@pytest.mark.slow
def test_one_wrong_pose_is_left_out_and_named():
    plan = cell(10, "in-hand", seed=0)
    scans, T_base_tool = noisy_scans(plan, np.random.default_rng(9))
    T_base_tool[3, :3, 3] += [0.008, 0, 0.004]
    result = calibrate(plan, scans, stated(T_base_tool))
    assert list(result.left_out) == ["pose 4"]
    assert error_m(result.fit.T_robot_cam, plan, result.point_m) < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS)
def test_a_chessboard_that_the_detector_turns_by_half_gives_the_same_pose(mount):
    plan = cell(10, mount, seed=0)
    scans, T_base_tool = noisy_scans(plan, np.random.default_rng(10))
    turned = [replace(scan, point_m=2 * BOARD.corners_m.mean(axis=0) - scan.point_m)
              if i in (1, 4, 5, 8) else scan for i, scan in enumerate(scans)]  # fmt: skip
    T = [calibrate(plan, each, stated(T_base_tool)).fit.T_robot_cam for each in (scans, turned)]
    np.testing.assert_allclose(T[0], T[1], atol=1e-7)


def test_squares_of_a_wrong_size_are_refused():
    plan = cell(5, "in-hand", seed=0)
    wrong = [replace(scan, point_m=1.2 * scan.point_m) for scan in plan.scans()]
    with pytest.raises(CalibrationError, match=r"depth of the board is 0\.8333 times"):
        calibrate(plan, wrong, stated(plan.T_base_tool))


@pytest.mark.slow
def test_squares_that_are_one_percent_too_large_cause_a_warning():
    plan = cell(6, "in-hand", seed=0)
    wrong = [replace(scan, point_m=1.01 * scan.point_m) for scan in plan.scans()]
    warnings = calibrate(plan, wrong, stated(plan.T_base_tool)).warnings
    assert any("depth differs by -0.99 %" in w for w in warnings)


def test_poses_from_which_no_board_is_visible_are_refused_before_a_scan():
    plan = replace(cell(6, "in-hand", seed=0), T_other_board=pose((0, 0, 0), (5, 5, 5)))
    with pytest.raises(CalibrationError, match="sees the board from 0 of 6 poses"):
        predict(plan)
