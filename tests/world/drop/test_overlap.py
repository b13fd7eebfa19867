import numpy as np
import pytest
import trimesh

from graycast.base.frames import axis_rotation
from graycast.world.drop.rapier import overlap_m

CUBE = np.array(trimesh.creation.box((0.02, 0.02, 0.02)).vertices)


@pytest.mark.parametrize("depth_m", [1e-5, 5e-4, 4e-3])
def test_the_overlap_of_two_cubes_equals_the_distance_of_their_push(depth_m):
    assert overlap_m(CUBE, CUBE + np.array([0.02 - depth_m, 0.001, 0.002])) == pytest.approx(
        depth_m
    )


def test_two_crossed_edges_overlap_by_the_distance_along_their_common_normal():
    """Both cubes are rotated by 45 degrees onto an edge; these edges overlap by 1 mm."""
    lower = CUBE @ axis_rotation("x", np.pi / 4).T
    upper = CUBE @ axis_rotation("y", np.pi / 4).T + [0, 0, 0.02 * np.sqrt(2) - 1e-3]
    assert overlap_m(lower, upper) == pytest.approx(1e-3)


def test_separate_cubes_do_not_overlap_even_if_their_bounding_boxes_do():
    turned = CUBE @ axis_rotation("z", np.pi / 4).T
    assert overlap_m(CUBE, CUBE + np.array([0.021, 0, 0])) == 0
    # The face of `turned` is opposite the corner of CUBE along the diagonal.
    corner_gap = (0.01 + 0.01 / np.sqrt(2)) * 1.05 * np.array([1, 1, 0])
    assert overlap_m(CUBE, turned + corner_gap) == 0
    assert overlap_m(CUBE, turned + corner_gap / 1.2) > 0
