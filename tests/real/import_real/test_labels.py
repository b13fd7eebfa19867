"""Import of labels as labelling tools write them, with their peculiarities and errors."""

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from graycast.base.errors import DatasetError
from graycast.dataset.check.checking import validate
from graycast.dataset.training import open_examples
from graycast.real.depth_file import FileOptions
from graycast.real.import_real import import_real

from .photos import BOX, H, K, W, coco, part, picture, write_coco, write_labelme, write_pictures

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def imported(folder):
    """Return the masks of the first picture, and the notes."""
    out = folder.with_name(f"{folder.name}-out")
    done = import_real(folder, out, files=FileOptions(K=K))
    assert validate(out) == ()
    return open_examples(out)[0].mask, done.notes


def refusal(folder):
    with pytest.raises(DatasetError) as caught:
        imported(folder)
    assert not folder.with_name(f"{folder.name}-out").exists()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_pictures_that_are_stored_rotated_are_refused(tmp_path, orientation, ending):
    """Labelling tools show such pictures upright, so masks would not be on the parts."""
    folder = write_coco(tmp_path / "photos", coco())
    exif = Image.Exif()
    exif[0x0112] = orientation
    for k in range(2):
        (folder / f"rgb/{k:06d}.png").unlink()
        Image.fromarray(picture()).save(folder / f"rgb/{k:06d}.{ending}", exif=exif)
    if orientation == 1:
        np.testing.assert_array_equal(imported(folder)[0], [part()])
    else:
        how = {3: "180 degrees ", 6: "90 degrees ", 8: "90 degrees "}.get(orientation, "mirrored ")
        words = rf"rgb/000000.{ending}: is stored .*{how}\(EXIF orientation {orientation}\)"
        assert re.search(words, refusal(folder))


@pytest.mark.parametrize(
    ("polygon", "rows", "columns", "beyond"),
    [
        ([20, -0.4, 60, -0.4, 60, 50, 20, 50], slice(0, 50), slice(20, 60), "0.4 px"),
        ([-2.6, 10, 60, 10, 60, 50, -2.6, 50], slice(10, 50), slice(0, 60), "2.6 px"),
        ([20, 10, W + 3, 10, W + 3, H + 1, 20, H + 1], slice(10, H), slice(20, W), "3 px"),
    ],
)
def test_outlines_slightly_beyond_the_picture_are_cut(tmp_path, polygon, rows, columns, beyond):
    mask, (note,) = imported(write_coco(tmp_path / "photos", coco([polygon])))
    np.testing.assert_array_equal(mask, [part(rows, columns)])
    assert f"outlines in 2 pictures lead out of the picture, by up to {beyond}" in note


def test_a_slanted_outline_is_cut_exactly_at_the_border(tmp_path):
    """Oracle: the same outline shifted by three pixels, where nothing is cut."""
    outline = np.array([[-2.3, -1.7], [50.2, 5.1], [31.4, 40.9]])
    cut, _ = imported(write_coco(tmp_path / "cut", coco([outline.ravel().tolist()])))
    whole, notes = imported(write_coco(tmp_path / "whole", coco([(outline + 3).ravel().tolist()])))
    assert notes == ()
    np.testing.assert_array_equal(cut[0, : H - 3, : W - 3], whole[0, 3:, 3:])


def test_an_outline_far_beyond_the_picture_is_not_cut(tmp_path):
    far = refusal(write_coco(tmp_path / "photos", coco([[20, 10, W + 3.1, 10, 60, 50]])))
    assert "its corner (99.1, 10) lies outside of the picture of 96 x 64 pixels" in far


def test_names_with_backslashes_are_read_and_hidden_files_are_ignored(tmp_path):
    content = coco()
    for image in content["images"]:
        image["file_name"] = f"rgb\\{image['file_name']}"
    folder = write_coco(tmp_path / "photos", content)
    for name in ("rgb/._000000.png", "annotations/._instances.json"):
        (folder / name).write_bytes(b"\0\5\x16\7")
    np.testing.assert_array_equal(imported(folder)[0], [part()])


def mask_shape(inside, x=20, y=10, **changes):
    file = io.BytesIO()
    Image.fromarray(inside).save(file, "PNG")
    rows, columns = inside.shape
    return {
        "label": "part",
        "shape_type": "mask",
        "group_id": None,
        "points": [[x, y], [x + columns - 1, y + rows - 1]],
        "mask": base64.b64encode(file.getvalue()).decode(),
    } | changes


