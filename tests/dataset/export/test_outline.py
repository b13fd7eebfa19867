"""Polygons of masks, rasterised again by pycocotools and by counting crossings."""

import cv2
import numpy as np
import pytest
from backends import slow
from pycocotools import mask as coco_mask

from graycast.dataset.export.outline import INSET_PX, path, polygons, rings

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def area(corner):
    """Return the area by the shoelace formula; positive for clockwise on the screen."""
    x, y = corner.T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def crossings(polygon, shape):
    """Return the pixels whose centres are inside by the even-odd rule, computed by definition."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    inside = np.zeros(shape, dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            t = (y - y0) / (y1 - y0)
            inside ^= (t >= 0) & (t < 1) & (x0 + t * (x1 - x0) > x)
    return inside


@pytest.mark.parametrize("density", [0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_random_masks_with_holes_and_pieces_are_restored_from_their_polygons(density, seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 30, 2).tolist())
    mask = rng.random(shape) < density
    mask[0, 0] = True
    whole = [np.rint(ring) for ring in rings(mask)]
    assert sum(area(ring) for ring in whole) == mask.sum()
    assert np.array_equal(crossings(path(mask), shape), mask)
    for shapes in ([path(mask)], polygons(mask)):
        lists = [polygon.ravel().astype(float).tolist() for polygon in shapes]
        runs = coco_mask.merge(coco_mask.frPyObjects(lists, *shape))
        assert np.array_equal(coco_mask.decode(runs), mask)


def test_a_single_pixel_is_a_square_from_its_corner():
    mask = np.zeros((4, 5), dtype=bool)
    mask[2, 3] = True
    near, far = INSET_PX, 1 - INSET_PX
    corner = [(3 + x, 2 + y) for x in (near, far) for y in (near, far)]
    assert sorted(map(tuple, path(mask).tolist())) == corner


def test_pixels_that_touch_at_a_corner_are_two_polygons():
    assert [len(ring) for ring in rings(np.eye(2, dtype=bool))] == [4, 4]


def painted(shapes, shape):
    """Paint as Ultralytics does: coordinates are truncated, then `fillPoly`."""
    image = np.zeros(shape, dtype=np.uint8)
    for polygon in shapes:
        cv2.fillPoly(image, [polygon.astype(np.int32)], 1)
    return image == 1


def blob(rng):
    """Return the mask of a small visible part: a rotated box, sometimes with a hole."""
    mask = np.zeros((40, 44), dtype=np.uint8)
    size = rng.uniform(1, 14, 2)
    box = cv2.boxPoints((rng.uniform(16, 24, 2), size, rng.uniform(0, 90)))
    cv2.fillPoly(mask, [np.rint(box).astype(np.int32)], 1)
    if size.min() > 8:
        cv2.circle(mask, tuple(map(int, box.mean(axis=0))), 2, 0, -1)
    return mask == 1


def test_painted_outlines_of_small_parts_equal_their_masks():
    """Outlines along borders of pixels gave a median IoU of 0.73, and 0.42 at worst."""
    rng, overlap = np.random.default_rng(1), []
    for _ in range(300):
        mask = blob(rng)
        inside = painted(polygons(mask), mask.shape)
        overlap.append((inside & mask).sum() / (inside | mask).sum())
    assert min(overlap) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("density", [slow(0.3), 0.7])
def test_painted_outlines_of_masks_with_many_holes_add_few_pixels(density):
    """Only the cuts between a hole and the border are painted in addition to the mask."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        mask = rng.random((30, 30)) < density
        inside = painted(polygons(mask), mask.shape)
        assert not (mask & ~inside).any()
        assert (inside & ~mask).sum() <= 0.05 * mask.sum()
