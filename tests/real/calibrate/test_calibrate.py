"""Calibration of a known rig from simulated pictures of boards.

A board is a plane, so its image in each device has a closed form: a camera ray hits the plane at a
point with a colour and a projector coordinate. Only the last test uses a renderer.
"""

import math
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from stage import in_camera

from graycast.base.frames import axis_rotation, inverse, pixel_grid, rigid, transform_points
from graycast.camera.decode import DecodeSpec, Levels, decode
from graycast.real.calibrate import calibrate_rig, parse_board
from graycast.real.calibrate.board import Board, CalibrationError
from graycast.real.calibrate.corners import (
    Corners,
    find_corners,
    projector_corners,
    px_per_square_of,
    refine_corners,
)
from graycast.real.calibrate.observing import BoardView
from graycast.rendering import Quality
from graycast.rig.optics import Optics, project, rays
from graycast.rig.pair import Rig
from graycast.rig.pattern import gray
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Quad

CAMERA = Optics(
    width_px=480, height_px=360, fx_px=620.0, fy_px=621.9, cx_px=235.7, cy_px=183.1,
    distortion=(-0.21, 0.13, -0.0009, 0.0012, -0.03),
)  # fmt: skip
PROJECTOR = Optics(
    width_px=800, height_px=600, fx_px=1010.0, fy_px=1014.0, cx_px=391.2, cy_px=352.5,
    distortion=(-0.05, 0.08, 0.0011, -0.0007, 0.02),
)  # fmt: skip
TURN = axis_rotation("y", -0.22) @ axis_rotation("x", 0.03) @ axis_rotation("z", 0.01)
RIG = Rig(
    name="truth",
    camera=CAMERA,
    projector=PROJECTOR,
    T_cam_proj=rigid(TURN, np.array([0.15, -0.012, 0.01])),
    near_m=0.3,
    far_m=1.0,
)
SIZE = (PROJECTOR.width_px, PROJECTOR.height_px)
pytestmark = pytest.mark.slow  # Making the boards takes half a minute.
CHESSBOARD = parse_board("chessboard:9x7:0.025")
CHARUCO = parse_board("charuco:6x5:0.04:0.03:DICT_4X4_50")
DARK, PAPER, WALL = 0.05, 0.8, 0.3
SAMPLES = 4  # along each side of a pixel


@pytest.fixture(scope="module")
def camera_rays():
    """Return rays of the pixel centres and their change per pixel in x and y.

    Rays are assumed to be linear within a pixel, with an error of about 1e-4 px.
    """
    ray = rays(CAMERA, pixel_grid(CAMERA.height_px, CAMERA.width_px))
    return ray, np.gradient(ray, axis=1), np.gradient(ray, axis=0)


def chess_albedo(board):
    def albedo(x_m, y_m):
        i, j = np.floor(x_m / board.square_m), np.floor(y_m / board.square_m)
        inside = (i >= 0) & (i < board.squares_x) & (j >= 0) & (j < board.squares_y)
        paper = (i >= -1) & (i <= board.squares_x) & (j >= -1) & (j <= board.squares_y)
        return np.where(inside & ((i + j) % 2 == 0), DARK, np.where(paper, PAPER, WALL))

    return albedo


def charuco_albedo(board):
    """Return the albedo of a board as OpenCV draws it: an oracle for markers and corner ids."""
    cell = 48  # pixels per square, so that markers of 3/4 square and their 6 cells fit pixels
    printed = board.charuco().generateImage((cell * board.squares_x, cell * board.squares_y))

    def albedo(x_m, y_m):
        x, y = (np.floor(v / board.square_m * cell).astype(int) for v in (x_m, y_m))
        inside = (x >= 0) & (x < printed.shape[1]) & (y >= 0) & (y < printed.shape[0])
        x, y = np.clip(x, 0, printed.shape[1] - 1), np.clip(y, 0, printed.shape[0] - 1)
        return np.where(inside, np.where(printed[y, x] > 127, PAPER, DARK), PAPER)

    return albedo


def on_plane(ray, T_cam_board):
    normal = T_cam_board[:3, 2]
    return ray * (normal @ T_cam_board[:3, 3] / (ray @ normal))[..., None]


