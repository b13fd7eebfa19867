"""Motions that map a shape onto itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.frames import rigid
from graycast.world.parts import Mesh, Symmetry, builtin_part
from graycast.world.parts.sampling import surface_points
from graycast.world.parts.symmetry import (
    axis_rotations,
    joined,
    motions,
    nearest_member,
    shape_symmetry,
    turns_together,
)


def box(x, y, z):
    corner = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)]) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices_m=corner, faces=np.array(faces))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "order"), [((0.06, 0.04, 0.1), 4), ((0.05, 0.05, 0.1), 8), ((0.05, 0.05, 0.05), 24)]
)
def test_a_box_is_detected_to_have_the_rotations_of_its_symmetry_group(size, order):
    """Orders of the proper rotation groups D2, D4 and O; the identity is not listed."""
    estimate = shape_symmetry(box(*size))
    assert not estimate.continuous
    assert len(estimate.discrete) + 1 == order


MIDDLE, X, Z = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "size", "order"),
    [
        ([(Z, MIDDLE, 2)], None, 2),
        ([(Z, MIDDLE, 7)], None, 7),
        ([(Z, MIDDLE, 2), (X, MIDDLE, 2)], (0.06, 0.04, 0.1), 4),
        ([(Z, MIDDLE, 4), (X, MIDDLE, 2)], (0.05, 0.05, 0.1), 8),
        ([(Z, MIDDLE, 4), (X, MIDDLE, 4)], (0.05, 0.05, 0.05), 24),
    ],
)
def test_stated_rotations_generate_the_symmetry_group_of_the_shape(turns, size, order):
    """Orders of C2, C7, D2, D4 and O, and the motions that a search on the shape gives."""
    group = turns_together(turns)
    assert len(group) + 1 == order
    if size is not None:
        estimate = shape_symmetry(box(*size)).discrete
        assert all(any(np.allclose(one, other, atol=1e-6) for other in estimate) for one in group)


@pytest.mark.slow
def test_symmetry_rotations_about_axes_that_do_not_meet_are_refused():
    with pytest.raises(ValueError, match="check that their axes meet in one point"):
        turns_together([(Z, MIDDLE, 2), (X, (0.0, 0.0, 0.1), 2), (Z, (0.1, 0.0, 0.0), 3)])


def test_the_ring_is_symmetric_about_its_axis_but_not_upside_down():
    estimate = shape_symmetry(builtin_part("metal_workpiece_2").mesh)
    assert estimate.continuous[0][0] == (0.0, 0.0, 1.0)
    assert not estimate.discrete


def test_the_bracket_is_symmetric_by_its_stated_half_turn():
    part = builtin_part("metal_workpiece_1")
    estimate = shape_symmetry(part.mesh)
    assert len(estimate.discrete) == 1
    np.testing.assert_allclose(estimate.discrete[0], part.symmetry.discrete[0], atol=1e-12)
    assert len(joined(part.symmetry, estimate).discrete) == 1


def test_sampled_rotations_move_a_rim_by_less_than_a_hundredth_of_its_diameter():
    """BOP's rule: the longest chord of the body to its next rotation."""
    turns = motions(Symmetry(continuous=(((0.0, 0.0, 2.0), (0.1, 0.2, 0.0)),)))
    rim = np.array([0.1 + 0.5, 0.2, 0.3, 1.0])  # diameter 1 about an axis away from the origin
    place = turns @ rim
    chord = np.linalg.norm(np.diff(place, axis=0), axis=1)
    assert len(turns) == 315  # ceil(pi / 0.01)
    assert chord.max() <= 0.01 and chord.min() > 0.0099
    np.testing.assert_allclose(np.linalg.norm(place[:, :2] - [0.1, 0.2], axis=1), 0.5)


def test_discrete_and_continuous_symmetries_are_combined():
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    both = Symmetry(discrete=(flip,), continuous=(((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),))
    assert len(motions(both)) == 2 * 315
    np.testing.assert_array_equal(motions(both)[0], np.eye(4))


def test_there_are_24_axis_aligned_rotations():
    turns = axis_rotations()
    assert len({tuple(R.ravel()) for R in turns}) == 24
    np.testing.assert_allclose(np.linalg.det(turns), 1)


def test_surface_points_are_on_the_surface_and_one_step_apart():
    """On a box: each point is on its face's plane, and no two are closer than the step."""
    point, normal = surface_points(box(0.06, 0.04, 0.1), 0.008, most=5000)
    np.testing.assert_allclose((np.abs(point) * np.abs(normal)).sum(axis=1),
                               np.abs(normal) @ [0.03, 0.02, 0.05], atol=1e-12)  # fmt: skip
    apart = np.linalg.norm(point[:, None] - point[None], axis=-1) + np.eye(len(point))
    assert apart.min() >= 0.008
    assert apart.min(axis=1).max() < 0.018  # No point is isolated.


HALF_TURNS = tuple(np.diag([*sign, 1.0]) for sign in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
AXIS, ASIDE = (0.6, 0.0, 0.8), (0.01, 0.02, -0.03)
ACROSS = rigid(np.diag([-1.0, 1.0, -1.0]), 2 * np.array([ASIDE[0], 0.0, ASIDE[2]]))  # a half turn
SYMMETRIES = [
    Symmetry(discrete=HALF_TURNS),
    Symmetry(continuous=((AXIS, ASIDE),)),
    Symmetry(discrete=(ACROSS,), continuous=((AXIS, ASIDE),)),
]


def angle(R):
    return Rotation.from_matrix(R).magnitude()


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("referred", [False, True])
def test_poses_that_look_the_same_have_one_representative(symmetry, referred):
    """Oracle: the motions of the symmetry one by one; with a reference, their least angle, too."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        T, near = (rigid(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)) for _ in "ab")
        near = near if referred else None
        one, group = nearest_member(T, symmetry, near=near), motions(symmetry)
        for S in group[:: max(len(group) // 7, 1)]:
            again = nearest_member(T @ S, symmetry, near=near)
            np.testing.assert_allclose(again, one, atol=1e-9)
        turned = np.swapaxes((T @ np.array(group))[:, :3, :3], 1, 2)
        apart = angle(turned @ one[:3, :3])
        assert min(apart) <= np.pi / 315 + 1e-9  # one of them, at most half a step of rotation away
        closest = (T @ group[int(np.argmin(apart))])[:3, 3]
        np.testing.assert_allclose(one[:3, 3], closest, atol=5e-3)
        if referred:
            least = angle(turned @ near[:3, :3]).min()
            assert angle(one[:3, :3].T @ near[:3, :3]) <= least + 1e-9


@pytest.mark.parametrize("symmetry", [Symmetry(discrete=(s,)) for s in HALF_TURNS])
@pytest.mark.parametrize("side", [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_noise_in_the_pose_of_a_lying_part_does_not_change_its_representative(symmetry, side):
    """On each side of a box at a random angle, a tilt by a degree moves it by a degree."""
    rng = np.random.default_rng(5)
    lying = Rotation.from_euler("z", rng.uniform(10, 80), degrees=True).as_matrix() @ np.diag(side)
    first = nearest_member(rigid(lying, np.zeros(3)), symmetry)
    for _ in range(20):
        tilt = Rotation.from_rotvec(np.radians(1) * rng.normal(size=3)).as_matrix()
        T = rigid(tilt @ lying, np.zeros(3)) @ motions(symmetry)[rng.integers(2)]
        assert angle(nearest_member(T, symmetry)[:3, :3].T @ first[:3, :3]) < np.radians(6)
