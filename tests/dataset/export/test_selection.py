"""Exports of selected scenes: only those in the file, each in its usual set."""

import json

import pytest

from graycast.base.errors import DatasetError, GraycastError
from graycast.cli import main
from graycast.dataset.export import Options, Split, export, read_record

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def write_selection(path, master, scenes, **changed):
    claim = json.loads((master / "graycast.json").read_text())
    content = {
        "kind": "graycast-scenes",
        "dataset": "bins",
        "fingerprint": claim["fingerprint"],
        "scenes": scenes,
    }
    path.write_text(json.dumps(content | changed))
    return path


def test_only_the_selected_scenes_are_exported_into_their_own_sets(master, samples, tmp_path):
    selection = write_selection(
        tmp_path / "s.json", master, {"train-000005": ["odd"], "train-000003": []}
    )
    command = ["dataset", "export", str(master), "--format", "coco", "--selection", str(selection)]
    assert main([*command, "--out", str(tmp_path / "coco")]) == 0
    assert read_record(tmp_path / "coco").splits == {"train": [3, 5]}
    pictures = sorted(path.stem for path in (tmp_path / "coco/images/train").iterdir())
    assert pictures == ["000003", "000005"]
    seed = next(s for s in range(100) if _place(s, 3) == "train" and _place(s, 5) == "val")
    split = Split(shares=(0.5, 0.5, 0.0), seed=seed)
    record = export(
        master, tmp_path / "two", Options(format="yolo", split=split), selection=selection
    )
    whole = split.assign(samples)
    assert record.splits == {"train": [3], "val": [5]}
    assert 3 in whole["train"] and 5 in whole["val"]


def _place(seed, scene_id):
    return Split(shares=(0.5, 0.5, 0.0), seed=seed).place(scene_id)


@pytest.mark.parametrize(
    ("scenes", "changed", "says"),
    [
        ({"train-000001": []}, {}, r"names train-000001, which .*/train lacks"),
        ({f"train-{k:06d}": [] for k in range(10, 15)}, {}, r"000012 and 2 more"),
        ({}, {}, "names no scene"),
        ({"train-000003": []}, {"fingerprint": "0"}, r"another dataset \(bins\)"),
        ({"train-000003": []}, {"kind": "coco"}, "is not a selection of scenes"),
    ],
)
def test_a_selection_that_does_not_fit_is_refused_without_an_export(
    master, tmp_path, scenes, changed, says
):
    selection = write_selection(tmp_path / "s.json", master, scenes, **changed)
    with pytest.raises((DatasetError, GraycastError), match=says):
        export(master, tmp_path / "out", Options(format="coco"), selection=selection)
    assert [path.name for path in tmp_path.iterdir()] == ["s.json"]


def test_a_missing_file_is_reported(master, tmp_path):
    with pytest.raises(GraycastError, match=r"none\.json is missing"):
        export(
            master,
            tmp_path / "out",
            Options(format="coco"),
            selection=tmp_path / "none.json",
        )
