"""Votes of pairs of points, and the clusters of poses that the votes form, tested separately."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation
from stage import BOX_CORNERS, box_part, lambert

from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.robot.pose import pose_model
from graycast.robot.pose.closest import OrientedPoints
from graycast.robot.pose.finding import _bundled
from graycast.robot.pose.pairs import TURNS, pair_table, votes
from graycast.world.parts import Mesh, Symmetry

STEP_M = 0.004


def scattered(count, seed=0):
    """Return random positions and normals, of which hardly two pairs have the same feature."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    return rng.uniform(-0.03, 0.03, (count, 3)), normal / np.linalg.norm(normal, axis=1)[:, None]


def moved(T, point, normal):
    return transform_points(T, point), normal @ T[:3, :3].T


SOMEWHERE = rigid(
    Rotation.random(rng=np.random.default_rng(4)).as_matrix(), np.array([0.1, 0, 0.8])
)


def voted(scene, model, references, *, step_m=STEP_M, peaks=1):
    """Return the votes as a search requests them, with read-only data of the model."""
    for array in model:
        array.flags.writeable = False
    points = OrientedPoints(*model)
    table = pair_table(points, step_m)
    for array in (table.start, table.first, table.turn_rad):
        array.flags.writeable = False
    return votes(OrientedPoints(*scene), np.array(references), points, table, peaks)


def test_every_point_pair_is_in_the_table_with_a_feature_invariant_to_motion():
    point, normal = scattered(60)
    table = pair_table(OrientedPoints(point, normal), STEP_M)
    assert len(table.first) == table.start[-1] == 2 * (pdist(point) > STEP_M / 2).sum()
    assert set(np.bincount(table.first)) <= {58, 59}
    again = pair_table(OrientedPoints(*moved(SOMEWHERE, point, normal)), STEP_M)
    rows = min(len(table.start), len(again.start))  # The largest distances may differ.
    np.testing.assert_array_equal(again.start[:rows], table.start[:rows])
    np.testing.assert_array_equal(again.first, table.first)
    for k in range(60):  # The angles about a point's normal must all change by the same amount.
        turn = (again.turn_rad - table.turn_rad)[table.first == k].astype(float)
        np.testing.assert_allclose(np.exp(1j * turn), np.exp(1j * turn[0]), atol=1e-5)


def test_votes_of_each_reference_point_are_within_half_a_bin_of_the_rotation():
    point, normal = scattered(60)
    index = np.arange(5, 45)
    T, weight = voted(moved(SOMEWHERE, point[index], normal[index]), (point, normal), range(10))
    for i, pose in enumerate(T):
        np.testing.assert_allclose(
            transform_points(pose, point[index[i]]), transform_points(SOMEWHERE, point[index[i]])
        )
        np.testing.assert_allclose(
            pose[:3, :3] @ normal[index[i]], SOMEWHERE[:3, :3] @ normal[index[i]]
        )
        off = Rotation.from_matrix(pose[:3, :3].T @ SOMEWHERE[:3, :3]).magnitude()
        assert off < 1.001 * np.pi / TURNS
        assert weight[i] > 30  # At most 39 pairs have a whole vote each.


@pytest.mark.parametrize("points", [2, 3, 6])
def test_the_weight_of_a_vote_is_one_over_the_root_of_pairs_with_its_feature(points):
    """Points are in a row; all pairs of neighbours, in both directions, have the same feature."""
    model = np.zeros((points, 3)), np.tile([0.0, 0.0, 1.0], (points, 1))
    model[0][:, 0] = 0.01 * np.arange(points)
    scene = np.array([[0.2, 0, 0], [0.21, 0, 0]]), np.tile([0.0, 0.0, 1.0], (2, 1))
    _, weight = voted(scene, model, [0])
    assert weight[0] == pytest.approx(1 / np.sqrt(2 * (points - 1)))


HALF_M = np.array([0.04, 0.03, 0.02])


@pytest.fixture(scope="module")
def block():
    """Return a block of 40 x 30 x 20 mm about (5, -10, 20) mm, symmetric by half a turn about z."""
    middle = np.array([0.005, -0.01, 0.02])
    mesh = Mesh(
        vertices_m=BOX_CORNERS * HALF_M / 2 + middle, faces=box_part(1.0, lambert(0.5)).mesh.faces
    )
    half = rigid(axis_rotation("z", np.pi), middle - axis_rotation("z", np.pi) @ middle)
    turned = Symmetry(continuous=(((0.0, 0.0, 2.0), tuple(middle)),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graycast.robot.pose.closest.CELLS", 20)  # Votes do not use this grid.
        return pose_model(mesh, Symmetry(discrete=(half,))), pose_model(mesh, turned), half


def about(T, middle, axis, angle):
    R = axis_rotation(axis, angle)
    return T @ rigid(R, middle - R @ middle)


def test_votes_for_similar_poses_are_added_and_the_best_pose_remains(block):
    """Three similar poses with 3, 2 and 2 votes, one rotated by the symmetry, exceed one with 5."""
    model, _, half = block
    near = SOMEWHERE @ rigid(axis_rotation("x", 0.05), np.array([0.001, 0, 0]))
    other = SOMEWHERE @ rigid(axis_rotation("x", np.pi / 2), np.zeros(3))
    T = np.stack([other, near @ half, SOMEWHERE, near])
    poses = _bundled(model, T, np.array([5.0, 2.0, 3.0, 2.0]))
    np.testing.assert_array_equal(poses, [SOMEWHERE, other])


def test_rotations_about_an_axis_of_symmetry_form_one_cluster(block):
    _, model, _ = block
    middle = np.array([0.005, -0.01, 0.02])
    turned = [about(SOMEWHERE, middle, "z", angle) for angle in (0.0, 1.0, 2.5)]
    tilted = about(SOMEWHERE, middle, "x", 0.5)
    poses = _bundled(model, np.stack([*turned, tilted]), np.array([1.0, 1.0, 1.0, 2.0]))
    np.testing.assert_array_equal(poses, [turned[0], tilted])
