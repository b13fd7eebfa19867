"""Parts without a label hide the others and are in no annotation."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from prisms import CONFIG, SEED, box_part, build_sample, make_rig, wedge_part

from graycast.base.errors import DatasetError
from graycast.dataset.check.checking import validate
from graycast.dataset.files.sample import labelled
from graycast.dataset.write.bop import scene_files
from graycast.dataset.write.store import open_store
from graycast.world.scene import Scene

BOX, WEDGE = box_part(), wedge_part()
FOREIGN = replace(WEDGE, labelled=False)


def sample(parts):
    """Return eight instances, alternately boxes and wedges."""
    return build_sample(3, parts=parts, rig=make_rig())


def store(out, parts):
    rig = make_rig()
    return open_store(out, config=CONFIG, seed=SEED, parts=parts, rig=rig, depth_scale_mm=0.02)


@pytest.fixture
def dataset(tmp_path):
    """Return one scene whose wedges are distractors."""
    with store(tmp_path / "out", (BOX, FOREIGN)) as opened:
        opened.write(3, [sample((BOX, FOREIGN))])
        opened.finish([3])
    return tmp_path / "out"


def test_only_labelled_parts_have_labels_and_pictures_show_all_parts():
    """All files except annotations equal those of a scene in which the wedges have labels."""
    all_of_them = dict(scene_files([sample((BOX, WEDGE))], 0.02))
    boxes = dict(scene_files([sample((BOX, FOREIGN))], 0.02))
    for name in ("rgb", "depth", "depth_sl", "gray_sl", "reason_sl"):
        assert boxes[f"{name}/000000.png"] == all_of_them[f"{name}/000000.png"]
    for k in range(4):  # the boxes were instances 0, 2, 4 and 6
        for kind in ("mask", "mask_visib", "mask_visib_sl"):
            own, among = (f"{kind}/000000_{i:06d}.png" for i in (k, 2 * k))
            assert boxes[own] == all_of_them[among]
    assert sum(name.startswith("mask_visib/") for name in boxes) == 4
    for name in ("scene_gt.json", "scene_gt_info.json", "scene_gt_info_sl.json",
                 "scene_gt_box3d.json"):  # fmt: skip
        every = json.loads(all_of_them[name])["0"]
        assert json.loads(boxes[name])["0"] == every[::2]
    coco = json.loads(boxes["scene_gt_coco.json"])
    assert {entry["category_id"] for entry in coco["annotations"]} == {1}
    assert [category["id"] for category in coco["categories"]] == [1]


def test_a_distractor_in_front_removes_pixels_from_a_label():
    """The visible mask is the rest of the whole mask; no part of it moves to another label."""
    whole = sample((BOX, FOREIGN))
    own = labelled(whole)
    hidden = 0
    for number, i in enumerate((0, 2, 4, 6)):
        assert ((own.truth.instance == number) == (whole.truth.instance == i)).all()
        mask = whole.truth.amodal[i].clipped(*whole.truth.instance.shape)
        window = np.zeros(whole.truth.instance.shape, dtype=bool)
        h, w = mask.mask.shape
        window[mask.top_px : mask.top_px + h, mask.left_px : mask.left_px + w] = mask.mask
        hidden += int((window & (whole.truth.instance % 2 == 1)).sum())
    assert hidden > 100
    assert len(own.truth.amodal) == len(own.layout.part_index) == 4
    assert labelled(own) is own


def test_a_dataset_with_distractors_is_valid_and_has_no_distractor_models(dataset):
    assert validate(dataset) == ()
    assert [path.name for path in sorted((dataset / "models").glob("*.ply"))] == ["obj_000001.ply"]
    claim = json.loads((dataset / "graycast.json").read_text())
    assert [part["name"] for part in claim["parts"]] == ["box"]
    assert [part["name"] for part in claim["distractors"]] == ["wedge"]
    split = json.loads((dataset / "train_coco.json").read_text())
    assert [category["name"] for category in split["categories"]] == ["box"]


def test_a_wrong_label_next_to_distractors_is_detected(dataset):
    """A hidden pixel is labelled as visible; and a box is moved by a millimetre."""
    scene = dataset / "train" / "000003"
    for suffix in ("", "_sl"):
        path = scene / f"scene_gt{suffix}.json"
        poses = json.loads(path.read_text())
        poses["0"][1]["cam_t_m2c"][0] += 1.0
        path.write_text(json.dumps(poses))
    problems = [problem.what for problem in validate(dataset)]
    assert any("instance 1: mask differs from the model at its pose" in what for what in problems)
    assert not any("instance 0" in what or "instance 2" in what for what in problems)


def test_a_visible_mask_that_covers_a_distractor_is_detected(dataset):
    scene = dataset / "train" / "000003"
    amodal = cv2.imread(str(scene / "mask" / "000000_000000.png"), cv2.IMREAD_UNCHANGED)
    visible = cv2.imread(str(scene / "mask_visib" / "000000_000000.png"), cv2.IMREAD_UNCHANGED)
    assert (amodal != visible).any()
    for kind in ("mask_visib", "mask_visib_sl"):
        cv2.imwrite(str(scene / kind / "000000_000000.png"), amodal)
    problems = [problem.what for problem in validate(dataset)]
    assert any("instance 0: depth is off the model at its pose" in what for what in problems)


def test_a_changed_distractor_changes_the_claim(dataset):
    store(dataset, (BOX, FOREIGN)).close()
    heavier = replace(FOREIGN, density_kg_m3=1.0)
    with pytest.raises(DatasetError, match="distractors"):
        store(dataset, (BOX, heavier))
    with pytest.raises(DatasetError, match="distractors"):
        store(dataset, (BOX,))


def test_a_claim_without_distractors_has_no_key_for_them(tmp_path):
    with store(tmp_path / "out", (BOX, WEDGE)):
        assert "distractors" not in json.loads((tmp_path / "out" / "graycast.json").read_text())


def test_labelled_parts_after_distractors_are_refused():
    with pytest.raises(ValueError, match="parts without a label must come last"):
        Scene(rig=make_rig(), T_world_cam=np.eye(4), parts=(FOREIGN, BOX))
