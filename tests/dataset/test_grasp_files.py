"""Grasp labels next to a dataset: their checks by `validate`, and an unchanged dataset."""

import json
import shutil

import numpy as np
import pytest

from graycast.dataset.check.checking import validate
from graycast.dataset.check.plain_scene import transform_of

JAWS = {"kind": "jaws", "jaws": {"opening_m": 0.06}}


@pytest.fixture(scope="module")
def copy(dataset, tmp_path_factory):
    return shutil.copytree(dataset, tmp_path_factory.mktemp("labelled") / "out")


@pytest.fixture
def labelled(copy):
    """Copy the dataset with one label on every instance of scene 3, in the middle of its top.

    The tests change the labels only.
    """
    out = copy
    shutil.rmtree(out / "grasps", ignore_errors=True)
    record = json.loads((out / "graycast.json").read_bytes())
    write(out, "grasps.json", claim(record["fingerprint"]))
    infos = json.loads((out / "models/models_info.json").read_bytes())
    poses = json.loads((out / "train/000003/scene_gt.json").read_bytes())["0"]
    entries = []
    for pose in poses:
        info = infos[str(pose["obj_id"])]
        place = [info[f"min_{k}"] + info[f"size_{k}"] * (0.5 if k != "z" else 1) for k in "xyz"]
        T = transform_of(pose["cam_R_m2c"], pose["cam_t_m2c"])
        grasp = {
            "R_t2m": np.eye(3).ravel().tolist(),
            "t_t2m": place,
            "cam_R_t2c": T[:3, :3].ravel().tolist(),
            "cam_t_t2c": (T @ np.array([*place, 1.0]))[:3].tolist(),
            "opening": 30.0,
            "score": 0.5,
            "reach": "free",
            "simulated": {"success": True, "ended": "held", "least_factor": 3.5},
        }
        entries.append({"obj_id": pose["obj_id"], "grasps": [grasp]})
    write(out, "train/000003.json", {"0": entries})
    return out


def claim(fingerprint):
    return {
        "format_version": 1,
        "config": {"tool": JAWS},
        "seed": 0,
        "dataset": fingerprint,
        "versions": {},
    }


def write(out, name, content):
    path = out / "grasps/jaws" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def test_a_valid_dataset_stays_valid_with_grasp_labels(labelled):
    assert validate(labelled) == ()
    assert validate(labelled, fast=True) == ()


def shifted(grasp):
    grasp["cam_t_t2c"][1] += 1e-3


def of_another_frame(grasp):
    grasp["cam_R_t2c"] = np.eye(3).ravel().tolist()


def off_the_part(grasp):
    for key in ("t_t2m", "cam_t_t2c"):
        grasp[key] = [value + 500 for value in grasp[key]]


def mirrored(grasp):
    grasp["R_t2m"][0] = -1.0


FAULTS = [
    (shifted, "are not its pose"),
    (of_another_frame, "are not its pose"),
    (off_the_part, "outside of the model's box"),
    (mirrored, "is not a rotation"),
    (lambda grasp: grasp.update(score=1.2), "less than or equal to 1"),
    (lambda grasp: grasp.update(opening=61.0), "the jaws open 60 mm"),
    (lambda grasp: grasp.update(opening=None), "which only jaws have"),
    (lambda grasp: grasp.update(reach="bin"), "its reach is bin"),
    (lambda grasp: grasp.update(reach="far"), "Input should be"),
    (lambda grasp: grasp["simulated"].update(ended="slipped"), "ended is slipped"),
    (lambda grasp: grasp.update(worth=1), "Extra inputs"),
    (lambda grasp: grasp.pop("t_t2m"), "Field required"),
]


@pytest.mark.parametrize(("harm", "message"), FAULTS)
def test_a_wrong_grasp_label_is_named(labelled, harm, message):
    path = labelled / "grasps/jaws/train/000003.json"
    content = json.loads(path.read_bytes())
    harm(content["0"][1]["grasps"][0])
    path.write_text(json.dumps(content))
    problems = [str(problem) for problem in validate(labelled)]
    assert any("grasps/jaws/train/000003.json" in what and message in what for what in problems), (
        problems
    )


def test_grasp_labels_of_other_scenes_and_datasets_are_reported(labelled):
    folder = labelled / "grasps/jaws"
    shutil.copy(folder / "train/000003.json", folder / "train/000007.json")
    (folder / "grasps.json").write_text(json.dumps(claim("another")))
    content = json.loads((folder / "train/000003.json").read_bytes())
    content["0"].pop()
    (folder / "train/000000.json").write_text(json.dumps(content))
    (labelled / "grasps/cup").mkdir()
    text = "\n".join(str(problem) for problem in validate(labelled))
    assert "grasps/cup: grasps.json is missing" in text
    assert "is of another dataset" in text
    assert "000007.json: scene_gt.json is missing" in text
    assert "its 7 instances are not the 8" in text