def photograph(camera_rays, T_cam_board, albedo):
    """Return a picture of the albedo: the mean of samples over the square of each pixel.

    No two samples share a row or a column, so that an edge along a row passes one at a time.
    """
    ray, by_x, by_y = camera_rays
    k = np.arange(SAMPLES**2)
    along_x = (k + 0.5) / SAMPLES**2 - 0.5
    along_y = (k % SAMPLES * SAMPLES + k // SAMPLES + 0.5) / SAMPLES**2 - 0.5
    picture = np.zeros(ray.shape[:2])
    for dx, dy in zip(along_x, along_y, strict=True):
        point = on_plane(ray + dx * by_x + dy * by_y, T_cam_board)
        on_board = (point - T_cam_board[:3, 3]) @ T_cam_board[:3, :2]
        picture += albedo(on_board[..., 0], on_board[..., 1]) / SAMPLES**2
    return picture


def code_of(camera_rays, T_cam_board):
    """Return exact projector coordinates of pixel centres; NaN outside the projector's picture."""
    point = on_plane(camera_rays[0], T_cam_board)
    code = project(PROJECTOR, transform_points(inverse(RIG.T_cam_proj), point))
    outside = ((code < -0.5) | (code > np.array(SIZE) - 0.5)).any(axis=-1)
    return np.where(outside[..., None], np.nan, code)


def view_of(camera_rays, T_cam_board, albedo, *, name="view", plain_gray=True):
    picture = photograph(camera_rays, T_cam_board, albedo)
    code = code_of(camera_rays, T_cam_board)
    picture[np.isnan(code[..., 0])] = 0.01
    code = (np.rint(code) if plain_gray else code).astype(np.float32)
    white = np.rint(4000 * picture).astype(np.uint16)
    return BoardView(name=name, white=white, column=code[..., 0], row=code[..., 1])


def in_both(board, T_cam_board):
    x, y = np.meshgrid([-0.5, board.squares_x + 0.5], [-0.5, board.squares_y + 0.5])
    corner = board.square_m * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    T_proj_board = inverse(RIG.T_cam_proj) @ T_cam_board
    for optics, T in ((CAMERA, T_cam_board), (PROJECTOR, T_proj_board)):
        pixel = project(optics, transform_points(T, corner))
        if not ((pixel > 2) & (pixel < [optics.width_px - 3, optics.height_px - 3])).all():
            return False
    return True


def poses(board, n, *, seed, tilt_rad=0.65):
    """Return boards in the fields of both devices, tilted in all directions, at several depths."""
    rng = np.random.default_rng(seed)
    half = board.square_m / 2 * np.array([board.squares_x, board.squares_y, 0])
    T_cam_boards = []
    while len(T_cam_boards) < n:
        azimuth = 2 * np.pi * len(T_cam_boards) / n + rng.uniform(-0.3, 0.3)
        rotation = (
            axis_rotation("z", azimuth)
            @ axis_rotation("x", rng.uniform(0.6, 1.0) * tilt_rad)
            @ axis_rotation("z", rng.uniform(-0.3, 0.3) - azimuth)
        )
        z_m = rng.uniform(0.42, 0.75)
        centre = z_m * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.25, 0.25), 1.0])
        T_cam_board = rigid(rotation, centre - rotation @ half)
        if in_both(board, T_cam_board):
            T_cam_boards.append(T_cam_board)
    return T_cam_boards


@pytest.fixture(scope="module")
def truth_poses():
    return poses(CHESSBOARD, 9, seed=1)


@pytest.fixture(scope="module")
def gray_views(camera_rays, truth_poses):
    return [
        view_of(camera_rays, T, chess_albedo(CHESSBOARD), name=f"pose{i}")
        for i, T in enumerate(truth_poses)
    ]


@pytest.fixture(scope="module")
def exact_views(camera_rays, truth_poses, gray_views):
    codes = [code_of(camera_rays, T).astype(np.float32) for T in truth_poses]
    return [
        replace(view, column=code[..., 0], row=code[..., 1])
        for view, code in zip(gray_views, codes, strict=True)
    ]


@pytest.fixture(scope="module")
def from_gray(gray_views):
    return calibrate_rig(gray_views, CHESSBOARD, projector_size_px=SIZE)


