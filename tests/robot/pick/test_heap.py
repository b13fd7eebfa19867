"""The measured heap: heights in closed form, unmeasured areas, and its pose."""

import numpy as np
import pytest

from graycast.base.frames import look_at, pixel_grid
from graycast.rig.optics import Optics, rays
from graycast.robot.pick.arm.obstacles import (
    CELL_M,
    GUESSED_M,
    heap_obstacle,
    measured_heap,
    measured_points,
)
from graycast.robot.pick.arm.robot import Mounted, tool_touches
from graycast.world.scene import Bin

BOX = Bin(inner_m=(0.2, 0.16, 0.1))
CAMERA = Optics(width_px=240, height_px=200, fx_px=400.0, fy_px=400.0, cx_px=119.5, cy_px=99.5)
# The camera is tilted, so that a mistake of depth for height would be noticed.
T_WORLD_CAM = look_at(np.array([0.1, 0.05, 0.5]), np.zeros(3), np.array([0.0, 1.0, 0.0]))


def depth_of(height_of, T_world_cam=T_WORLD_CAM):
    """Return z of a surface z = height(x, y) by steps along each ray, an independent method.

    The steps are 2 mm, and then 0.2 mm from the last point above the surface.
    """
    way = rays(CAMERA, pixel_grid(CAMERA.height_px, CAMERA.width_px)) @ T_world_cam[:3, :3].T
    first = np.full(way.shape[:2], 0.35)
    for step_m, count in ((2e-3, 200), (2e-4, 11)):
        depth = np.full(first.shape, np.nan)
        for i in range(count):
            x, y, z = np.moveaxis(T_world_cam[:3, 3] + way * (first + i * step_m)[..., None], -1, 0)
            depth = np.where(np.isnan(depth) & (z <= height_of(x, y)), first + i * step_m, depth)
        first = depth - step_m
    return depth


def block(x, y):
    """Return the height of a block, 40 mm high, at a place that no mirror image shares."""
    return np.where((x > 0.02) & (x < 0.07) & (y > 0.01) & (y < 0.05), 0.04, 0.0)


def heap_of(depth, T_world_cam=T_WORLD_CAM, without=None):
    return measured_heap(measured_points(depth, CAMERA, T_world_cam, BOX), without=without)


@pytest.fixture(scope="module")
def block_m():
    return depth_of(block)


@pytest.fixture
def depth(block_m):
    return block_m.copy()


@pytest.fixture(scope="module")
def heap(block_m):
    return heap_of(block_m)


def at(heap, x, y):
    rows, columns = heap.height_m.shape
    return heap.height_m[round(y / CELL_M + (rows - 1) / 2), round(x / CELL_M + (columns - 1) / 2)]


def test_heights_of_the_heap_are_in_the_world_frame(heap):
    assert at(heap, 0.045, 0.03) == pytest.approx(0.04, abs=1e-3)
    for x, y in ((-0.045, 0.03), (0.045, -0.03), (-0.045, -0.03), (0.09, 0.03)):
        assert at(heap, x, y) == pytest.approx(0.0, abs=1e-3)


def test_a_rim_extends_beyond_the_part_by_the_tool_s_clearance(heap):
    """The camera sees the block's faces at x = 70 mm and y = 50 mm; a cell is 4 mm."""
    high = heap.height_m > 0.02
    y, x = (np.argwhere(high) - (np.array(high.shape) - 1) / 2).T * CELL_M
    assert x.max() == pytest.approx(0.07 + CELL_M, abs=CELL_M / 2 + 1e-9)
    assert y.max() == pytest.approx(0.05 + CELL_M, abs=CELL_M / 2 + 1e-9)


