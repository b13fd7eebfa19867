"""Scores of poses in closed form: a box covers 40 x 30 pixels, and depth is set by the test."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from stage import BOX_CORNERS, box_part, lambert

from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics, rays
from graycast.robot.pose.agreement import GOING_ON, HIDING, OFF_CENTRE, OUTSIDE, score
from graycast.robot.pose.drawing import Canvas, Facets, Window, lens

CAMERA = Optics(width_px=120, height_px=90, fx_px=500.0, fy_px=500.0, cx_px=59.5, cy_px=44.5)
TOLERANCE_M = 1e-3
FRONT_M = 0.5  # z of the front, at which a pixel is 1 mm wide
# The box is 40 x 30 x 10 mm. Its front faces the camera, and the floor is 10 mm behind the front.
HALF_M = np.array([0.020, 0.015, 0.005])
FACES = box_part(1.0, lambert(0.5)).mesh.faces
HERE = rigid(np.eye(3), np.array([0.0, 0.0, FRONT_M + HALF_M[2]]))
PART, LEFT, RIGHT, BESIDE = (
    np.s_[30:60, first:end] for first, end in ((40, 80), (40, 60), (60, 80), (80, 100))
)
NEARER_M, FARTHER_M = FRONT_M - 0.005, FRONT_M + 0.005


def covered(*windows):
    inside = np.zeros((90, 120), bool)
    for window in windows:
        inside[window] = True
    return inside


def depth(window=PART, z_m=FRONT_M):
    """Return the depth of the box on its floor, with another depth in a window."""
    z = np.full((90, 120), FRONT_M + 2 * HALF_M[2])
    z[PART] = FRONT_M
    z[window] = z_m
    return z


def worth(z, inside, *, tight, T=HERE, half_m=HALF_M):
    y, x = np.mgrid[:90, :120].astype(float)
    ray = np.ascontiguousarray(rays(CAMERA, np.stack([x, y], axis=-1))[..., :2])
    part = Facets(BOX_CORNERS * half_m, FACES.copy(), np.zeros(FACES.shape))
    for array in (ray, *part, z, inside):  # read-only, as in a search
        array.flags.writeable = False
    rows, columns = np.nonzero(inside)
    box = np.array([columns.min(), rows.min(), columns.max(), rows.max()])
    window = Window(lens(CAMERA), ray, 0, 0, z, inside, tight)
    canvas = Canvas(np.empty(z.shape), np.empty(z.shape, np.int64))
    return score(T, part, window, box, TOLERANCE_M, canvas)[0]


@pytest.mark.parametrize(
    ("right", "outline", "expected"),
    [
        (FRONT_M, [PART], 1),
        (NEARER_M, [PART], 1 / 2),  # In the outline, surfaces in front of the part contradict it.
        (NEARER_M, [LEFT], 1),  # Outside the outline, something hides the part.
        (FARTHER_M, [PART], 1 / 2),  # The ray went through the part.
        (FARTHER_M, [LEFT], 1 / 2),
        (np.nan, [PART], 1),
        (np.nan, [LEFT], 1),
        (FRONT_M, [LEFT], 1 / 2),  # The part extends beyond its outline.
        (FRONT_M, [PART, BESIDE], 2 / 3),  # The outline has 600 pixels without a part.
    ],
)
def test_a_score_in_an_outline_is_the_share_of_agreeing_pixels(right, outline, expected):
    assert worth(depth(RIGHT, right), covered(*outline), tight=True) == expected


def test_outline_pixels_outside_the_part_lower_the_score_even_without_depth():
    z = depth(BESIDE, np.nan)
    assert worth(z, covered(PART, BESIDE), tight=True) == 2 / 3


@pytest.mark.parametrize(
    ("right", "expected"),
    [
        (FRONT_M, 1),
        # Hidden pixels are not visible, so the centre of the visible part moves by a quarter width.
        (NEARER_M, 1 / 2 - HIDING / 2 - OFF_CENTRE / 4),
        (FARTHER_M, 0),
        (np.nan, 1 / 2),
    ],
)
def test_a_score_in_a_box_is_reduced_by_contradicting_pixels(right, expected):
    assert worth(depth(RIGHT, right), covered(PART), tight=False) == pytest.approx(expected)


def test_a_part_off_the_centre_of_its_box_has_a_lower_score():
    """The box is 10 pixels to the right: 900 pixels are inside, 300 outside, off by 1/4 width."""
    aside = covered(np.s_[30:60, 50:90])
    expected = (900 + 300 * OUTSIDE) / 1200 - OFF_CENTRE / 4
    assert worth(depth(), aside, tight=False) == pytest.approx(expected)


@pytest.mark.parametrize("lean_rad", [0.0, 1.05, -1.05])
def test_a_part_flush_with_a_surface_has_a_lower_score(lean_rad):
    """Law: all pixels next to the part count, even if depth changes by more than the tolerance from
    pixel to pixel. They are counted in a depth map of the checking rasteriser."""
    thin_m = HALF_M * [1, 1, 0.002]
    T = rigid(axis_rotation("y", lean_rad), np.array([0.0, 0.0, FRONT_M]))
    y, x = np.mgrid[:90, :120].astype(float)
    ray = rays(CAMERA, np.stack([x, y], axis=-1))
    front = T[:3, 3] - thin_m[2] * T[:3, 2]
    z = (front @ T[:3, 2]) / (ray @ T[:3, 2])
    part = rasterize(transform_points(T, BOX_CORNERS * thin_m), FACES, CAMERA).over(CAMERA)[1]
    part = np.isfinite(part)
    around = binary_dilation(part) & ~part
    rows, columns = np.nonzero(part)
    area = np.ptp(rows) + 1, np.ptp(columns) + 1
    expected = (part.sum() - GOING_ON * around.sum()) / (area[0] * area[1])
    assert worth(z, part, tight=False, T=T, half_m=thin_m) == pytest.approx(expected)
