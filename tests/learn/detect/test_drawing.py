"""Test drawings of detections: the cropped area and the legibility of scores."""

import numpy as np
import pytest
from pycocotools import mask as coco_mask

from graycast.dataset.read.detections import Detections
from graycast.learn.detect.drawing import cutout_of, draw_detections, plate_places

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def detections_of(boxes, *, masks=None, score=0.9):
    return Detections(
        scene_id=0,
        score=np.full(len(boxes), score),
        obj_id=np.ones(len(boxes), np.int64),
        box_px=np.array(boxes, float).reshape(-1, 4),
        mask=masks,
    )


def test_labels_of_crowded_scores_do_not_overlap_and_are_inside_the_picture():
    """Forty centres are closer together than the width of their plates; some are at the border."""
    rng = np.random.default_rng(0)
    centers = rng.uniform((0, 0), (300, 200), (40, 2))
    plates = [one for one in plate_places(["0.93"] * 40, centers, 900, 600) if one is not None]
    assert len(plates) == 40
    count = np.zeros((600, 900), int)
    for left, top, right, bottom in plates:
        assert 0 <= left < right <= 900 and 0 <= top < bottom <= 600
        count[top:bottom, left:right] += 1
    assert count.max() == 1


def test_a_score_is_drawn_on_its_own_detection_if_there_is_room():
    centers = np.array([[100.0, 80.0], [400.0, 90.0]])
    for (x, y), plate in zip(
        centers, plate_places(["0.50", "1.00"], centers, 600, 300), strict=True
    ):
        assert plate[0] < x < plate[2] and plate[1] < y < plate[3]


def test_no_score_is_drawn_on_a_picture_that_is_too_small():
    assert plate_places(["0.93"], np.array([[5.0, 5.0]]), 10, 10) == [None]


@pytest.mark.parametrize("size", [(516, 386), (2064, 1544), (40, 30)])
def test_a_drawing_is_cropped_to_the_detections_and_enlarged(size):
    """Parts of a twentieth of the picture's width, in its middle, as a bin in a wide field has."""
    side = size[0] / 20
    boxes = np.array([[0.45 * size[0] + k * side, 0.4 * size[1], side, side] for k in range(3)])
    view = cutout_of(boxes, *size)
    assert view.left <= boxes[:, 0].min() and view.right >= (boxes[:, 0] + side).max()
    assert view.top <= boxes[:, 1].min() and view.bottom >= (boxes[:, 1] + side).max()
    assert (view.right - view.left) * (view.bottom - view.top) < 0.2 * size[0] * size[1]
    assert side * view.factor >= 90
    assert (view.right - view.left) * view.factor <= 2400


def test_a_picture_without_detections_is_shown_whole():
    view = cutout_of(np.zeros((0, 4)), 516, 386)
    assert (view.left, view.top, view.right, view.bottom) == (0, 0, 516, 386)
    drawing = draw_detections(np.zeros((386, 516, 3), np.uint8), detections_of([]), {1: "a"})
    assert drawing.shape == (386 * view.factor, 516 * view.factor, 3)


def test_an_outline_is_on_the_border_of_its_mask_and_has_a_colour_of_its_own():
    """Two squares on grey: colour is only at their borders and at the plates."""
    mask = np.zeros((60, 80), np.uint8)
    mask[20:40, 10:30] = 1
    masks = [mask, np.roll(mask, 25, axis=1)]
    runs = tuple(coco_mask.encode(np.asfortranarray(one)) for one in masks)
    boxes = [[10, 20, 20, 20], [35, 20, 20, 20]]
    drawing = draw_detections(
        np.full((60, 80, 3), 128, np.uint8), detections_of(boxes, masks=runs), {1: "a"}
    )
    view = cutout_of(np.array(boxes, float), 80, 60)
    rims = []
    for x, y, columns, rows in boxes:
        left, top = (x - view.left) * view.factor, (y - view.top) * view.factor
        middle = drawing[top + rows * view.factor // 4, left - 4 : left + 5].astype(int)
        assert np.ptp(middle, axis=1).max() > 60  # the coloured line crosses the mask's edge
        rims.append(middle[np.ptp(middle, axis=1).argmax()])
        inside = drawing[top + rows * view.factor // 4, left + columns * view.factor // 4]
        assert inside.tolist() == [128] * 3
    assert np.abs(rims[0] - rims[1]).max() > 60


def test_detections_with_scores_below_0_5_are_not_drawn():
    grey = np.full((60, 80, 3), 128, np.uint8)
    drawing = draw_detections(grey, detections_of([[10, 20, 20, 20]], score=0.49), {1: "a"})
    assert np.unique(drawing).tolist() == [128]


def test_labels_show_the_names_of_parts_if_there_are_several_parts():
    grey = np.full((60, 80, 3), 128, np.uint8)
    one = detections_of([[10, 20, 20, 20]])
    dark = [
        int((draw_detections(grey, one, names) == (25, 25, 28)).all(axis=-1).sum())
        for names in ({1: "bushing"}, {1: "bushing", 2: "nut"})
    ]
    assert dark[1] > 1.5 * dark[0]