def test_an_unmeasured_area_has_the_height_of_the_nearest_measured_area(depth):
    inside = np.zeros(depth.shape, bool)
    rows, columns = np.nonzero(depth < np.nanmin(depth) + 0.005)  # the top of the block
    inside[rows.min() : rows.max(), (columns.min() + columns.max()) // 2 : columns.max() + 20] = 1
    heap = heap_of(np.where(inside, np.nan, depth))
    assert not heap.is_measured.all()
    # Unmeasured cells that are nearer to the measured half than to the floor belong to the block.
    guessed = ~heap.is_measured
    assert heap.height_m[guessed].max() == pytest.approx(0.04, abs=1e-3)
    assert np.isfinite(heap.height_m).all()


@pytest.mark.slow
def test_a_shadow_next_to_a_part_has_the_height_of_the_part():
    """The camera is far to the side, so that it sees nothing for 22 mm behind the block."""
    aside = look_at(np.array([0.35, 0.03, 0.5]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    heap = heap_of(depth_of(block, aside), aside)
    shadow_m = 0.04 * (0.35 - 0.02) / (0.5 - 0.04)
    for x in np.arange(0.02 - shadow_m / 3, 0.02, CELL_M):  # nearer to the block than to the floor
        assert at(heap, x, 0.03) == pytest.approx(0.04, abs=1e-3)
    assert at(heap, 0.02 - shadow_m - GUESSED_M - 2 * CELL_M, 0.03) == pytest.approx(0, abs=1e-3)


def test_a_single_high_pixel_is_ignored_and_a_thin_post_is_not(depth):
    """A single pixel, and then six adjacent pixels, are 60 mm above the floor."""
    depth[60, 60] = depth[60, 60] - 0.06
    assert heap_of(depth).height_m.max() < 0.041
    depth[60:62, 60:63] = depth[60, 60]
    assert heap_of(depth).height_m.max() > 0.05


def test_a_bin_without_depth_counts_as_full():
    nothing = np.full((CAMERA.height_px, CAMERA.width_px), np.nan)
    assert (heap_of(nothing).height_m == BOX.inner_m[2]).all()


def test_a_gripped_part_is_removed_from_the_heap_of_the_planner(heap, depth):
    top = depth < np.nanmin(depth) + 0.012
    without = heap_of(depth, without=top)
    assert at(without, 0.045, 0.03) < 0.02 < at(heap, 0.045, 0.03)


@pytest.mark.slow
def test_a_part_next_to_a_wall_does_not_become_as_high_as_the_wall():
    """The depth of walls belongs to the bin; next to the part, the heap is as high as the floor."""
    above = look_at(np.array([0.0, 0.0, 0.5]), np.zeros(3), np.array([0.0, 1.0, 0.0]))

    def beside(x, y):
        part = np.where((x > 0.055) & (x < 0.095) & (np.abs(y) < 0.03), 0.02, 0.0)
        inside = (np.abs(x) < 0.1) & (np.abs(y) < 0.08)
        return np.where(inside, part, BOX.inner_m[2])

    depth = depth_of(beside, above)
    point = above[:3, 3] + (rays(CAMERA, pixel_grid(200, 240)) * depth[..., None]) @ above[:3, :3].T
    is_measured = (point[..., 2] > 5e-4) & (point[..., 2] < 0.021) & (np.abs(point[..., 1]) < 0.032)
    is_measured &= (point[..., 0] > 0.05) & (point[..., 0] < 0.099)
    whole = heap_of(depth, above)
    assert at(whole, 0.075, 0.0) == pytest.approx(0.02, abs=1e-3)
    assert whole.height_m.max() < 0.03  # The heap has no wall.
    without = heap_of(depth, above, without=is_measured)
    assert at(without, 0.075, 0.0) < 5e-3


@pytest.mark.parametrize(
    ("x", "y", "hit"),
    [(0.045, 0.03, True), (-0.045, 0.03, False), (0.045, -0.03, False), (-0.045, -0.03, False)],
)
def test_the_planner_receives_the_heap_at_the_right_position(robots, heap, x, y, hit):
    """A ball 30 mm above the floor overlaps the block, and overlaps nothing elsewhere."""
    import coal

    obstacle = heap_obstacle(heap, np.eye(4))
    T = np.eye(4)
    T[:3, 3] = x, y, 0.03
    ball = Mounted(name="ball", shape=coal.Sphere(0.005), T_flange_shape=np.eye(4))
    assert (tool_touches([ball], T, [obstacle]) == "the heap") == hit