def assert_acceptable(calibration, *, share=1e-3, rms_px=0.1):
    """Check focal lengths, baseline and residuals of a calibration against their limits."""
    rig = calibration.rig
    for estimate, true in ((rig.camera, CAMERA), (rig.projector, PROJECTOR)):
        assert estimate.fx_px == pytest.approx(true.fx_px, rel=share)
        assert estimate.fy_px == pytest.approx(true.fy_px, rel=share)
    assert rig.baseline_m == pytest.approx(RIG.baseline_m, rel=share)
    assert calibration.camera_rms_px < rms_px
    assert calibration.projector_rms_px < rms_px


def test_a_chessboard_with_plain_gray_code_recovers_the_rig(from_gray):
    assert_acceptable(from_gray)
    T = inverse(RIG.T_cam_proj) @ from_gray.rig.T_cam_proj
    assert math.acos(min(1.0, (np.trace(T[:3, :3]) - 1) / 2)) < math.radians(0.1)


@pytest.mark.slow
def test_a_sub_pixel_code_recovers_the_rig_ten_times_better(exact_views):
    """The code relates both devices at each corner, independent of the corner's own error."""
    calibration = calibrate_rig(exact_views, CHESSBOARD, projector_size_px=SIZE)
    assert_acceptable(calibration, share=1e-4, rms_px=0.05)
    assert calibration.epipolar_rms_px < 1e-3


def test_standard_deviations_cover_the_errors(from_gray):
    """No error exceeds 5 deviations, also for terms set to 0; the RMS ratio is at least 0.1."""
    ratio = [(from_gray.rig.baseline_m - RIG.baseline_m) / from_gray.deviation["baseline_m"]]
    for device, true in (("camera", CAMERA), ("projector", PROJECTOR)):
        estimate = getattr(from_gray.rig, device)
        for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
            error = getattr(estimate, name) - getattr(true, name)
            ratio.append(error / from_gray.deviation[f"{device}.{name}"])
        for index, name in enumerate(("k1", "k2", "p1", "p2", "k3")):
            term = f"{device}.{name}"
            sigma = from_gray.undetermined.get(term, (0, from_gray.deviation.get(term)))[1]
            ratio.append((estimate.distortion[index] - true.distortion[index]) / sigma)
    assert np.abs(ratio).max() < 5
    assert np.sqrt(np.mean(np.square(ratio))) > 0.1


def test_the_poses_of_boards_are_recovered(from_gray, truth_poses):
    """A chessboard looks the same after half a turn, so only its middle and tilt are compared."""
    middle = CHESSBOARD.corners_m.mean(axis=0)
    for view, T in zip(from_gray.views, truth_poses, strict=True):
        estimate_m = transform_points(view.T_cam_board, middle)
        assert np.linalg.norm(estimate_m - transform_points(T, middle)) < 0.001 * T[2, 3] + 0.0005
        assert view.tilt_rad == pytest.approx(math.acos(abs(T[2, 2])), abs=0.003)


def test_the_working_range_contains_all_corners(from_gray, truth_poses):
    depth_m = [transform_points(T, CHESSBOARD.corners_m)[:, 2] for T in truth_poses]
    assert from_gray.rig.near_m == pytest.approx(0.9 * np.min(depth_m), rel=0.002)
    assert from_gray.rig.far_m == pytest.approx(1.1 * np.max(depth_m), rel=0.002)


@pytest.mark.slow
def test_dark_squares_with_many_missing_codes_do_not_spoil_the_calibration(gray_views):
    """Half of the dark pixels have no code, and one in twenty of all pixels has a wrong bit."""
    rng = np.random.default_rng(5)
    worse = []
    for view in gray_views:
        h, w = view.white.shape
        gone = (view.white < 500) & (rng.random((h, w)) < 0.5)
        codes = []
        for code in (view.column, view.row):
            flipped = code + np.where(rng.random((h, w)) < 0.5, 1, -1) * 2 ** rng.integers(2, 9)
            codes.append(np.where(rng.random((h, w)) < 0.05, flipped, code).astype(np.float32))
            codes[-1][gone] = np.nan
        worse.append(replace(view, column=codes[0], row=codes[1]))
    calibration = calibrate_rig(worse, CHESSBOARD, projector_size_px=SIZE)
    assert_acceptable(calibration)
    assert not any(view.left_out for view in calibration.views)


