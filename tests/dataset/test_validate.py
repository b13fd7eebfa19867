"""A valid dataset has no problems; each kind of damage is one, with its scene and its reason."""

import json
import re
import shutil

import numpy as np
import pytest
import trimesh
from backends import slow
from PIL import Image
from simulated_dataset import write_dataset

from graycast.base.errors import DatasetError
from graycast.dataset.check.checking import Problem, each_problem, validate


@pytest.fixture
def damaged(dataset, tmp_path):
    return shutil.copytree(dataset, tmp_path / "out")


def edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def edit_both(scene, name, change):
    """Edit the colour camera's file and the scanner's consistently."""
    for suffix in ("", "_sl"):
        edit(scene / f"{name}{suffix}.json", change)


def repaint(path, change):
    image = np.array(Image.open(path))
    Image.fromarray(np.ascontiguousarray(change(image))).save(path)


def shift(scene, axis, by_mm):
    def change(gt):
        gt["0"][5]["cam_t_m2c"][axis] += by_mm

    edit_both(scene, "scene_gt", change)

    def follow(boxes):
        boxes["0"][5]["center"][axis] += by_mm

    edit(scene / "scene_gt_box3d.json", follow)


def turn(scene):
    """Rotate by half a degree about the camera's z: a rigid pose, but not that of the picture."""
    c, s = np.cos(np.radians(2.0)), np.sin(np.radians(2.0))

    def change(gt):
        R = np.array(gt["0"][5]["cam_R_m2c"]).reshape(3, 3)
        gt["0"][5]["cam_R_m2c"] = (
            (np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R).ravel().tolist()
        )

    edit_both(scene, "scene_gt", change)


def scale_focus(scene, factor=1.02, both=True):
    def change(view):
        view["0"]["cam_K"][0] *= factor
        view["0"]["cam_K"][4] *= factor

    edit_both(scene, "scene_camera", change)
    if both:
        edit(scene.parent.parent / "camera.json", lambda c: c.update(fx=c["fx"] * factor))
        edit(scene.parent.parent / "camera.json", lambda c: c.update(fy=c["fy"] * factor))


def swap(scene, a, b, kinds=("mask", "mask_visib", "mask_sl", "mask_visib_sl")):
    for kind in kinds:
        first, second = (scene / kind / f"000000_{i:06d}.png" for i in (a, b))
        data = first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(data)


def all_masks(scene, change):
    for kind in ("mask", "mask_visib", "mask_sl", "mask_visib_sl"):
        for path in (scene / kind).iterdir():
            repaint(path, change)


def set_info(scene, key, value, i=5):
    edit(scene / "scene_gt_info.json", lambda info: info["0"][i].update({key: value}))


def truncate(path, share=0.5):
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


def flip_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def grow_mask(scene):
    """Add a row of pixels below the visible mask of instance 5, in the file alone."""
    for kind in ("mask_visib", "mask_visib_sl"):
        repaint(scene / kind / "000000_000005.png", lambda m: np.maximum(m, np.roll(m, 1, axis=0)))


def gt_entry(change):
    return lambda scene: edit_both(scene, "scene_gt", lambda gt: change(gt["0"]))


def coco_first(kind, **changes):
    """Return the first of a scene's own COCO images or annotations."""
    return lambda scene: edit(
        scene / "scene_gt_coco.json", lambda coco: coco[kind][0].update(**changes)
    )


