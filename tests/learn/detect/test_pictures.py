"""Test that labels move with the picture, and that every draw is reproducible."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: pip install 'graycast[detect]'")

from learn.detect.drawn import write_shapes

from graycast.base.errors import GraycastError
from graycast.dataset.read.example import Example
from graycast.dataset.training import open_examples
from graycast.dataset.training.sources import Examples
from graycast.learn.detect.encoding import Encoding
from graycast.learn.detect.training import _range_m
from graycast.learn.detect.training_pictures import (
    NO_AUGMENTATION,
    Augmentation,
    TrainingPictures,
    collate,
)

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SIZE = (96, 128)
DEPTH = Encoding(input="depth_sl", size_px=SIZE, near_m=0.5, far_m=1.1, relief=False)


def one(example, tmp_path, *, encoding=DEPTH, masks=True, min_visibility=0.1, **settings):
    examples = Examples(
        folder=tmp_path,
        split="train",
        scene_ids=(0,),
        categories={1: "a"},
        place_of={0: (0, "", 0)},
        read=lambda _: example,
    )
    augmentation = Augmentation(**settings) if settings else NO_AUGMENTATION
    return TrainingPictures(
        [(examples, {1: 0})],
        encoding,
        tmp_path / "pictures.npy",
        masks=masks,
        min_visibility=min_visibility,
        augmentation=augmentation,
        seed=5,
    )


def block(*, rows, columns, visib_fract=1.0):
    """Return a picture of a block on a floor, with its labels."""
    depth_m = np.full(SIZE, 1.0, np.float32)
    mask = np.zeros((1, *SIZE), bool)
    mask[0, rows[0] : rows[1], columns[0] : columns[1]] = True
    depth_m[mask[0]] = 0.6
    edge = [columns[0], rows[0], columns[1] - columns[0], rows[1] - rows[0]]
    return Example(
        scene_id=0,
        scanner_depth_m=depth_m,
        obj_id=np.array([1]),
        mask=mask,
        box_px=np.array([edge], np.float32),
        visib_fract=np.array([visib_fract]),
    )


def test_augmentation_moves_picture_mask_and_box_together(tmp_path):
    """Oracle: the block's own pixels in the moved picture, found by their height."""
    pictures = one(block(rows=(30, 50), columns=(40, 75)), tmp_path, zoom=1.5, depth_shift=0.0)
    corners = set()
    for epoch in range(40):
        image, target = pictures.at(epoch)[0]
        if target.ignored[0]:
            continue
        height = image[0].numpy()
        risen = (height < 0.0) & (image[1].numpy() > 0.5)  # floor 0.67, block -0.67
        rows, columns = np.nonzero(risen)
        box = target.box[0].numpy()
        extent_px = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        np.testing.assert_allclose(box, extent_px, atol=1.01)
        assert (target.mask[0].numpy() ^ risen).sum() <= 0.06 * risen.sum() + 8
        corners.add((round(float(box[0])), round(float(box[1]))))
    assert len(corners) > 15  # The box moved between the pictures.


def test_a_picture_without_augmentation_equals_the_encoded_picture(tmp_path):
    example = block(rows=(30, 50), columns=(40, 75))
    image, target = one(example, tmp_path)[0]
    expected = DEPTH.encode(example, seed=0).astype(np.float16).astype(np.float32)
    np.testing.assert_array_equal(image.numpy(), expected)
    np.testing.assert_array_equal(target.box.numpy(), [[40, 30, 75, 50]])
    np.testing.assert_array_equal(target.mask.numpy(), example.mask)


def test_augmentation_depends_only_on_seed_epoch_and_picture(tmp_path):
    pictures = one(block(rows=(30, 50), columns=(40, 75)), tmp_path, zoom=1.5)
    first = pictures.at(3)[0][0]
    pictures.at(4)[0]
    assert torch.equal(pictures.at(3)[0][0], first)
    assert not torch.equal(pictures.at(4)[0][0], first)


def test_hidden_and_cut_off_instances_are_ignored(tmp_path):
    hidden = block(rows=(30, 50), columns=(40, 75), visib_fract=0.05)
    assert one(hidden, tmp_path)[0][1].ignored.tolist() == [True]
    assert one(hidden, tmp_path, min_visibility=0.05)[0][1].ignored.tolist() == [False]
    edge = one(block(rows=(0, 8), columns=(0, 8)), tmp_path, zoom=2.0, flip=False)
    for epoch in range(60):
        target = edge.at(epoch)[0][1]
        if len(target.box):
            x0, y0, x1, y1 = target.box[0].tolist()
            assert target.ignored.tolist() in ([True], [False])
            if not target.ignored[0]:
                assert min(x1 - x0, y1 - y0) > 8 * 0.5 / 3
    assert any(len(edge.at(epoch)[0][1].box) == 0 for epoch in range(60))


def test_depth_is_shifted_by_at_most_the_stated_value_and_holes_stay_holes(tmp_path):
    """The limit is 0.2 of the working volume (2 in the input); one of 100 draws is near it."""
    example = block(rows=(30, 50), columns=(40, 75))
    depth_m = example.scanner_depth_m.copy()
    depth_m[:10] = np.nan
    gap = Example(
        scene_id=0, scanner_depth_m=depth_m, obj_id=example.obj_id, mask=example.mask,
        box_px=example.box_px,
    )  # fmt: skip
    pictures = one(gap, tmp_path, flip=False, zoom=1.0, depth_shift=0.2)
    heights = set()
    for epoch in range(100):
        image = pictures.at(epoch)[0][0]
        assert (image[0, :9] == 0).all()
        heights.add(round(float(image[0, 80, 80]), 4))
    assert len(heights) > 90
    shift = np.abs(np.array(sorted(heights)) - (1.0 - 0.8) / 0.3) / 2
    assert 0.18 < shift.max() < 0.201


def test_the_learnt_depth_range_ignores_spikes_and_adds_a_twentieth_at_each_end(tmp_path):
    """Depth from 0.612 to 0.955 m gets 17 mm more at both ends, in whole centimetres."""
    depth_m = np.linspace(0.612, 0.955, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    depth_m[40, :5], depth_m[50, :5], depth_m[60] = 0.1, 5.0, np.nan
    example = Example(scene_id=0, scanner_depth_m=depth_m)
    examples = Examples(
        folder=tmp_path, split="train", scene_ids=(0,), categories={}, place_of={0: (0, "", 0)},
        read=lambda _: example,
    )  # fmt: skip
    assert _range_m([examples], DEPTH) == (0.59, 0.98)


def test_pictures_of_a_dataset_form_batches(tmp_path):
    examples = open_examples(write_shapes(tmp_path, 3))
    pictures = TrainingPictures(
        [(examples, {1: 0, 2: 1})],
        DEPTH,
        tmp_path / "pictures.npy",
        masks=False,
        min_visibility=0.1,
        augmentation=Augmentation(),
        seed=0,
    )
    image, targets = collate([pictures[i] for i in range(3)])
    assert image.shape == (3, 2, *SIZE) and len(targets) == 3
    assert all(target.mask is None for target in targets)
    assert {int(k) for target in targets for k in target.label} == {0, 1}


def test_a_mask_model_refuses_a_dataset_without_masks(tmp_path):
    bare = Example(
        scene_id=7, scanner_depth_m=np.ones(SIZE, np.float32), obj_id=np.array([1]),
        box_px=np.array([[1, 1, 5, 5]], np.float32),
    )  # fmt: skip
    with pytest.raises(GraycastError, match=r"scene 7 has no masks.*--model yolov3"):
        one(bare, tmp_path)
