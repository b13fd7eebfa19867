"""Trials of poses in a window of depth from the checking rasteriser."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stage import BOX_CORNERS, box_part, lambert

from graycast.base.frames import rigid, transform_points
from graycast.camera.crop import crop
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics
from graycast.robot.pose import pose_model
from graycast.robot.pose.agreement import VISIBLE
from graycast.robot.pose.trying import Trials
from graycast.world.parts import Mesh, Symmetry

CAMERA = Optics(width_px=200, height_px=160, fx_px=560.0, fy_px=560.0, cx_px=99.5, cy_px=79.5)
# The part is off the camera's axis, so that a shift along a ray is not along z.
T = rigid(Rotation.from_euler("xyz", [0.5, 0.3, 0.2]).as_matrix(), np.array([0.06, -0.04, 0.85]))


@pytest.fixture(scope="module")
def block():
    """Return the model of a block of 40 x 30 x 20 mm."""
    vertices = BOX_CORNERS * [0.02, 0.015, 0.01]
    mesh = Mesh(vertices_m=vertices, faces=box_part(1.0, lambert(0.5)).mesh.faces)
    return pose_model(mesh, Symmetry())


def trials(model, *, tight=True, sigma_m=0.0, hidden=False):
    """Return trials of the block in front of a floor, in its outline or in a box around it.

    If `hidden` is true, a cover 60 mm in front of the block hides the two rightmost pixels of each
    row.
    """
    vertices = transform_points(T, model.facets.vertex)
    z = rasterize(vertices, model.facets.face, CAMERA).over(CAMERA)[1]
    part = np.isfinite(z)
    rows, columns = np.nonzero(part)
    depth = np.where(part, z, 0.95) + sigma_m * np.random.default_rng(0).standard_normal(z.shape)
    inside = part.copy()
    if hidden:
        last = np.where(part.any(axis=1), 199 - part[:, ::-1].argmax(axis=1), 200)
        before = np.arange(200) > last[:, None] - 2
        depth[before] -= 0.06
        inside[before] = False
    if not tight:
        inside[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = True
    view = crop(depth, CAMERA, inside, tight=tight, reach_m=0.04, window_m=0.002)
    return Trials(model, view), len(rows)


@pytest.mark.parametrize("tight", [True, False])
def test_a_pose_is_shifted_to_the_position_and_the_depth_of_its_detection(block, tight):
    """The pose is 5 and 4 mm aside and 15 mm too far; the limit is half a pixel of 0.76 mm."""
    away = T.copy()
    away[:3, 3] += [0.005, -0.004, 0.015]
    placed = trials(block, tight=tight)[0].placed(away)
    np.testing.assert_allclose(placed[:3, 3], T[:3, 3], atol=0.76e-3)
    np.testing.assert_array_equal(placed[:3, :3], T[:3, :3])


def test_nearly_all_pixels_of_a_noisy_part_count_as_visible(block):
    """Oracle: 3.5 sigma exclude 0.05 %; the tolerance without noise equals this sigma."""
    tried, covered = trials(block, sigma_m=0.02 * block.diameter_m)
    assert tried.judge(T).number[VISIBLE] > 0.99 * covered


@pytest.mark.parametrize(("hidden", "most_m"), [(False, 0.15e-3), (True, 0.76e-3)])
def test_a_pose_with_a_small_error_is_aligned(block, hidden, most_m):
    """An error of 1.3 mm at the corners falls to a tenth of a pixel. It falls to half a pixel if
    something hides one side, because the border of this side is not the part's edge."""
    turn = Rotation.from_rotvec(np.radians([1.2, -1.2, 1.0])).as_matrix()
    off = T @ rigid(turn, np.array([0.0007, -0.0005, 0.0005]))
    aligned = trials(block, hidden=hidden)[0].align(off)
    corners = [transform_points(pose, block.facets.vertex) for pose in (off, aligned, T)]
    before_m, after_m = (np.abs(one - corners[2]).max() for one in corners[:2])
    assert after_m < most_m and before_m > 1.3e-3