@pytest.mark.slow
def test_a_charuco_board_half_out_of_the_picture_recovers_the_rig(camera_rays):
    """The corners of a ChArUco board have ids, so some of them are enough."""
    views = []
    for i, T in enumerate(poses(CHARUCO, 10, seed=3, tilt_rad=0.55)):
        if i % 3 == 0:
            middle = transform_points(T, CHARUCO.corners_m.mean(axis=0))
            T = rigid(T[:3, :3], T[:3, 3] + [0.3 * middle[2] - middle[0], -middle[1], 0])
        views.append(view_of(camera_rays, T, charuco_albedo(CHARUCO), name=f"pose{i}"))
    calibration = calibrate_rig(views, CHARUCO, projector_size_px=SIZE)
    assert_acceptable(calibration)
    assert min(view.corners for view in calibration.views) < 0.8 * CHARUCO.corner_count


def test_charuco_corners_have_the_right_ids(camera_rays):
    T = poses(CHARUCO, 1, seed=8)[0]
    corners = find_corners(photograph(camera_rays, T, charuco_albedo(CHARUCO)), CHARUCO)
    true = project(CAMERA, transform_points(T, CHARUCO.corners_m[corners.id]))
    assert len(corners.id) >= 0.9 * CHARUCO.corner_count
    assert np.abs(corners.position_px - true).max() < 0.1


