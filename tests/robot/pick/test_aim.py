"""The order of detections: free parts, covered parts, and parts on which a grip failed."""

import numpy as np
import pytest

from graycast.base.frames import axis_rotation, rigid
from graycast.rig.optics import Optics
from graycast.robot.grasp import DepthView
from graycast.robot.pick.bin import aim as aiming
from graycast.robot.pick.bin.aim import (
    Aim,
    Candidate,
    covered_share,
    ranked,
    spread,
    trial_order,
    whole_bin,
)
from graycast.robot.pose import PoseMatch, PoseModel
from graycast.world.scene import Bin

CAMERA = Optics(width_px=80, height_px=60, fx_px=100.0, fy_px=100.0, cx_px=39.5, cy_px=29.5)
LOOKING_DOWN = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))


def square(left, top, size=20):
    mask = np.zeros((60, 80), bool)
    mask[top : top + size, left : left + size] = True
    return mask


def scene(*plates):
    """Return a floor at 1 m with plates: masks with their depths, the later ones on top."""
    depth_m, owner = np.ones((60, 80)), np.full((60, 80), -1)
    for i, (mask, plate_m) in enumerate(plates):
        depth_m[mask], owner[mask] = plate_m, i
    candidates = [Candidate(kind=0, score=1.0, mask=owner == i) for i in range(len(plates))]
    return DepthView(depth_m=depth_m, camera=CAMERA, T_world_cam=LOOKING_DOWN), candidates


def test_the_covered_share_of_an_outline_follows_geometry():
    """A strip across a square leaves two rectangles of 20 x 6 and covers one long side of each."""
    strip = np.zeros((60, 80), bool)
    strip[26:34, 5:60] = True
    view, (below, _) = scene((square(20, 20), 0.97), (strip, 0.94))
    share = covered_share(below.mask, view.depth_m)
    # The window of five pixels also reaches the strip from the two rows next to it.
    assert share == pytest.approx((2 * 20 + 4) / (2 * (2 * 20 + 2 * 4)), abs=0.03)


def test_all_surfaces_in_the_bin_are_candidates_without_a_detector():
    """The floor, objects outside the walls, and pixels without depth are excluded."""
    view, (inside, _) = scene((square(30, 20), 0.97), (square(0, 20), 0.90))
    view.depth_m[25, 35] = np.nan
    expected = inside.mask.copy()
    expected[25, 35] = False
    assert np.array_equal(whole_bin(view, Bin(inner_m=(0.3, 0.4, 0.1))), expected)


@pytest.mark.parametrize("kind", ["box", "mask"])
def test_a_pose_is_estimated_in_a_detector_s_box_or_in_a_true_mask(kind, monkeypatch):
    called = []
    for name, sort in (("find_pose", "mask"), ("find_pose_in_box", "box")):
        result = PoseMatch(T_cam_part=np.eye(4), score=1.0)
        monkeypatch.setattr(aiming, name, lambda *_, s=sort, r=result: called.append(s) or r)
    view, (target, _) = scene((square(30, 20), 0.97), (square(0, 20), 0.90))
    box_px = np.array([30.0, 20, 20, 20]) if kind == "box" else None
    target = Candidate(kind=0, score=1.0, mask=target.mask, box_px=box_px)
    assert aiming._pose(object.__new__(PoseModel), target, view) is not None and called == [kind]


def test_the_highest_or_isolated_detection_is_not_covered():
    view, (low, high) = scene((square(5, 20), 0.97), (square(50, 20), 0.90))
    assert covered_share(low.mask, view.depth_m) == 0
    assert covered_share(high.mask, view.depth_m) == 0


def test_free_detections_are_tried_before_higher_covered_detections():
    strip = np.zeros((60, 80), bool)
    strip[18:21, 0:30] = True
    view, (covered, free, top) = scene((square(5, 20), 0.90), (square(50, 20), 0.95), (strip, 0.85))
    groups = ranked([covered, free, top], view)
    assert groups == [[free], [covered], []]  # The strip is too small compared with the others.


def test_a_place_where_a_grip_failed_is_tried_last():
    view, (left, right) = scene((square(5, 20), 0.90), (square(50, 20), 0.95))
    assert ranked([left, right], view)[0] == [left, right]
    failed = np.array([(14.5 - 39.5) / 100 * 0.9, (29.5 - 29.5) / 100, 0.1])
    assert ranked([left, right], view, [failed]) == [[right], [], [left]]
    beside = failed + np.array([0.15, 0.0, 0.0])
    assert ranked([left, right], view, [beside])[0] == [left, right]
    outside = failed - np.array([10.0, 0.0, 0.0])
    assert ranked([left, right], view, [outside])[0] == [left, right]


def aim(x, z=0.0, *, score=1.0, turn=("x", 0.0)):
    T = rigid(axis_rotation(*turn), np.array([x, 0.0, z]))
    target = Candidate(kind=0, score=1.0, mask=square(0, 0))
    return Aim(T_world_tool=T, score=score, target=target)


def test_the_highest_of_several_grips_with_similar_scores_comes_first():
    low, high, doubtful = aim(0, 0.1, score=0.92), aim(0, 0.2, score=0.88), aim(0, 0.9, score=0.5)
    assert trial_order([doubtful, low, high]) == [high, low, doubtful]


@pytest.mark.parametrize(
    ("other", "round_tool", "alike"),
    [
        (aim(0.007), True, True),
        (aim(0.009), True, False),
        (aim(0.0, turn=("x", 0.2)), True, True),
        (aim(0.0, turn=("x", 0.3)), True, False),
        (aim(0.0, turn=("z", 1.5)), True, True),  # a round cup
        (aim(0.0, turn=("z", 1.5)), False, False),
        (aim(0.0, turn=("z", 3.1)), False, True),  # Jaws have no front side.
    ],
)
def test_nearly_equal_grips_are_tried_only_once(other, round_tool, alike):
    first = aim(0.0)
    aims = list(spread([first, other], 0.008, round_tool=round_tool))
    assert len(aims) == (1 if alike else 2) and aims[0] is first
