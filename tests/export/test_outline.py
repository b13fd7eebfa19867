"""Polygons of masks, rasterised again by pycocotools and by counting crossings."""

import numpy as np
import pytest
from pycocotools import mask as coco_mask

from graycast.export.outline import path, polygons, rings

# pycocotools 2.0.11 has an array type from before NumPy 2, which NumPy asks it to mend.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def area(corner):
    """Shoelace formula; positive clockwise on the screen."""
    x, y = corner.T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def crossings(polygon, shape):
    """Even-odd at pixel centres, by the definition."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    inside = np.zeros(shape, dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            t = (y - y0) / (y1 - y0)
            inside ^= (t >= 0) & (t < 1) & (x0 + t * (x1 - x0) > x)
    return inside


@pytest.mark.parametrize("density", [0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_random_masks_with_holes_and_pieces_come_back_from_their_polygons(density, seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 30, 2).tolist())
    mask = rng.random(shape) < density
    mask[0, 0] = True
    assert sum(area(ring) for ring in rings(mask)) == mask.sum()
    assert np.array_equal(crossings(path(mask), shape), mask)
    for shapes in ([path(mask)], polygons(mask)):
        lists = [polygon.ravel().astype(float).tolist() for polygon in shapes]
        runs = coco_mask.merge(coco_mask.frPyObjects(lists, *shape))
        assert np.array_equal(coco_mask.decode(runs), mask)


def test_a_single_pixel_is_a_square_from_its_corner():
    mask = np.zeros((4, 5), dtype=bool)
    mask[2, 3] = True
    assert sorted(map(tuple, path(mask).tolist())) == [(3, 2), (3, 3), (4, 2), (4, 3)]


def test_pixels_that_touch_at_a_corner_are_two_rings():
    assert [len(ring) for ring in rings(np.eye(2, dtype=bool))] == [4, 4]
