"""The bounding box of a mask, compared with pycocotools."""

import numpy as np
from pycocotools import mask as coco_mask

from graycast.base.mask_box import mask_box


def test_bounding_boxes_agree_with_pycocotools():
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 3, 3, 8):
        mask = np.zeros((40, 60), dtype=bool)
        mask[rng.integers(0, 40, count), rng.integers(0, 60, count)] = True
        box = coco_mask.toBbox(coco_mask.encode(np.asfortranarray(mask, dtype=np.uint8)))
        assert mask_box(mask) == tuple(box.astype(int))


def test_an_empty_mask_has_no_bounding_box():
    assert mask_box(np.zeros((5, 4), dtype=bool)) == (0, 0, 0, 0)