def test_corners_are_located_to_a_few_hundredths_of_a_pixel(gray_views, truth_poses):
    """The error is at most a third of OpenCV's sub-pixel error in the same sharp pictures."""
    ours, opencv = [], []
    for view, T in zip(gray_views[:4], truth_poses[:4], strict=True):
        corners = find_corners(view.white, CHESSBOARD)
        true = project(CAMERA, transform_points(T, CHESSBOARD.corners_m))
        ours.append(to_nearest(corners.position_px, true))
        byte = np.minimum(view.white // 13, 255).astype(np.uint8)
        _, opencv_px = cv2.findChessboardCornersSB(byte, (8, 6), flags=cv2.CALIB_CB_ACCURACY)
        opencv.append(to_nearest(opencv_px.reshape(-1, 2), true))
    ours, opencv = np.concatenate(ours), np.concatenate(opencv)
    assert np.sqrt(np.square(ours).mean()) < 0.03
    assert ours.max() < 0.1
    assert np.sqrt(np.square(ours).mean()) < np.sqrt(np.square(opencv).mean()) / 3


def to_nearest(point, targets):
    return np.linalg.norm(point[:, None] - targets, axis=2).min(axis=1)


def test_a_sharp_edge_along_the_pixel_rows_does_not_move_a_corner():
    """Symptom: corners were 0.8 px off where a sharp edge was within a degree of the rows."""
    y, x = np.mgrid[0:41, 0:41]
    fine = np.arange(10) / 10 - 0.45
    worst = 0.0
    for shift in (0.0, 0.17, 0.5, 0.83):
        dx = x[..., None, None] + fine[:, None] - 20 - shift
        dy = y[..., None, None] + fine - 20 - shift
        image = 0.5 + 0.4 * (np.sign(dx + 0.004 * dy) * np.sign(dy - 0.004 * dx)).mean(axis=(2, 3))
        corner_px, good = refine(image, np.array([[20.3 + shift, 19.8 + shift]]))
        assert good.all()
        worst = max(worst, np.abs(corner_px - 20 - shift).max())
    assert worst < 0.03


def refine(image, start_px):
    return refine_corners(image, start_px, np.broadcast_to(30 * np.eye(2), (len(start_px), 2, 2)))


def true_corners(T_cam_board):
    position_px = project(CAMERA, transform_points(T_cam_board, CHESSBOARD.corners_m))
    id_ = np.arange(CHESSBOARD.corner_count)
    return Corners(
        id=id_,
        position_px=position_px,
        px_per_square=px_per_square_of(CHESSBOARD, id_, position_px),
    )


@pytest.mark.parametrize(("plain_gray", "allowed_px"), [(False, 0.002), (True, 0.06)])
def test_projector_corners_are_interpolated_between_the_steps_of_the_code(
    camera_rays, truth_poses, plain_gray, allowed_px
):
    """An exact code shows the error of the quadratic; Gray code adds rounding of 0.29 px RMS."""
    for T in truth_poses[:3]:
        code = code_of(camera_rays, T)
        code = (np.rint(code) if plain_gray else code).astype(np.float32)
        corner_px, _ = projector_corners(true_corners(T), code[..., 0], code[..., 1])
        true = project(
            PROJECTOR, transform_points(inverse(RIG.T_cam_proj) @ T, CHESSBOARD.corners_m)
        )
        assert np.abs(corner_px - true).max() < allowed_px


def test_a_corner_without_decoded_pixels_nearby_has_no_projector_position(camera_rays, truth_poses):
    T = truth_poses[0]
    code = code_of(camera_rays, T).astype(np.float32)
    corners = true_corners(T)
    x, y = np.rint(corners.position_px[10]).astype(int)
    code[y - 25 : y + 25, x - 25 : x + 25] = np.nan
    corner_px, _ = projector_corners(corners, code[..., 0], code[..., 1])
    assert np.isnan(corner_px[10]).all()
    assert np.isfinite(corner_px[0]).all()


def test_a_third_of_completely_wrong_pixels_does_not_move_a_corner(camera_rays, truth_poses):
    """All errors have one sign, as after a wrong coarse bit, which no average would tolerate."""
    T = truth_poses[1]
    code = code_of(camera_rays, T).astype(np.float32)
    wrong = np.random.default_rng(4).random(code.shape[:2]) < 0.33
    column = np.where(wrong, code[..., 0] + 256, code[..., 0]).astype(np.float32)
    exact_px, _ = projector_corners(true_corners(T), code[..., 0], code[..., 1])
    corner_px, _ = projector_corners(true_corners(T), column, code[..., 1])
    assert np.abs(corner_px - exact_px).max() < 0.01


@pytest.mark.slow
def test_corners_with_a_wrong_code_are_left_out_and_counted(truth_poses, exact_views):
    """Around two corners of one view, the code is off by 8 columns."""
    y, x = np.mgrid[0:360, 0:480]
    views, view = list(exact_views), exact_views[3]
    column = view.column.copy()
    for corner_px in true_corners(truth_poses[3]).position_px[[10, 29]]:
        column[np.hypot(x - corner_px[0], y - corner_px[1]) < 25] += 8
    views[3] = replace(view, column=column)
    calibration = calibrate_rig(views, CHESSBOARD, projector_size_px=SIZE)
    assert_acceptable(calibration)
    lost = [v.left_out for v in calibration.views]
    assert 2 <= lost[3] <= 10
    assert sum(lost) == lost[3]


def test_pixels_are_weighted_by_their_sigma(camera_rays, truth_poses):
    """Two fifths of the pixels are off by 0.4 columns, which is too little for an outlier."""
    T = truth_poses[0]
    code = code_of(camera_rays, T).astype(np.float32)
    sigma = np.full(code.shape[:2], 0.1, dtype=np.float32)
    rng = np.random.default_rng(2)
    bad = rng.random(sigma.shape) < 0.4
    column = np.where(bad, code[..., 0] + 0.4, code[..., 0]).astype(np.float32)
    sigma[bad] = 5.0
    exact_px, _ = projector_corners(true_corners(T), code[..., 0], code[..., 1])
    weighted_px, _ = projector_corners(
        true_corners(T), column, code[..., 1], sigma_column=sigma, sigma_row=sigma
    )
    blind_px, _ = projector_corners(true_corners(T), column, code[..., 1])
    assert np.abs(weighted_px - exact_px).max() < 0.01
    assert np.abs(blind_px - exact_px).max() > 0.05


@pytest.mark.slow
def test_a_view_whose_board_moved_is_named(camera_rays, truth_poses, gray_views):
    """After the white picture, the board moved 2 mm nearer and rotated by a degree."""
    moved = truth_poses[4] @ rigid(axis_rotation("x", 0.02), np.array([0.001, 0.0, -0.002]))
    code = np.rint(code_of(camera_rays, moved)).astype(np.float32)
    views = list(gray_views)
    views[4] = replace(views[4], column=code[..., 0], row=code[..., 1])
    calibration = calibrate_rig(views, CHESSBOARD, projector_size_px=SIZE)
    named = [w for w in calibration.warnings if "view pose" in w]
    assert named and all("pose4" in warning for warning in named)
    assert_acceptable(calibration)


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (np.s_[:, ::-1], "leaves out view pose4: the code is a mirror image"),
        (np.s_[::-1, ::-1], "leaves out view pose4: .* its pictures may be turned"),
    ],
)
def test_a_mirrored_or_rotated_view_is_left_out_and_named(gray_views, turn, says):
    """Symptom: the projector had fx 5 million and fy 0.4 px, and no error was raised."""
    view = gray_views[4]
    views = list(gray_views)
    views[4] = replace(view, white=view.white[turn], column=view.column[turn], row=view.row[turn])
    calibration = calibrate_rig(views, CHESSBOARD, projector_size_px=SIZE)
    assert_acceptable(calibration)
    assert re.search(says, " | ".join(calibration.warnings))