def test_labelme_masks_are_joined_with_the_polygons_of_their_group(tmp_path):
    rng = np.random.default_rng(0)
    inside = rng.random((40, 30)) < 0.5
    polygon = {"label": "part", "points": [[0, 0], [4, 0], [4, 3], [0, 3]], "group_id": 7}
    shapes = [mask_shape(inside, group_id=7), polygon, mask_shape(~inside, x=W - 30, y=H - 40)]
    mask, notes = imported(write_labelme(tmp_path / "photos", shapes))
    first, second = np.zeros((2, H, W), bool)
    first[10:50, 20:50], first[:3, :4] = inside, True
    second[H - 40 :, W - 30 :] = ~inside
    np.testing.assert_array_equal(mask, [first, second])
    assert notes == ()


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (
            mask_shape(np.ones((4, 3), bool), points=[[20, 10], [23, 13]]),
            r"is \(4, 3\), and .*4, 4",
        ),
        (mask_shape(np.ones((4, 3), bool), x=W - 2), "lies outside of the picture of 96 x 64"),
        (mask_shape(np.ones((4, 3), bool), mask="@"), "its mask is damaged"),
        (mask_shape(np.ones((4, 3), bool), mask="AAAA"), "its mask is damaged"),
        (mask_shape(np.zeros((4, 3), bool)), "covers no pixel"),
    ],
)
def test_unusable_labelme_masks_are_refused(tmp_path, shape, message):
    assert re.search(message, refusal(write_labelme(tmp_path / "photos", [shape])))


def test_a_repeated_mask_is_refused_in_both_formats(tmp_path):
    """A polygon that starts at another corner gives the same mask."""
    content = coco()
    content["annotations"].append(
        content["annotations"][0] | {"id": 9, "segmentation": [[*BOX[4:], *BOX[:4]]]}
    )
    text = refusal(write_coco(tmp_path / "coco", content))
    assert "annotation 9 (2 of 000000.png) has the same mask as annotation 0" in text
    shape = {"label": "part", "points": np.reshape(BOX, (-1, 2)).tolist(), "group_id": None}
    text = refusal(write_labelme(tmp_path / "labelme", [shape, shape | {"label": "lid"}]))
    assert "instance 2 (lid) has the same mask as instance 1 (part)" in text


@pytest.mark.parametrize(
    ("kind", "entry", "message"),
    [
        (
            "categories",
            {"id": 1, "name": "lid"},
            "categories[0] and categories[1] have the same id",
        ),
        ("categories", {"id": 2, "name": "part"}, "categories[1] have the same name part"),
        ("images", {"id": 0, "file_name": "x.png"}, "images[0] and images[2] have the same id 0"),
    ],
)
def test_ambiguous_ids_and_names_are_refused(tmp_path, kind, entry, message):
    content = coco()
    content[kind].append(entry | {"width": W, "height": H})
    folder = write_coco(tmp_path / "photos", content)
    assert message in refusal(folder)
    # The reader for training gives the same error.
    with pytest.raises(DatasetError, match=re.escape(message)):
        open_examples(folder / "annotations/instances.json")


@pytest.mark.parametrize(
    ("segmentation", "message"),
    [
        ([[20, 10, float("nan"), 10, 60, 50]], "polygon 1: corner 2 is not a number (x is nan)"),
        ([BOX, [20, 10, 60, None, 60, 50]], "polygon 2: corner 2 is not a number (y is None)"),
        ([BOX[:-1]], "polygon 1: has 7 numbers"),
        ([BOX[:4]], "has 2 corners: a polygon must have at least 3"),
        (BOX, "polygon 1: is 20: a polygon is a list of x, y"),
    ],
)
def test_invalid_polygons_are_refused_with_the_reason(tmp_path, segmentation, message):
    assert message in refusal(write_coco(tmp_path / "photos", coco(segmentation)))


def test_boxes_without_masks_are_refused(tmp_path):
    content = coco()
    del content["annotations"][1]["segmentation"]
    text = refusal(write_coco(tmp_path / "photos", content))
    assert "annotation 1 of 000001.png: has no polygon and no mask, and its box alone" in text


def test_an_import_into_a_folder_with_an_import_is_refused(tmp_path):
    """An import is never continued, so existing pictures need no check."""
    folder = write_coco(tmp_path / "photos", coco())
    imported(folder)
    before = (tmp_path / "photos-out/graycast.json").read_bytes()
    with pytest.raises(Exception, match="photos-out: is not empty: choose another folder"):
        imported(folder)
    assert (tmp_path / "photos-out/graycast.json").read_bytes() == before


def test_a_hidden_labelme_file_is_ignored(tmp_path):
    write_pictures(tmp_path / "photos")
    labels = tmp_path / "photos/annotations"
    for k in range(2):
        content = {"shapes": [], "imageHeight": H, "imageWidth": W}
        (labels / f"{k:06d}.json").write_text(json.dumps(content))
        (labels / f"._{k:06d}.json").write_bytes(b"\0\5\x16\7")
    assert imported(tmp_path / "photos")[0].shape == (0, H, W)
