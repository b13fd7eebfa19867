"""Test the file of a study, which is read without any library of detectors."""

import pytest
import yaml

from graycast.base.errors import ConfigError
from graycast.learn.study_file import read_study

STUDY = {
    "models": [{"model": "yolov3"}],
    "inputs": ["rgb"],
    "training": {"drawn": ["own"]},
    "tests": {"own": {"datasets": ["own"]}, "other": {"datasets": ["other"]}},
    "gap": ["own", "other"],
}


def written(folder, **changed):
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(STUDY | changed))
    return path


def test_a_folder_has_the_same_path_wherever_the_study_file_is(tmp_path):
    """Otherwise a run started from another study file would look like a different run."""
    (tmp_path / "configs").mkdir()
    training = {"five": ["../sets/a", "./b/../../sets/b"]}
    spec = read_study(written(tmp_path / "configs", training=training))
    assert spec.training["five"] == (tmp_path / "sets/a", tmp_path / "sets/b")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"gap": ["own", "moon"]}, "gap names 'moon', which is no test set"),
        ({"models": []}, "models"),
        ({"colour": 1}, "unknown key"),
        (
            {"tests": {"own": {"datasets": ["a", "b"]}, "other": {"datasets": ["c"]}}},
            "the two test sets must have the same number",
        ),
    ],
)
def test_an_impossible_study_is_refused(tmp_path, changed, message):
    with pytest.raises(ConfigError, match=message):
        read_study(written(tmp_path, **changed))