def test_one_pose_repeated_five_times_is_refused(gray_views):
    """Symptom: the fit did not end."""
    views = [replace(gray_views[0], name=f"pose{i}") for i in range(5)]
    with pytest.raises(CalibrationError, match=r"of 5 views .* 1 can be used.* same pose as view"):
        calibrate_rig(views, CHESSBOARD, projector_size_px=SIZE)


def test_a_few_parallel_boards_cause_a_warning(camera_rays):
    views = []
    for i, z_m in enumerate((0.5, 0.55, 0.6)):
        turn = axis_rotation("x", 0.05 + 0.05 * i) @ axis_rotation("y", 0.04 * i)
        T = rigid(turn, np.array([-0.11, -0.09, z_m]))
        views.append(view_of(camera_rays, T, chess_albedo(CHESSBOARD), name=f"pose{i}"))
    calibration = calibrate_rig(
        views, CHESSBOARD, projector_size_px=SIZE, radial_terms=1, tangential=False
    )
    text = " | ".join(calibration.warnings)
    assert "only 3 views" in text
    assert "parallel" in text
    assert "% of the camera's picture" in text
    assert "focal length is uncertain" in text
    assert calibration.rig.camera.distortion[1:] == (0.0, 0.0, 0.0, 0.0)


def test_too_few_views_are_refused(gray_views):
    with pytest.raises(CalibrationError, match="2 views of the board; at least 3"):
        calibrate_rig(gray_views[:2], CHESSBOARD, projector_size_px=SIZE)


def test_views_without_a_board_are_all_named(gray_views):
    empty = replace(gray_views[1], white=np.arange(360 * 480, dtype=np.uint16).reshape(360, 480))
    flat = replace(gray_views[2], white=np.full((360, 480), 7, dtype=np.uint8))
    with pytest.raises(
        CalibrationError, match=r"view pose1: no chessboard.*; view pose2: .* 7 everywhere"
    ):
        calibrate_rig([gray_views[0], empty, flat], CHESSBOARD, projector_size_px=SIZE)


def test_a_count_of_inner_corners_in_place_of_squares_is_recognised(gray_views):
    with pytest.raises(CalibrationError, match="counts squares, so give 9x7"):
        find_corners(gray_views[0].white, parse_board("chessboard:8x6:0.025"))


def test_a_view_with_a_code_for_only_one_axis_is_refused(gray_views):
    half = replace(gray_views[2], row=np.full((360, 480), np.nan, dtype=np.float32))
    with pytest.raises(CalibrationError, match=r"view pose2: 0 of 48 .* both axes"):
        calibrate_rig([*gray_views[:2], half], CHESSBOARD, projector_size_px=SIZE)


def test_a_projector_too_small_for_its_code_is_refused(gray_views):
    with pytest.raises(CalibrationError, match="the projector has 200 x 150 px"):
        calibrate_rig(gray_views[:3], CHESSBOARD, projector_size_px=(200, 150))


