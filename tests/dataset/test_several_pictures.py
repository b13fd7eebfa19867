"""Scenes of two scanners with two views each, read back and used in all later steps."""

import json

import numpy as np
import pytest
from several_pictures import NAMES, SCENES, several  # noqa: F401

from graycast.dataset.card import write_card
from graycast.dataset.export import Options, Split, export
from graycast.dataset.read.scene_content import scene_content
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.stats import dataset_statistics, stats_plots
from graycast.dataset.training import open_examples

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
FORMATS = ("coco", "yolo", "bop-webdataset", "parquet")
IMAGE_IDS = [scene_id * len(NAMES) + place for scene_id in SCENES for place in range(len(NAMES))]


@pytest.mark.slow
def test_every_picture_is_read_back_unchanged(several):  # noqa: F811
    out, samples = several
    stored = open_dataset(out)
    assert [shot.image_id for shot in stored.pictures] == IMAGE_IDS
    assert [shot.key for shot in stored.pictures] == [
        f"train-{scene_id:06d}-{name}" for scene_id in SCENES for name in NAMES
    ]
    for shot in stored.pictures:
        sample = samples[shot.scene_id][shot.place]
        assert np.array_equal(shot.rgb(), sample.rgb)
        assert shot.depth_m("depth_sl") == pytest.approx(
            sample.scanner_depth.depth_m.astype(np.float32), abs=2e-5, nan_ok=True
        )
        assert np.array_equal(scene_content(shot).label, sample.truth.instance)
        assert stored.picture(shot.image_id) == shot


@pytest.mark.parametrize("form", FORMATS)
def test_an_export_contains_every_picture_once(several, tmp_path, form):  # noqa: F811
    """Numbers are unique, pictures differ, and sizes are those of their scanners."""
    out, samples = several
    export(out, tmp_path / "out", Options(format=form, split=Split()))
    examples = open_examples(tmp_path / "out")
    assert list(examples.scene_ids) == IMAGE_IDS
    for image_id, example in zip(IMAGE_IDS, examples, strict=True):
        scene_id, place = divmod(image_id, len(NAMES))
        sample = samples[scene_id][place]
        assert example.scene_id == image_id
        assert np.array_equal(example.rgb, sample.rgb)
        instances = np.unique(sample.truth.instance[sample.truth.instance >= 0])
        assert len(example.obj_id) == len(instances)
        if form != "yolo":  # with rounded polygons and without instances
            for i, mask in zip(example.instance, example.mask, strict=True):
                assert np.array_equal(mask, sample.truth.instance == i)


def test_examples_of_a_dataset_and_its_export_have_the_same_numbers(several):  # noqa: F811
    examples = open_examples(several[0])
    assert [example.scene_id for example in examples] == IMAGE_IDS


def test_the_pictures_of_a_scene_stay_in_one_set(several, tmp_path):  # noqa: F811
    options = Options(format="coco", split=Split(shares=(0.5, 0.5, 0.0), seed=0))
    record = export(several[0], tmp_path / "out", options)
    assert {len(ids) for ids in record.splits.values()} == {len(NAMES)}
    for ids in record.splits.values():
        assert len({image_id // len(NAMES) for image_id in ids}) == 1


def test_a_dataset_and_its_export_number_pictures_equally(several, tmp_path):  # noqa: F811
    """`train_coco.json` of the store is compared with COCO from the export."""
    export(several[0], tmp_path / "out", Options(format="coco", split=Split()))
    own = json.loads((several[0] / "train_coco.json").read_text())
    exported = json.loads((tmp_path / "out/annotations/instances_train.json").read_text())
    size = {image["id"]: (image["width"], image["height"]) for image in own["images"]}
    assert size == {image["id"]: (image["width"], image["height"]) for image in exported["images"]}
    assert sorted(size) == IMAGE_IDS and set(size.values()) == {(160, 120), (128, 96)}
    boxes = [
        sorted((entry["image_id"], entry["category_id"], *entry["bbox"]) for entry in entries)
        for entries in (own["annotations"], exported["annotations"])
    ]
    assert boxes[0] == boxes[1]


def test_clouds_and_cameras_of_each_scanner_are_exported(several, tmp_path):  # noqa: F811
    export(several[0], tmp_path / "clouds", Options(format="clouds", split=Split()))
    names = sorted(path.name for path in (tmp_path / "clouds/train").iterdir())
    assert len(names) == 2 * len(IMAGE_IDS)
    export(several[0], tmp_path / "bop", Options(format="bop-webdataset", split=Split()))
    for name, width in (("left", 160), ("right", 128)):
        camera = json.loads((tmp_path / f"bop/camera_{name}.json").read_text())
        assert camera["width"] == width


def test_statistics_use_all_pictures_and_count_scenes_once(several):  # noqa: F811
    out, samples = several
    statistics = dataset_statistics(out)
    assert statistics.scenes == {"train": len(SCENES)}
    assert statistics.pictures == len(IMAGE_IDS)
    every = [sample for pictures in samples.values() for sample in pictures]
    assert statistics.pixels == sum(sample.gray.size for sample in every)
    assert statistics.sizes_px == {(160, 120): 4, (128, 96): 4}
    assert list(statistics.of_picture) == list(NAMES)
    for place, (name, figures) in enumerate(statistics.of_picture.items()):
        reason = np.stack([samples[i][place].scanner_depth.reason for i in SCENES])
        assert figures.pictures == len(SCENES), name
        assert figures.decoded == pytest.approx((reason == 0).mean())


@pytest.mark.slow
def test_the_card_counts_scenes_and_instances_once(several, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.setattr(stats_plots, "save_png", lambda figure, path, dpi: path.touch())
    import shutil

    out = shutil.copytree(several[0], tmp_path / "out")
    card = write_card(out).read_text()
    assert "2 train, each of 4 pictures" in card
    assert "6 instances in 2 scenes" in card and "4 instances in 2 scenes" in card
