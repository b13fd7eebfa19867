"""Views that cannot belong to one rig, and impossible results, are left out or refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from backends import slow

from graycast.real.calibrate import parse_board
from graycast.real.calibrate.adjust import adjust
from graycast.real.calibrate.agreement import fit_agreeing
from graycast.real.calibrate.board import CalibrationError
from graycast.real.calibrate.calibration import _impossible
from graycast.real.calibrate.observing import (
    BoardView,
    Observed,
    ViewCorners,
    _observe_one,
    _refuse_same_pose,
    agreeing,
)
from graycast.rig.optics import Optics

from .test_calibrate_terms import NOISE_PX, SIZE, corners_of, lens

LENSES = lens(1500.0, (-0.1, 0.0, 0.0, 0.0, 0.0)), lens(1400.0, (0.0,) * 5)


@pytest.fixture(scope="module")
def observed():
    corners = corners_of(*LENSES, depth_m=0.6, seed=5)
    views = [
        ViewCorners(name=f"v{k}", corners=corners.only(corners.view == k), undecoded=0)
        for k in range(5)
    ]
    return Observed(views=tuple(views), left_out={})


def with_one(observed, edit):
    """Return the views with changed projector corners in view 2."""
    views = list(observed.views)
    corners = views[2].corners
    changed = replace(corners, projector_px=edit(corners.projector_px, observed.views))
    views[2] = replace(views[2], corners=changed)
    return replace(observed, views=tuple(views))


def turned(px, views):
    return np.array(SIZE) - 1 - px


def shifted(px, views):
    return px + np.array([150.0, 0.0])


def halved(px, views):
    return px / 2


def of_another_pose(px, views):
    return views[3].corners.projector_px


def test_all_views_from_the_same_rig_are_kept(observed):
    assert agreeing(observed, SIZE, SIZE).left_out == {}


@pytest.mark.parametrize("edit", [turned, shifted, halved, of_another_pose])
def test_a_view_that_does_not_belong_to_the_rig_is_left_out_and_named(edit, observed):
    left = agreeing(with_one(observed, edit), SIZE, SIZE)
    assert list(left.left_out) == ["v2"]
    assert len(left.views) == 4


@pytest.fixture(scope="module")
def many():
    """Return nine views of 14 corners, so that the fit cannot follow one wrong view."""
    views = []
    for seed, depth_m in ((5, 0.6), (6, 0.65), (7, 0.55)):
        corners = corners_of(*LENSES, depth_m=depth_m, seed=seed)
        for k in range(3):
            some = corners.only((corners.view == k) & (np.arange(len(corners.view)) % 6 == 0))
            views.append(ViewCorners(name=f"v{len(views)}", corners=some, undecoded=0))
    return Observed(views=tuple(views), left_out={})


@pytest.mark.slow
@pytest.mark.parametrize(
    "shift_px",
    [slow((60.0, 0.0)), slow((2.0, 0.0)), slow((5.0, 0.0)), (0.0, 5.0), slow((0.0, 8.0))],
)
def test_a_view_whose_board_moved_by_a_few_pixels_does_not_spoil_the_fit(shift_px, many):
    """All corners of the view are outliers, so the pose of its board cannot be fitted."""
    wrong = with_one(many, lambda px, views: px + np.array(shift_px))
    assert agreeing(wrong, SIZE, SIZE).left_out == {}, "it is found before the fit"
    good, fit = fit_agreeing(wrong, (SIZE, SIZE), 1, False)
    assert list(good.left_out) == ["v2"]
    assert re.search("% of its corners disagree|may have moved", good.left_out["v2"])
    for device, truth in zip((fit.camera, fit.projector), LENSES, strict=True):
        np.testing.assert_allclose(device.fx_px, truth.fx_px, rtol=5e-4)


def test_too_few_consistent_views_are_refused_with_the_reason_of_each(observed):
    few = replace(observed, views=observed.views[:2], left_out={"a": "dark 1", "b": "dark 2"})
    with pytest.raises(
        CalibrationError, match=r"of 5 views .* 2 can be used, .* views a, b, c: dark"
    ):
        few.less({"c": "dark 3"})


def test_two_views_of_the_same_pose_are_refused(observed):
    """Corners that differ only by noise show the same pose; 15 px show another pose."""
    first = observed.views[0]
    rng = np.random.default_rng(1)
    again, moved = (
        replace(
            first.corners,
            camera_px=first.corners.camera_px + by + rng.normal(0, NOISE_PX, (81, 2)),
        )
        for by in (0.0, 15.0)
    )
    with pytest.raises(CalibrationError, match="the same pose as view v0"):
        _refuse_same_pose(replace(first, corners=again), observed.views)
    _refuse_same_pose(replace(first, corners=moved), observed.views)


@pytest.mark.slow
def test_a_mirrored_code_is_reported_in_the_same_words_as_in_decode():
    """The board faces camera and projector, so its columns increase from right to left."""
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((30, 30)))
    white = np.pad(np.where(squares == 0, 20, 200), 30, constant_values=220).astype(np.uint8)
    y, x = np.indices(white.shape).astype(np.float32)
    view = BoardView(name="v0", white=white, column=0.8 * x + 0.1 * y, row=0.8 * y)
    board = parse_board("chessboard:10x7:0.03")
    assert _observe_one(view, board, (512, 384)).undecoded == 0
    with pytest.raises(CalibrationError, match="the code is a mirror image in 100 % of the pictu"):
        _observe_one(replace(view, column=400 - view.column), board, (512, 384))
    with pytest.raises(CalibrationError, match="column and row may be exchanged"):
        _observe_one(replace(view, column=view.row, row=view.column), board, (512, 384))


def test_corners_that_are_not_finite_are_refused_with_one_clear_error(observed):
    corners = observed.corners
    nothing = replace(corners, per_camera_px=np.full_like(corners.per_camera_px, np.nan))
    with pytest.raises(CalibrationError, match="no camera and projector fit these views"):
        adjust(nothing, SIZE, SIZE, radial_terms=1, tangential=False)


def device(**change):
    numbers = {"fx_px": 1000.0, "fy_px": 1000.0, "cx_px": 511.5, "cy_px": 383.5}
    return Optics(width_px=1024, height_px=768, **numbers | change)


@pytest.mark.parametrize(
    ("optics", "rms_px", "says"),
    [
        (device(fx_px=5_384_427.0, fy_px=0.37), 0.1, "focal lengths of 5.384e+06 and 0.37 px"),
        (device(fx_px=90000.0, fy_px=90000.0), 0.1, "a focal length of 9e+04 px"),
        (device(cx_px=-3000.0), 0.1, "its principal point at (-3000"),
        (device(distortion=(0.0, 4000.0, 0.0, 0.0, 0.0)), 0.1, "the distortion"),
        (device(distortion=(0.0, 0.0, -2300.0, 0.0, 0.0)), 0.1, "the distortion"),
        (device(), 9.0, "a residual of 9 px"),
    ],
)
def test_an_impossible_result_is_described(optics, rms_px, says):
    (wrong, *_) = _impossible(optics, rms_px)
    assert says in wrong


@pytest.mark.parametrize(
    "optics",
    [
        device(cy_px=850.0),  # Lens shift moves the optical axis below the picture.
        device(fx_px=1000.0, fy_px=2000.0),  # A projector may have diamond-shaped mirrors.
        device(fx_px=9000.0, fy_px=9000.0, distortion=(-0.3, 12.0, 0.0, 0.0, 0.0)),
        device(distortion=(-0.4, 0.2, 0.001, 0.001, 0.0)),
    ],
)
def test_plausible_values_of_real_devices_are_accepted(optics):
    assert list(_impossible(optics, 0.3)) == []