def test_views_with_different_sizes_or_equal_names_are_refused(gray_views):
    small = BoardView(
        name="small",
        white=gray_views[0].white[:300],
        column=gray_views[0].column[:300],
        row=gray_views[0].row[:300],
    )
    with pytest.raises(CalibrationError, match="view small is 480 x 300 px, view pose0 480 x 360"):
        calibrate_rig([*gray_views[:2], small], CHESSBOARD, projector_size_px=SIZE)
    with pytest.raises(CalibrationError, match="two views are named pose0"):
        calibrate_rig(
            [gray_views[0], gray_views[0], gray_views[1]], CHESSBOARD, projector_size_px=SIZE
        )


def test_a_board_is_read_from_its_text():
    assert parse_board("chessboard:9x6:0.025") == Board(squares_x=9, squares_y=6, square_m=0.025)
    assert parse_board("charuco:8x5:0.03:0.022:DICT_5X5_100:legacy") == Board(
        squares_x=8,
        squares_y=5,
        square_m=0.03,
        marker_m=0.022,
        dictionary="DICT_5X5_100",
        legacy=True,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("9x6", "give chessboard:9x6:0.025"),
        ("chessboard:9x6", "give chessboard:9x6:0.025"),
        ("chessboard:9:0.025", "give chessboard"),
        ("chessboard:9x6:25mm", "give chessboard"),
        ("chessboard:9x6:25", "square_m is 25.0; give 0.0005 to 2 metres"),
        ("chessboard:9x2:0.025", "at least 3 in each direction"),
        ("circles:9x6:0.025", "give chessboard"),
        ("charuco:8x5:0.03:0.04:DICT_5X5_100", "a marker must be smaller than its square"),
        ("charuco:8x5:0.03:0.022:5X5", "no ArUco dictionary '5X5': choose DICT_4X4_100"),
        ("charuco:20x20:0.03:0.022:DICT_4X4_50", "needs 200 markers, DICT_4X4_50 has 50"),
    ],
)
def test_a_text_that_describes_no_board_is_refused_with_the_valid_forms(text, message):
    with pytest.raises(ValueError, match=message):
        parse_board(text)


@pytest.mark.slow
def test_rendered_and_decoded_boards_recover_the_rig(mitsuba_renderer):
    """The test has all steps of a real calibration, from light to decoding, except noise."""
    code = gray(*SIZE, inverses=True)
    pattern = code.render()
    levels = Levels(offset_dn=0.0, saturation_dn=65535.0, floor_dn2=1.0, slope_dn=1.0)
    views = []
    for i, T in enumerate(poses(CHESSBOARD, 8, seed=4)):
        rendering = mitsuba_renderer.render(
            in_camera(RIG, textured_board(CHESSBOARD, T)),
            EMPTY_LAYOUT,
            pattern,
            quality=Quality(samples=16, depth=1),
            seed=i,
        )
        light = rendering.radiance.pattern
        stack = np.rint(60000 * light / light.max()).astype(np.uint16)
        codes = decode(stack, code, DecodeSpec(min_contrast=0.001), levels)
        views.append(
            BoardView(
                name=f"pose{i}",
                white=stack[0],
                column=codes.column,
                row=codes.row,
                sigma_column=codes.sigma_column,
                sigma_row=codes.sigma_row,
            )
        )
    assert_acceptable(calibrate_rig(views, CHESSBOARD, projector_size_px=SIZE))


def textured_board(board, T_cam_board, cell=24):
    """Return a chessboard with a white margin of one square on a quad, in the camera frame."""
    x, y = np.meshgrid(*(np.arange(cell * (n + 2)) for n in (board.squares_x, board.squares_y)))
    place = ((v + 0.5) / cell * board.square_m - board.square_m for v in (x, y))
    grey = np.where(chess_albedo(board)(*place) == DARK, 60, 230).astype(np.uint8)
    size_m = board.square_m * np.array([board.squares_x, board.squares_y, 0])
    half_m = size_m[:2] / 2 + board.square_m
    turn = T_cam_board[:3, :3]
    return Quad(
        center_m=tuple(transform_points(T_cam_board, size_m / 2).tolist()),
        half_u_m=tuple((half_m[0] * turn[:, 0]).tolist()),
        half_v_m=tuple((-half_m[1] * turn[:, 1]).tolist()),  # up: its front faces the camera
        material=Material(texture=np.repeat(grey[..., None], 3, axis=2), specular=0.0),
    )
