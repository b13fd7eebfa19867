"""A bin fills the picture of the scanner that is chosen for it, and no corner is cut off."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest

from graycast.base.frames import inverse, transform_points
from graycast.cell.framing import (
    EDGE,
    ENOUGH,
    SCANNERS,
    STEP_M,
    best_framing,
    bin_share,
    framing_line,
    part_width_px,
)
from graycast.cell.views import ViewSection, hang
from graycast.rig.optics import pinhole
from graycast.rig.pair import preset_rig, standoff_m
from graycast.world.parts import builtin_part
from graycast.world.scene import Bin, Layout, Scene

BUSHING_BIN = Bin(inner_m=(0.22, 0.16, 0.08))
LENGTHS_M = (0.12, 0.22, 0.3, 0.4, 0.55, 0.75, 1.0)  # all bins that `new` makes
ABOVE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.5], [0, 0, 0, 1]])


def bin_of_length(length_m):
    return Bin(inner_m=(length_m, round(75 * length_m) / 100, round(37.5 * length_m) / 100))


def corners(box):
    x, y, z = box.inner_m
    return np.array([*product((-x / 2, x / 2), (-y / 2, y / 2), (0, z))])


def is_inside(rig, T_world_cam, box):
    """Project with OpenCV, which is independent of the program's own projection."""
    in_camera = transform_points(inverse(T_world_cam), corners(box))
    for optics, T in ((rig.camera, np.eye(4)), (rig.projector, inverse(rig.T_cam_proj))):
        K = np.array([[optics.fx_px, 0, optics.cx_px], [0, optics.fy_px, optics.cy_px], [0, 0, 1]])
        turn, _ = cv2.Rodrigues(T[:3, :3])
        pixel = cv2.projectPoints(in_camera, turn, T[:3, 3], K, None)[0][:, 0]
        size_px = np.array([optics.width_px, optics.height_px])
        edge_px = EDGE * size_px
        if not ((pixel + 0.5 > edge_px) & (pixel + 0.5 < size_px - edge_px)).all():
            return False
    return rig.near_m <= in_camera[:, 2].min() and in_camera[:, 2].max() <= rig.far_m


@pytest.mark.parametrize("length_m", LENGTHS_M)
def test_the_chosen_scanner_sees_the_whole_bin_and_cannot_be_closer(length_m):
    box = bin_of_length(length_m)
    framing = best_framing(box)
    assert framing.missing_m <= 0
    assert is_inside(framing.rig, framing.T_world_cam, box)
    nearer = hang(ViewSection(distance_m=framing.distance_m - STEP_M), framing.rig, box)
    assert not is_inside(framing.rig, nearer, box)


@pytest.mark.slow
def test_no_other_framing_fills_a_picture_much_better_than_the_chosen_one():
    """Every distance of every scanner is tried, with OpenCV's projection."""
    box, best = BUSHING_BIN, 0.0
    for name in SCANNERS:
        rig = preset_rig(name, "full")
        for distance_m in np.arange(rig.near_m, rig.far_m, 0.05):
            T_world_cam = hang(ViewSection(distance_m=float(distance_m)), rig, box)
            if is_inside(rig, T_world_cam, box):
                best = max(best, bin_share(rig.camera, T_world_cam, box))
    assert best_framing(box).bin_share >= ENOUGH * best > 0


def test_the_chosen_framing_lets_a_bushing_s_bin_fill_most_of_the_picture():
    """At the distance where the scanner's axes meet, the bin filled only 11 % of the picture."""
    rig = preset_rig("like-phoxi-m", "small")
    T_world_cam = hang(ViewSection(distance_m=standoff_m(rig)), rig, BUSHING_BIN)
    assert bin_share(rig.camera, T_world_cam, BUSHING_BIN) < 0.12
    assert best_framing(BUSHING_BIN).bin_share > 0.65


def test_a_bin_that_fits_no_scanner_gets_the_nearest_scanner_and_its_shortfall():
    """One scanner ends 50 mm above the floor's corners, and another one misses more."""
    framing = best_framing(Bin(inner_m=(3.0, 2.25, 1.12)))
    assert framing.rig.name == "like-phoxi-xl" and framing.missing_m > 0.1
    # The corners' depths differ by more than the range of this scanner; all else fits.
    deep = Bin(inner_m=(0.02, 0.02, 0.25))
    one = best_framing(deep, ["like-phoxi-s"])
    depth_m = transform_points(inverse(one.T_world_cam), corners(deep))[:, 2]
    excess_m = max(one.rig.near_m - depth_m.min(), depth_m.max() - one.rig.far_m)
    assert one.missing_m == pytest.approx(excess_m)
    assert (np.ptp(depth_m) - 0.136) / 2 <= one.missing_m <= (np.ptp(depth_m) - 0.136) / 2 + STEP_M


def test_the_rim_of_a_bin_determines_its_share_of_the_picture():
    """The camera looks straight down from 0.5 m, where the rim hides nothing of the floor."""
    camera = pinhole(400, 300, 500.0)
    box = Bin(inner_m=(0.2, 0.1, 0.1))
    rim_px = 500 * 0.2 / 0.4, 500 * 0.1 / 0.4
    assert bin_share(camera, ABOVE, box) == pytest.approx(rim_px[0] * rim_px[1] / 120000, rel=1e-4)
    # If a bin is wider than the picture, only its visible part counts.
    wide = Bin(inner_m=(2.0, 0.1, 0.1))
    assert bin_share(camera, ABOVE, wide) == pytest.approx(rim_px[1] / 300, rel=1e-4)


def test_the_stated_width_of_a_part_is_its_longest_side_at_a_third_of_the_bin():
    """A part of 50 mm is at a depth of 0.5 - 0.09 / 3 m."""
    part = builtin_part("metal_workpiece_1")
    part = part.scaled(0.05 / float(part.mesh.extent_m.max()))
    box, camera = Bin(inner_m=(0.2, 0.1, 0.09)), pinhole(400, 300, 500.0)
    width_px = 500 * 0.05 / 0.47
    assert part_width_px(part, camera, ABOVE, box) == pytest.approx(width_px)
    rig = replace(preset_rig("paper", "small"), camera=camera)
    scene = Scene(rig=rig, T_world_cam=ABOVE.copy(), parts=(part,), bin=box)
    line = framing_line(scene)
    assert line == f"the bin fills {100 * bin_share(camera, ABOVE, box):.0f} % of the picture, " + (
        "metal_workpiece_1 is 53 px wide"
    )
    parts = tuple(replace(part.scaled(k), name=f"part {k}") for k in (1.0, 2.0, 3.0, 4.0))
    assert "parts are 53 to 213 px wide" in framing_line(replace(scene, parts=parts))
    only = Layout(T_world_part=np.eye(4)[None], part_index=np.array([1]))
    assert "picture, part 2.0 is 106 px wide" in framing_line(replace(scene, parts=parts), only)
