"""The dataset's card agrees with the files, and does not depend on the dataset's path."""

import json
import shutil

import cv2
import pytest
import yaml
from pictured import forget, write_dataset

from graycast.base.errors import DatasetError, GraycastError
from graycast.dataset import card
from graycast.dataset.card import write_card
from graycast.dataset.check.checking import validate
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.stats import dataset_statistics

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("card") / "bins"
    write_dataset(out, scene_ids=(3,))
    return out


@pytest.fixture(scope="module")
def five(tmp_path_factory):
    out = tmp_path_factory.mktemp("five") / "bins"
    write_dataset(out, scene_ids=range(5), keeps=True)
    return out


def files_of(out):
    card_files = [out / "README.md", *sorted((out / "card").iterdir())]
    return {str(file.relative_to(out)): file.read_bytes() for file in card_files}


def test_a_card_has_a_header_figures_and_pictures(dataset):
    text = write_card(dataset, dataset_statistics(dataset), licence="CC-BY-4.0").read_text()
    head = yaml.safe_load(text.split("---\n")[1])
    assert head["pretty_name"] == "Simulated scans of box, wedge"
    assert head["license"] == "CC-BY-4.0"
    assert "| part wedge | 4 instances in 1 scene |" in text
    assert "seed: 7" in text and "kept beside" not in text
    for scene in open_dataset(dataset).scenes:
        picture = cv2.imread(str(dataset / f"card/{scene.key}.jpg"))
        assert f"card/{scene.key}.jpg" in text and picture.shape == (360, 4 * 480, 3)


def test_a_rewritten_card_keeps_its_licence(dataset, tmp_path):
    """The next `generate` writes the card again after `dataset stats --card --licence`."""
    copied = shutil.copytree(dataset, tmp_path / "copied")
    first = write_card(copied, licence="MIT").read_text()
    assert "Licence: MIT." in first
    assert write_card(copied).read_text() == first
    assert "Licence: CC0-1.0." in write_card(copied, licence="CC0-1.0").read_text()


def test_the_card_does_not_depend_on_the_dataset_s_path(dataset, tmp_path):
    """The statistics are the same with and without a sample, as it includes all the few scenes."""
    (dataset / "README.md").unlink(missing_ok=True)  # another test stated a licence
    write_card(dataset)
    first = files_of(dataset)
    assert "Licence: not stated." in first["README.md"].decode()
    elsewhere = shutil.copytree(dataset, tmp_path / "of another name")
    for written in (dataset, elsewhere):
        write_card(written, dataset_statistics(written))
        assert files_of(written) == first
        assert not validate(written)


def test_the_card_of_a_large_dataset_reads_few_scenes_and_counts_all(five, tmp_path, monkeypatch):
    """Three scenes must not be read: their pictures are deleted."""
    monkeypatch.setattr(card, "SAMPLED", 2)
    out = shutil.copytree(five, tmp_path / "bins")
    places = open_dataset(out).scenes
    sample = card.sampled(places)
    assert len(sample) == 2 and sample == card.sampled(open_dataset(out).scenes)
    monkeypatch.setattr(card, "_MOST", 0)
    for place in places:
        if place not in sample:
            shutil.rmtree(place.folder / "depth_sl")
            (place.folder / "rgb/000000.png").unlink()
    text = write_card(out).read_text()
    assert "| scenes | 5 train |" in text
    assert "| part box | 20 instances in 5 scenes |" in text
    assert "plots are of 2 scenes, drawn at random of 5" in text.replace("\n", " ")
    assert "| kept beside | every captured frame, projector columns |" in text
    numbers = json.loads((out / "card/stats.json").read_bytes())
    assert (numbers["scenes_in_dataset"], numbers["scenes"]) == (5, {"train": 2})


def test_the_card_of_an_extended_dataset_states_the_new_size(five, tmp_path):
    out = shutil.copytree(five, tmp_path / "bins")
    last = [out / f"train/{k:06d}" for k in (0, 1)]
    aside = [folder.rename(tmp_path / folder.name) for folder in last]
    write_card(out)
    for folder, place in zip(aside, last, strict=True):
        folder.rename(place)
    write_card(out)
    write_card(five)
    assert files_of(out) == files_of(five)


def test_the_first_pictures_on_a_card_show_different_parts(five, tmp_path):
    """Scenes 0 to 3 lose their wedges; scene 4 has both kinds and is among the pictures."""
    out = shutil.copytree(five, tmp_path / "bins")
    for k in range(4):
        path = out / f"train/{k:06d}/scene_gt.json"
        poses = json.loads(path.read_bytes())["0"]
        path.write_text(json.dumps({"0": [pose | {"obj_id": 1} for pose in poses]}))
    text = write_card(out).read_text()
    assert "card/train-000000.jpg" in text and "card/train-000004.jpg" in text


def test_a_card_of_real_pictures_claims_no_perfect_depth(dataset, tmp_path):
    out = tmp_path / "real"
    shutil.copytree(dataset, out)
    forget(out)
    text = write_card(out).read_text()
    assert "perfect depth (1 to 99 %)" not in text and "sigma" not in text


def test_a_read_only_folder_keeps_its_old_card(dataset, tmp_path, monkeypatch):
    out = shutil.copytree(dataset, tmp_path / "bins")
    write_card(out)
    first = files_of(out)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(card, "draw_statistics", full)
    with pytest.raises(GraycastError, match="No space left"):
        write_card(out)
    assert files_of(out) == first and not list(out.glob(".tmp-*"))


def test_damaged_labels_are_named(dataset, tmp_path):
    out = shutil.copytree(dataset, tmp_path / "bins")
    (out / "train/000003/scene_gt.json").write_text("{")
    with pytest.raises(DatasetError, match=r"scene_gt\.json"):
        write_card(out)


def test_special_characters_in_names_do_not_break_the_card_s_table(dataset, tmp_path):
    copy = tmp_path / "d"
    shutil.copytree(dataset, copy)
    text = write_card(copy, title="x\n# y | z").read_text()
    head = yaml.safe_load(text.split("---\n")[1])
    assert head["pretty_name"] == "x\n# y | z"
    assert "\n# x \\# y \\| z\n" in text
