"""The one reader of stored datasets: all data of a scene agree."""

import json
import pickle
import shutil

import numpy as np
import pytest
from simulated_dataset import write_dataset

from graycast.base.errors import DatasetError
from graycast.dataset.read.scene_content import scene_content
from graycast.dataset.read.stored import StoredScene, open_dataset

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.fixture(scope="module")
def dataset_and_samples(tmp_path_factory):
    out = tmp_path_factory.mktemp("stored") / "out"
    return out, write_dataset(out, (0, 3))


def test_stored_instances_labels_and_label_map_equal_those_of_the_sample(dataset_and_samples):
    out, samples = dataset_and_samples
    for scene in open_dataset(out).scenes:
        sample, content = samples[scene.scene_id], scene_content(scene)
        np.testing.assert_array_equal(content.label, sample.truth.instance)
        np.testing.assert_array_equal(content.rgb, sample.rgb)
        np.testing.assert_array_equal(content.reason, sample.scanner_depth.reason)
        area_px = [int((sample.truth.instance == i).sum()) for i in range(8)]
        assert [one.area_px for one in content.instances] == area_px
        assert [one.obj_id for one in content.instances] == list(scene.obj_ids())
        assert list(scene.obj_ids()) == (sample.layout.part_index + 1).tolist()
        assert [label.instance for label in scene.labels()] == np.flatnonzero(area_px).tolist()
        assert [label.area_px for label in scene.labels()] == [a for a in area_px if a]
        for label in scene.labels():
            x, y, columns, rows = label.box
            whole = sample.truth.instance == label.instance
            window = whole[y : y + rows, x : x + columns]
            np.testing.assert_array_equal(label.window(), window)
            assert window.sum() == whole.sum() > 0


def test_scenes_of_other_splits_are_distinguished(dataset_and_samples, tmp_path):
    out = shutil.copytree(dataset_and_samples[0], tmp_path / "out")
    (out / "val").mkdir()
    shutil.copytree(out / "train/000003", out / "val/000003")
    stored = open_dataset(out)
    assert stored.scene_ids == {"train": (0, 3), "val": (3,), "test": ()}
    assert [scene.key for scene in stored.scenes] == ["train-000000", "train-000003", "val-000003"]
    assert len(set(stored.scenes)) == 3
    assert pickle.loads(pickle.dumps(stored)) == stored


def test_an_object_unknown_to_the_dataset_is_reported(dataset_and_samples, tmp_path):
    out = shutil.copytree(dataset_and_samples[0], tmp_path / "out")
    path = out / "train/000003/scene_gt.json"
    poses = json.loads(path.read_bytes())
    poses["0"][2]["obj_id"] = 7
    path.write_text(json.dumps(poses))
    scene = open_dataset(out).scene(3)
    for read in (scene_content, StoredScene.labels, StoredScene.example, StoredScene.obj_ids):
        with pytest.raises(DatasetError, match=r"has object 7, graycast\.json has 1, 2"):
            read(scene)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("manifest.json", scene_content),
        ("scene_gt_box3d.json", scene_content),
        ("scene_sl.json", scene_content),
        ("scene_gt_coco.json", StoredScene.labels),
        ("scene_camera.json", StoredScene.example),
    ],
)
def test_a_file_that_is_missing_is_named(dataset_and_samples, tmp_path, name, read):
    out = shutil.copytree(dataset_and_samples[0], tmp_path / "out")
    (out / "train/000003" / name).unlink()
    with pytest.raises(DatasetError, match=f"000003: {name} is missing: run graycast validate"):
        read(open_dataset(out).scene(3))
