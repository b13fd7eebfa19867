"""Exports of our datasets in common formats, read as if their origin were unknown."""

import json
import shutil

import cv2
import numpy as np
import pytest
from PIL import Image
from simulated_dataset import write_dataset

from graycast.base.errors import DatasetError
from graycast.dataset.export import Options, export
from graycast.dataset.export.split import Split
from graycast.dataset.training import open_examples

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


EMPTY = {"annotations": [], "categories": [{"id": 1, "name": "part"}]}


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    write_dataset(folder / "ours", (0, 3, 4))
    export(folder / "ours", folder / "coco", Options(format="coco"))
    (folder / "coco" / "export.json").rename(folder / "record.json")  # without its origin
    return folder


def test_a_folder_of_bop_scenes_is_read_like_our_own_dataset(datasets):
    """Oracle: our dataset is in BOP's form, and its own reader uses other files of it."""
    own, theirs = open_examples(datasets / "ours"), open_examples(datasets / "ours" / "train")
    assert len(theirs) == len(own) == 3
    for mine, other in zip(own, theirs, strict=True):
        np.testing.assert_array_equal(other.mask, mine.mask)
        np.testing.assert_array_equal(other.obj_id, mine.obj_id)
        np.testing.assert_allclose(other.T_cam_part, mine.T_cam_part, atol=1e-9)
        np.testing.assert_array_equal(other.box_px, mine.box_px)
        np.testing.assert_array_equal(other.rgb, mine.rgb)
        np.testing.assert_allclose(other.depth_m, mine.depth_m, rtol=1e-6)
        np.testing.assert_allclose(other.visib_fract, mine.visib_fract)
        np.testing.assert_allclose(other.K, mine.K)


def test_coco_annotations_from_other_programs_are_read(datasets):
    path = datasets / "coco" / "annotations" / "instances_train.json"
    theirs = open_examples(path)
    for mine, other in zip(open_examples(datasets / "ours"), theirs, strict=True):
        np.testing.assert_array_equal(other.mask, mine.mask)
        np.testing.assert_array_equal(other.obj_id, mine.obj_id)
        np.testing.assert_array_equal(other.box_px, mine.box_px)
        np.testing.assert_array_equal(other.rgb, mine.rgb)
    assert dict(theirs.categories) == dict(open_examples(datasets / "ours").categories)


def test_a_crowd_annotation_is_ignored(datasets, tmp_path):
    path = datasets / "coco" / "annotations" / "instances_train.json"
    content = json.loads(path.read_bytes())
    first = content["images"][0]["id"]
    mine = [entry for entry in content["annotations"] if entry["image_id"] == first]
    mine[0]["iscrowd"] = 1
    crowd = path.with_name("crowd.json")
    crowd.write_text(json.dumps(content))
    example = open_examples(crowd)[0]
    assert example.hidden(0.1).tolist() == [True] + [False] * (len(mine) - 1)


def test_pictures_of_a_scene_stay_in_one_set(datasets):
    whole = Split(shares=(0.5, 0.5, 0.0))
    parts = [
        open_examples(datasets / "ours" / "train", split=name, division=whole)
        for name in ("train", "val")
    ]
    assert sorted([*parts[0].scene_ids, *parts[1].scene_ids]) == [0, 1, 2]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON, or is cut off"),
        ("{}", "holds no COCO annotations"),
        ('{"images": [], "annotations": [], "categories": []}', "has no images"),
    ],
)
def test_invalid_annotations_are_refused(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DatasetError, match=message):
        open_examples(tmp_path / "a.json")


IMAGE = {"id": 1, "file_name": "a[1].png", "width": 4, "height": 4}
PART = {"id": 7, "name": "part"}
LABEL = {"image_id": 1, "category_id": 7, "bbox": [0, 0, 2, 2]}


def written(path, **changed):
    """Write one picture with one object; `changed` are the file's lists."""
    content = {"images": [IMAGE], "categories": [PART], "annotations": [LABEL]}
    path.write_text(json.dumps(content | changed))
    return path


def without(entry, key):
    return {name: value for name, value in entry.items() if name != key}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"annotations": [LABEL, without(LABEL, "bbox")]}, r"annotations\[1\] has no bbox: add it"),
        ({"annotations": [without(LABEL, "category_id")]}, "has no category_id: add it"),
        ({"annotations": [LABEL | {"category_id": 8}]}, "category_id 8, and categories do not"),
        ({"annotations": [LABEL | {"category_id": "7"}]}, 'category_id "7": it must be a whole'),
        ({"annotations": [LABEL | {"bbox": [1, 2, 3]}]}, r"bbox \[1, 2, 3\]: it must be four"),
        ({"annotations": [LABEL | {"bbox": [1, 2, 3, "4"]}]}, "it must be four numbers"),
        ({"annotations": [None]}, r"annotations\[0\] is null: it must be an object"),
        ({"annotations": 3}, "a list of annotations is missing"),
        ({"images": [without(IMAGE, "file_name")]}, r"images\[0\] has no file_name: add it"),
        ({"images": [IMAGE | {"file_name": 5}]}, "file_name 5: it must be the name of a file"),
        ({"images": [without(IMAGE, "id")]}, r"images\[0\] has no id: add it"),
        ({"categories": [without(PART, "name")]}, r"categories\[0\] has no name: add it"),
    ],
)
def test_an_entry_with_a_missing_key_is_named_before_a_picture_is_read(tmp_path, changed, message):
    path = written(tmp_path / "a.json", **changed)
    with pytest.raises(DatasetError, match=f"^{path}: .*{message}"):
        open_examples(path)


