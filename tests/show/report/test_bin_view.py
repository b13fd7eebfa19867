"""The sheet shows the bin and its content to a camera that looks straight down from 0.5 m."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.rendering import GroundTruth
from graycast.rig.optics import pinhole
from graycast.rig.pair import preset_rig
from graycast.show.report.bin_view import bin_crop, depth_limits_mm
from graycast.world.scene import Bin, Scene

WIDTH, HEIGHT, F_PX = 400, 300, 500.0
ABOVE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.5], [0, 0, 0, 1]])
BOX = Bin(inner_m=(0.2, 0.1, 0.1), wall_m=0.01)
TABLE_M = 0.5


def scene_of(box):
    rig = replace(preset_rig("paper", "small"), camera=pinhole(WIDTH, HEIGHT, F_PX))
    return Scene(rig=rig, T_world_cam=ABOVE.copy(), bin=box)


def truth_of(instance=None, depth_m=None):
    if instance is None:
        instance = np.full((HEIGHT, WIDTH), -1, dtype=np.int32)
    if depth_m is None:
        depth_m = np.full((HEIGHT, WIDTH), TABLE_M, dtype=np.float32)
    normal = np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32)
    return GroundTruth(depth_m=depth_m, normal=normal, instance=instance, amodal=())


def part_at(row, column, depth_m):
    """Return a part that covers the 5 x 5 pixels from the given pixel, at a depth."""
    instance, depth = np.full((HEIGHT, WIDTH), -1, dtype=np.int32), np.full((HEIGHT, WIDTH), 0.5)
    instance[row : row + 5, column : column + 5] = 0
    depth[row : row + 5, column : column + 5] = depth_m
    return truth_of(instance, depth.astype(np.float32))


def test_the_crop_contains_the_walls_of_the_bin_and_little_more():
    """Oracle: similar triangles; the rim is 0.4 m from the camera."""
    left, top, width, height = bin_crop(scene_of(BOX), truth_of())
    rim_px = np.array([F_PX * 0.22 / 0.4, F_PX * 0.12 / 0.4])
    around_px = 0.04 * rim_px[0]
    assert (width, height) == pytest.approx(tuple(rim_px + 2 * around_px), abs=2.5)
    assert (left + width / 2, top + height / 2) == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=1)


@pytest.mark.parametrize(("row", "column"), [(2, 3), (290, 390), (150, 1)])
def test_the_crop_includes_a_part_outside_the_bin(row, column):
    left, top, width, height = bin_crop(scene_of(BOX), part_at(row, column, 0.49))
    assert left <= column and column + 5 <= left + width
    assert top <= row and row + 5 <= top + height


def test_the_crop_of_a_tall_bin_is_at_least_as_wide_as_high():
    left, top, width, height = bin_crop(scene_of(Bin(inner_m=(0.02, 0.3, 0.1))), truth_of())
    assert (top, height) == (0, HEIGHT) and width >= height
    assert left + width / 2 == pytest.approx(WIDTH / 2, abs=1)


def test_the_whole_picture_is_shown_if_no_bin_is_visible():
    whole = (0, 0, WIDTH, HEIGHT)
    assert bin_crop(scene_of(None), truth_of()) == whole
    aside = ABOVE.copy()
    aside[0, 3] = 5.0
    assert bin_crop(replace(scene_of(BOX), T_world_cam=aside), truth_of()) == whole
    behind = ABOVE.copy()
    behind[:3, :3] = np.eye(3)  # The camera looks up, away from the bin.
    assert bin_crop(replace(scene_of(BOX), T_world_cam=behind), truth_of()) == whole


def test_the_colours_of_depth_span_the_bin_and_not_the_room():
    """The rim is at 400 mm, the floor at 500 mm; the room extends to 5 m."""
    room_m = np.full((HEIGHT, WIDTH), 5.0, dtype=np.float32)
    room = truth_of(depth_m=room_m)
    assert depth_limits_mm(scene_of(BOX), room) == pytest.approx((398.0, 502.0))
    heap = depth_limits_mm(scene_of(BOX), part_at(140, 190, 0.3))  # The heap exceeds the rim.
    assert heap == pytest.approx((300 - 4, 500 + 4), abs=1e-3)
    low_mm, high_mm = depth_limits_mm(scene_of(None), part_at(140, 190, 0.3))
    assert (low_mm, high_mm) == pytest.approx((300 - 4, 500 + 4), abs=1e-3)
