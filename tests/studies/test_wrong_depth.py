"""Labels of wrong depth: a wrong neighbour excuses nothing, a fold of the surface does."""

import numpy as np
from stage import centred

from graycast.camera.decode import DepthMap
from graycast.camera.sigma import bend_m, with_depth_term
from studies.wrong_depth import wrong_beside_right

SHAPE = 30, 40


def map_of(depth_m):
    return DepthMap(
        depth_m=depth_m.astype(np.float32),
        sigma_m=np.full(SHAPE, 1e-4, dtype=np.float32),
        reason=np.zeros(SHAPE, dtype=np.uint8),
        camera=centred(40, 30, 100.0),
    )


def test_a_wrong_neighbour_does_not_excuse_a_wrong_depth():
    """A patch is off by 1.2 mm, and one pixel in it by 30 mm, which looks like a bend."""
    true_m = np.ones(SHAPE, dtype=np.float32)
    depth_m = true_m.copy()
    depth_m[10:21, 10:21] += 1.2e-3
    depth_m[15, 15] += 30e-3
    depth = map_of(depth_m)
    beside = (np.array([14, 16, 15, 15]), np.array([15, 15, 14, 16]))
    assert not with_depth_term(depth, bend_m(depth)).is_wrong(true_m)[beside].any()
    assert wrong_beside_right(depth, true_m)[12:19, 12:19].all()  # The rim bends to the plane.


def test_a_fold_excuses_the_error_of_the_pixel_that_it_crosses():
    true_m = np.tile(1 + 4e-3 * np.abs(np.arange(40) - 20.0), (30, 1)).astype(np.float32)
    depth_m = true_m.copy()
    depth_m[:, 20] += 1.2e-3
    depth = map_of(depth_m)
    assert depth.is_wrong(true_m)[:, 20].all()
    assert not wrong_beside_right(depth, true_m).any()