def test_brackets_in_a_picture_s_name_are_not_a_pattern(tmp_path):
    (tmp_path / "pictures").mkdir()
    picture = np.full((4, 4, 3), 90, np.uint8)
    cv2.imwrite(str(tmp_path / "pictures" / "a[1].png"), picture)
    (tmp_path / "pictures" / "a1.png").write_bytes(b"what a pattern would find")
    example = open_examples(written(tmp_path / "a.json"))[0]
    np.testing.assert_array_equal(example.rgb, picture)
    assert example.mask is None


def test_a_picture_name_that_leads_out_of_the_folder_is_refused(tmp_path):
    """Otherwise a foreign list could open files of its reader."""
    picture = np.full((4, 4, 3), 90, np.uint8)
    (tmp_path / "set").mkdir()
    for place in ("secret.png", "set/a.png"):
        cv2.imwrite(str(tmp_path / place), picture)
    path = tmp_path / "set/a.json"
    names = ("../secret.png", str(tmp_path / "secret.png"), "..\\secret.png", "x/../../secret.png")
    for name in names:
        path.write_text(json.dumps({"images": [{"id": 0, "file_name": name}]} | EMPTY))
        with pytest.raises(DatasetError, match=r"a\.json: picture .*secret\.png leads out of the"):
            open_examples(path)[0]
    path.write_text(json.dumps({"images": [{"id": 0, "file_name": "set\\a.png"}]} | EMPTY))
    np.testing.assert_array_equal(open_examples(path)[0].rgb, picture)


def test_a_picture_that_is_stored_rotated_is_refused(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.full((4, 6, 3), 90, np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    content = {"images": [{"id": 0, "file_name": "a.jpg"}]} | EMPTY
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(
        DatasetError, match=r"a\.jpg is stored turned by 90|a\.jpg: is stored turned"
    ):
        open_examples(tmp_path / "a.json")[0]


def test_the_largest_number_in_a_depth_picture_means_unknown(datasets, tmp_path):
    scenes = shutil.copytree(datasets / "ours/train", tmp_path / "train")
    path = scenes / "000000/depth/000000.png"
    steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    steps[3:5, 4:9] = 65535
    cv2.imwrite(str(path), steps)
    depth_m = open_examples(scenes)[0].depth_m
    np.testing.assert_array_equal(np.isnan(depth_m), (steps == 0) | (steps == 65535))


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        ({"0": [{"cam_R_m2c": []}]}, r"0\.0\.obj_id: Field required"),
        (
            {"0": [{"obj_id": "bolt"}]},
            r"0\.0\.obj_id: Input should be a valid integer",
        ),
        ({"0": [5]}, r"0\.0: Input should be an object.*each with obj_id"),
        ({"first": []}, r"first.*valid integer.*: each key must be the number of an image"),
        ({"0": {}}, "hold the list of its objects"),
        ([], "Input should be an object: each key must be the number"),
    ],
)
def test_a_bop_scene_with_a_different_layout_is_named(tmp_path, poses, message):
    (tmp_path / "000000").mkdir()
    file = tmp_path / "000000" / "scene_gt.json"
    file.write_text(json.dumps(poses))
    (tmp_path / "0_notes").mkdir()  # This is no scene, because its name is not a number.
    (tmp_path / "0_notes" / "scene_gt.json").write_text("{}")
    with pytest.raises(DatasetError, match=f"^{file}: .*{message}"):
        open_examples(tmp_path)


def test_a_bop_picture_whose_camera_is_missing_is_named(datasets, tmp_path):
    shutil.copytree(datasets / "ours" / "train", tmp_path / "train")
    file = tmp_path / "train" / "000003" / "scene_camera.json"
    camera = json.loads(file.read_text())
    del camera["0"]["cam_K"]
    file.write_text(json.dumps(camera))
    with pytest.raises(DatasetError, match=r"scene_camera\.json: image 0: cam_K: Field"):
        open_examples(tmp_path / "train")[1]


def test_a_missing_picture_or_mask_is_named(datasets, tmp_path):
    path = tmp_path / "a.json"
    image = {"id": 1, "file_name": "nowhere.png", "width": 4, "height": 4}
    path.write_text(json.dumps({"images": [image], "annotations": [], "categories": []}))
    with pytest.raises(DatasetError, match=r"picture nowhere\.png is neither beside"):
        open_examples(path)[0]
    write_dataset(tmp_path / "ours", (0,))
    for mask in (tmp_path / "ours/train/000000/mask_visib").iterdir():
        mask.unlink()
    with pytest.raises(
        DatasetError,
        match=r"mask_visib/000000_00000\d\.png is missing: training",
    ):
        open_examples(tmp_path / "ours" / "train")[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda mask: mask // 2, "values other than 0 and 255"),
        (lambda mask: mask.astype(np.uint16) * 257, "one channel of uint8"),
        (lambda mask: 0 * mask, "mask 0 is empty, and px_count_visib is"),
    ],
)
def test_masks_that_validate_refuses_are_not_used_for_training(datasets, tmp_path, change, message):
    """Nonzero values used to count as inside, and an empty mask gave a box of no size."""
    shutil.copytree(datasets / "ours" / "train", tmp_path / "train")
    path = tmp_path / "train" / "000000" / "mask_visib" / "000000_000000.png"
    cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    with pytest.raises(DatasetError, match=f"{message}.*: training needs"):
        open_examples(tmp_path / "train")[0]


def test_the_checksum_of_a_foreign_dataset_changes_with_its_annotations(datasets, tmp_path):
    coco = datasets / "coco/annotations/instances_train.json"
    for source, file in ((datasets / "ours/train", "000003/scene_gt.json"), (coco, None)):
        copy = tmp_path / source.name
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, copy)
        before = open_examples(copy).content_sum()
        assert before == open_examples(source).content_sum()
        path = copy / file if file else copy
        path.write_text(path.read_text() + "\n")
        assert open_examples(copy).content_sum() != before
