"""Scenes that were given up stay named until they are made or tried again."""

import json

import pytest

from graycast.base.errors import DatasetError
from graycast.dataset.write.set_aside import SetAside, SetAsideFile


def aside(scene_id, reason="no rest"):
    return SetAside(scene_id=scene_id, tries=3, reason=reason, traceback="one\ntwo")


def names(folder):
    path = folder / "set_aside.json"
    return list(json.loads(path.read_text())) if path.exists() else None


def test_only_scenes_to_be_retried_are_removed_from_the_list(tmp_path):
    file = SetAsideFile(tmp_path)
    file.forget(["000001"])
    assert names(tmp_path) is None
    for scene_id in (9, 1, 5):
        file.add(f"{scene_id:06d}", aside(scene_id))
    assert names(tmp_path) == ["000001", "000005", "000009"]
    file.forget(["000000", "000001"])
    file.add("000005", aside(5, "too full"))
    assert names(tmp_path) == ["000005", "000009"]
    entry = json.loads((tmp_path / "set_aside.json").read_text())["000005"]
    assert entry == {"reason": "too full", "traceback": ["one", "two"], "tries": 3}
    file.forget(["000005", "000009"])
    assert names(tmp_path) is None


def test_a_damaged_file_is_named(tmp_path):
    (tmp_path / "set_aside.json").write_text("[")
    with pytest.raises(DatasetError, match=r"set_aside\.json: cannot be read .*: remove it"):
        SetAsideFile(tmp_path).forget(["000001"])