SCENE_DAMAGE = {
    "a pose 2 mm to the right": (lambda s: shift(s, 0, 2.0), "mask differs from the model"),
    "a pose 2 mm down": (lambda s: shift(s, 1, -2.0), "mask differs from the model"),
    "a pose 2 mm deeper": (lambda s: shift(s, 2, 2.0), "depth is off the model"),
    "a pose 0.3 mm nearer": (lambda s: shift(s, 2, -0.3), "depth is off the model"),
    "a turned pose": (turn, "from the model|off the model"),
    "a box that forgot its pose": (turn, "scene_gt_box3d.json is not"),
    "a mirrored rotation": (
        gt_entry(lambda gt: gt[5].update(cam_R_m2c=[1, 0, 0, 0, 1, 0, 0, 0, -1.0])),
        "not a rotation",
    ),
    "an unknown object": (gt_entry(lambda gt: gt[5].update(obj_id=9)), "there is no model 9"),
    "another object": (gt_entry(lambda gt: gt[5].update(obj_id=1)), "from the model"),
    "an instance dropped from gt": (gt_entry(lambda gt: gt.pop()), "has 8 instances"),
    "poses of sl that differ": (
        lambda s: edit(s / "scene_gt_sl.json", lambda gt: gt["0"].reverse()),
        "scene_gt_sl.json differs",
    ),
    "a K of 2 % in scene and dataset": (scale_focus, "from the model"),
    "a K of 2 % in the scene": (lambda s: scale_focus(s, both=False), "not that of camera.json"),
    "a K of 0.5 % in scene and dataset": (lambda s: scale_focus(s, 1.005), "from the model"),
    "another depth scale": (
        lambda s: edit_both(s, "scene_camera", lambda v: v["0"].update(depth_scale=0.2)),
        "depth_scale is 0.2",
    ),
    "a world that is no rotation": (
        lambda s: edit_both(s, "scene_camera", lambda v: v["0"].update(cam_R_w2c=[2.0] * 9)),
        "cam_R_w2c is not a rotation",
    ),
    "two swapped masks": (lambda s: swap(s, 1, 2), "from the model"),
    "two swapped visible masks": (
        lambda s: swap(s, 1, 2, ("mask_visib", "mask_visib_sl")),
        "reaches beyond mask",
    ),
    "masks of sl swapped": (lambda s: swap(s, 1, 2, ("mask_sl",)), "masks of sl differ"),
    "mirrored masks": (lambda s: all_masks(s, np.fliplr), "from the model"),
    "a mirrored depth": (
        lambda s: repaint(s / "depth" / "000000.png", np.fliplr),
        "depth is off the model",
    ),
    "a depth shifted by one pixel": (
        lambda s: repaint(s / "depth" / "000000.png", lambda d: np.roll(d, 1, axis=1)),
        "depth is off the model",
    ),
    "a covered part claimed visible": (
        lambda s: [
            shutil.copy(s / "mask/000000_000000.png", s / kind / "000000_000000.png")
            for kind in ("mask_visib", "mask_visib_sl")
        ],
        "instance 5: mask_visib overlaps",
    ),
    "a visible part claimed hidden": (
        lambda s: [
            repaint(s / kind / "000000_000005.png", np.zeros_like)
            for kind in ("mask_visib", "mask_visib_sl")
        ],
        "hidden though nothing lies in front",
    ),
    "a grown mask": (grow_mask, "overlaps|reaches beyond"),
    "a mask of ones": (
        lambda s: repaint(s / "mask" / "000000_000001.png", lambda m: m // 255),
        "other than 0 and 255",
    ),
    "a mask of another size": (
        lambda s: repaint(s / "mask" / "000000_000001.png", lambda m: m[1:]),
        r"must be \(120, 160\)",
    ),
    "a missing mask": (lambda s: (s / "mask" / "000000_000002.png").unlink(), "7 files for 8"),
    "one mask too many": (
        lambda s: shutil.copy(s / "mask/000000_000002.png", s / "mask/000000_000008.png"),
        "9 files for 8",
    ),
    "a missing picture": (lambda s: (s / "rgb" / "000000.png").unlink(), "rgb/.* is missing"),
    "a picture cut off": (lambda s: truncate(s / "depth_sl" / "000000.png"), "cut off or damaged"),
    "a picture without its end": (
        lambda s: truncate(s / "rgb" / "000000.png", 0.9999),
        "cut off or damaged",
    ),
    "a flipped bit": (lambda s: flip_bit(s / "gray_sl" / "000000.png"), "cut off or damaged"),
    "an empty file": (lambda s: truncate(s / "depth" / "000000.png", 0.0), "cut off or damaged"),
    "a picture in 8 bits": (
        lambda s: repaint(s / "depth" / "000000.png", lambda d: (d // 256).astype(np.uint8)),
        "must be .* uint16",
    ),
    "a missing manifest": (lambda s: (s / "manifest.json").unlink(), "manifest.json is missing"),
    "a missing record": (lambda s: (s / "scene_gt_info_sl.json").unlink(), "is missing"),
    "half a record": (lambda s: truncate(s / "scene_gt.json"), "scene_gt.json: "),
    "a misspelt key": (
        lambda s: edit(s / "scene_gt_info.json", lambda i: i["0"][0].update(px_cnt=1)),
        "px_cnt",
    ),
    "a matrix of eight": (gt_entry(lambda gt: gt[0]["cam_R_m2c"].pop()), "cam_R_m2c: .* 9 items"),
    "an edited bbox_obj": (lambda s: set_info(s, "bbox_obj", [1, 2, 3, 4], 1), "bbox_obj is"),
    "an edited box across the border": (
        lambda s: set_info(s, "bbox_obj", [-30, 21, 75, 81]),
        r"bbox_obj is \[-30, 21, 75, 81\], the model",
    ),
    "an edited bbox_visib": (lambda s: set_info(s, "bbox_visib", [1, 2, 3, 4]), "bbox_visib is"),
    "a changed px_count_all": (lambda s: set_info(s, "px_count_all", 4000), "the model covers"),
    "a changed px_count_valid": (lambda s: set_info(s, "px_count_valid", 7), "px_count_valid is 7"),
    "a changed px_count_visib": (lambda s: set_info(s, "px_count_visib", 7), "px_count_visib is 7"),
    "a changed visib_fract": (lambda s: set_info(s, "visib_fract", 0.7), "visib_fract is 0.7"),
    "a box of what is hidden": (
        lambda s: set_info(s, "bbox_obj", [1, 1, 1, 1], 6),
        "though nothing is visible",
    ),
    "an unknown reason": (
        lambda s: repaint(s / "reason_sl" / "000000.png", lambda r: np.where(r == 4, 77, r)),
        "unknown value 77",
    ),
    "a depth without a reason": (
        lambda s: repaint(s / "depth_sl" / "000000.png", lambda d: np.where(d == 0, d.max(), d)),
        "whether there is a depth",
    ),
    "another table of reasons": (
        lambda s: edit(s / "scene_sl.json", lambda i: i["0"]["reasons"].update(DECODED=9)),
        "reasons are",
    ),
    "a run length moved": (
        lambda s: edit(
            s / "scene_gt_coco.json",
            lambda c: c["annotations"][1]["segmentation"]["counts"].__setitem__(
                slice(0, 2), [1, c["annotations"][1]["segmentation"]["counts"][0] - 1]
            ),
        ),
        "segmentation is not the mask_visib",
    ),
    "a COCO box edited": (
        lambda s: edit(
            s / "scene_gt_coco_sl.json", lambda c: c["annotations"][0]["bbox"].reverse()
        ),
        "scene_gt_coco_sl.json: annotation 1: bbox",
    ),
    "a COCO annotation dropped": (
        lambda s: edit(s / "scene_gt_coco.json", lambda c: c["annotations"].pop()),
        "annotations for",
    ),
    "a COCO category swapped": (
        coco_first("annotations", category_id=2),
        "is of category 2",
    ),
    "a COCO image of another size": (
        coco_first("images", width=7),
        "images must have one entry of image 0",
    ),
    "a COCO image of another number": (
        coco_first("images", id=3),
        "images and image_id must go from 0 to 0",
    ),
    "a COCO annotation of another number": (
        coco_first("annotations", id=9),
        "annotation 1 has id 9",
    ),
    "a COCO annotation of a crowd": (
        coco_first("annotations", iscrowd=1),
        "annotation 1 has id 1",
    ),
    "a COCO annotation to ignore": (
        lambda s: edit(
            s / "scene_gt_coco.json",
            lambda c: c["annotations"][0].update(ignore=not c["annotations"][0]["ignore"]),
        ),
        "annotation 1: ignore is",
    ),
    "fewer pixels across the border than in the image": (
        lambda s: set_info(s, "px_count_all", 1),
        "px_count_all is 1, the image alone has",
    ),
}


def coco(change):
    return lambda out: edit(out / "train_coco.json", change)


def models(change):
    return lambda out: edit(out / "models" / "models_info.json", change)


DATASET_DAMAGE = {
    "a scene dropped": (lambda out: shutil.rmtree(out / "train/000003"), "see .3."),
    "a half scene": (lambda out: (out / "train/.tmp-000005-ab").mkdir(), "left over"),
    "a stray folder": (lambda out: (out / "train/new").mkdir(), "train/new is no scene"),
    "no split file": (lambda out: (out / "train_coco.json").unlink(), "let the run finish"),
    "no camera": (lambda out: (out / "camera.json").unlink(), "camera.json is missing"),
    "no model": (lambda out: (out / "models/obj_000002.ply").unlink(), "obj_000002.ply is missing"),
    "half a model": (lambda out: truncate(out / "models/obj_000001.ply"), "obj_000001.ply"),
    "no texture": (lambda out: (out / "models/obj_000001.png").unlink(), "000001.png is missing"),
    "another diameter": (models(lambda i: i["1"].update(diameter=80.0)), "diameter is 80"),
    "another size": (models(lambda i: i["2"].update(size_x=51.0)), "object 2: box"),
    "an object less": (models(lambda i: i.pop("2")), "models_info.json has objects"),
    "a skewed symmetry": (
        models(lambda i: i["1"]["symmetries_discrete"][0].__setitem__(0, 1.0)),
        "not a rigid motion",
    ),
    "a split image renamed": (
        coco(lambda c: c["images"][0].update(file_name="rgb/000000.png")),
        "images are not the finished scenes",
    ),
    "a split annotation less": (coco(lambda c: c["annotations"].pop()), "the scene has"),
    "a split mask swapped": (
        coco(
            lambda c: c["annotations"][0].update(segmentation=c["annotations"][1]["segmentation"])
        ),
        "annotation 1: segmentation differs from scene 0",
    ),
    "a split category renamed": (coco(lambda c: c["categories"][0].update(name="x")), "categories"),
    "a split annotation renumbered": (
        coco(lambda c: c["annotations"][0].update(id=99)),
        "annotation ids are not 1, 2, 3",
    ),
    "a split annotation of no image": (
        coco(lambda c: c["annotations"][0].update(image_id=99)),
        "1 annotations of image 99, which does not exist",
    ),
    "an axis of symmetry of length 2": (
        models(
            lambda i: i["1"].update(symmetries_continuous=[{"axis": [0, 0, 2], "offset": [0] * 3}])
        ),
        "the axis of continuous symmetry 0 has not length 1",
    ),
    "a file elsewhere in the list of models": (
        lambda out: edit(
            out / "graycast.json", lambda c: c["sha256"].update({"../../passwd": "0" * 64})
        ),
        r"\.\./\.\./passwd leads out of the folder, and graycast.json tells of it",
    ),
    "a rig without a camera": (
        lambda out: edit(out / "graycast.json", lambda c: c["rig"].pop("camera")),
        "rig is none",
    ),
}


def test_a_valid_dataset_has_no_problems(dataset):
    assert validate(dataset) == ()


# The quick tests have one in five; all of them take eight seconds.
@pytest.mark.parametrize(
    "damage", [slow(name) if k % 5 else name for k, name in enumerate(SCENE_DAMAGE)]
)
def test_damage_in_a_scene_is_detected_and_the_scene_is_named(damaged, damage):
    """Scene 0 is damaged and 3 is not; the split file must not agree, either."""
    do, reason = SCENE_DAMAGE[damage]
    scene = damaged / "train" / "000000"
    do(scene)
    problems = validate(damaged)
    elsewhere = {p.scene for p in problems} - {0, None}
    assert elsewhere == ({3} if "dataset" in damage else set())
    texts = [problem.what for problem in problems if problem.scene == 0]
    assert any(re.search(reason, text) for text in texts), texts


@pytest.mark.parametrize("damage", DATASET_DAMAGE)
def test_damage_in_files_of_the_whole_dataset_is_detected(damaged, damage):
    do, reason = DATASET_DAMAGE[damage]
    do(damaged)
    texts = [problem.what for problem in validate(damaged) if problem.scene is None]
    assert any(re.search(reason, text) for text in texts), texts


def test_a_folder_that_is_no_dataset_is_an_error(tmp_path):
    with pytest.raises(DatasetError, match="not a Graycast dataset"):
        validate(tmp_path)
    with pytest.raises(DatasetError, match="not a Graycast dataset"):
        validate(tmp_path / "nowhere")


def test_an_empty_dataset_is_reported(opened, tmp_path):
    opened(tmp_path / "out").close()
    assert "train/ holds no scene" in [p.what for p in validate(tmp_path / "out")]


def test_the_text_of_a_problem_names_its_scene():
    assert str(Problem(scene=12, what="it broke")) == "scene 000012: it broke"
    assert str(Problem(scene=None, what="it broke")) == "it broke"


@pytest.mark.slow
def test_several_processes_find_the_same_problems_in_the_same_order(tmp_path):
    """This process checks scene 0, and others check scenes 3 to 5."""
    write_dataset(tmp_path / "out")
    for scene_id in (3, 5):
        grow_mask(tmp_path / "out" / "train" / f"{scene_id:06d}")
    problems = validate(tmp_path / "out", workers=2)
    assert problems == validate(tmp_path / "out")
    named = [p.scene for p in problems if "instance 5: mask_visib reaches beyond mask" in p.what]
    assert named == [3, 5]


def test_a_model_that_another_program_stores_as_binary_is_still_compared_with_the_masks(damaged):
    for model in (damaged / "models").glob("*.ply"):
        trimesh.load_mesh(model, process=False).export(model)
    (text,) = [problem.what for problem in validate(damaged)]
    assert "obj_000001.ply (and 1 more) is not as it was written" in text
    shift(damaged / "train" / "000003", 0, 1.0)
    texts = [problem.what for problem in validate(damaged) if problem.scene == 3]
    assert any("mask differs from the model at its pose" in text for text in texts), texts


@pytest.mark.parametrize("workers", [1, 2])
def test_a_problem_of_the_first_scene_is_known_before_the_second_scene_is_read(damaged, workers):
    """The second scene is deleted after the first problem, which a later read would notice."""
    first, *others = sorted((damaged / "train").iterdir())
    (first / "rgb" / "000000.png").unlink()
    problems = each_problem(damaged, workers=workers)
    assert next(problems).what == "rgb/000000.png is missing, manifest.json tells of it"
    for folder in others:
        shutil.rmtree(folder)
    assert {problem.scene for problem in problems} >= {int(folder.name) for folder in others}
