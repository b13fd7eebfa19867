"""The dataset's card: says what the files say, and the same each time."""

import shutil

import cv2
import pytest
import yaml
from pictured import forget, write_dataset

from graycast.card import write_card
from graycast.dataset import validate
from graycast.stats import dataset_statistics, find_scenes

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("card") / "bins"
    write_dataset(out, scene_ids=(3,))
    return out


def test_a_card_has_its_head_its_figures_and_its_pictures(dataset):
    text = write_card(dataset, dataset_statistics(dataset), licence="CC-BY-4.0").read_text()
    head = yaml.safe_load(text.split("---\n")[1])
    assert (head["pretty_name"], head["license"]) == ("bins", "CC-BY-4.0")
    assert "| part `wedge` | 4 instances in 1 scene |" in text
    assert "seed: 7" in text
    for place in find_scenes(dataset):
        picture = cv2.imread(str(dataset / f"card/{place.key}.jpg"))
        assert f"card/{place.key}.jpg" in text and picture.shape == (360, 4 * 480, 3)


@pytest.mark.slow
def test_the_same_dataset_has_the_same_card_and_stays_valid(dataset):
    statistics = dataset_statistics(dataset)
    write_card(dataset, statistics)
    files = [dataset / "README.md", *sorted((dataset / "card").iterdir())]
    first = [file.read_bytes() for file in files]
    write_card(dataset, statistics)
    assert [file.read_bytes() for file in files] == first
    assert b"Licence: not stated." in first[0]
    assert not validate(dataset)


@pytest.mark.slow
def test_a_card_of_real_pictures_claims_no_perfect_depth(dataset, tmp_path):
    out = tmp_path / "real"
    shutil.copytree(dataset, out)
    for place in find_scenes(out):
        forget(place.folder)
    text = write_card(out, dataset_statistics(out)).read_text()
    assert "perfect depth (1 to 99 %)" not in text and "sigma" not in text
