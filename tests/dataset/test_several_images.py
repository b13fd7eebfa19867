"""Scenes of several images by several scanners, written and read by rules of BOP."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from backends import slow
from prisms import CONFIG, SCALE_MM, SEED, box_part, build_sample, make_rig, wedge_part
from pycocotools.coco import COCO

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, rigid
from graycast.dataset.check.checking import validate
from graycast.dataset.read.pose_results import PoseEstimate, pose_results_text
from graycast.dataset.read.scene_content import scene_content
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.training import open_examples
from graycast.dataset.write.claim import Taker
from graycast.dataset.write.store import open_store
from graycast.score.evaluate import Protocol, evaluate_poses

# Pose of each image in the frame of the first one.
PLACES = {
    ("left", 0): None,
    ("left", 1): rigid(axis_rotation("y", 0.12), np.array([-0.05, 0.0, 0.01])),
    ("right", 0): rigid(axis_rotation("z", 0.3), np.array([0.02, 0.01, -0.02])),
}


@pytest.fixture(scope="module")
def dataset_and_samples(tmp_path_factory):
    """Return a dataset of two scenes with two images of one scanner and one of another."""
    parts, rig = (box_part(), wedge_part()), make_rig()
    out = tmp_path_factory.mktemp("several") / "out"
    samples = {
        scene_id: [
            build_sample(
                scene_id,
                parts=parts,
                rig=rig,
                sensor=sensor,
                image=image,
                station=int(sensor == "right"),
                T_first_cam=T,
            )
            for (sensor, image), T in PLACES.items()
        ]
        for scene_id in (0, 3)
    }
    takers = tuple(
        Taker(name=name, images=n, rig=rig, scanning={}) for name, n in (("left", 2), ("right", 1))
    )
    with open_store(
        out,
        config=CONFIG,
        seed=SEED,
        parts=parts,
        rig=rig,
        depth_scale_mm=SCALE_MM,
        takers=takers,
    ) as store:
        for scene_id, of_scene in samples.items():
            store.write(scene_id, iter(of_scene))
        store.finish(samples)
    return out, samples


@pytest.fixture
def copy(dataset_and_samples, tmp_path):
    return shutil.copytree(dataset_and_samples[0], tmp_path / "out")


def record_of(out, name):
    return json.loads((out / "train/000000" / f"{name}.json").read_text())


def test_a_dataset_of_several_images_is_valid(dataset_and_samples):
    assert validate(dataset_and_samples[0]) == ()


def test_each_file_of_a_scanner_has_the_name_and_numbers_of_that_scanner(dataset_and_samples):
    """BOP's convention for several sensors; files of a sensor without a name do not exist."""
    out, _ = dataset_and_samples
    scene = out / "train/000000"
    for kind in ("rgb", "depth", "gray_%s_sl", "depth_%s_sl", "reason_%s_sl", "modulation_%s_sl"):
        for sensor, images in (("left", 2), ("right", 1)):
            folder = scene / (kind % sensor if "%" in kind else f"{kind}_{sensor}")
            names = sorted(path.name for path in folder.iterdir())
            assert names == [f"{k:06d}.png" for k in range(images)]
    for name in ("rgb", "depth", "mask", "scene_gt.json", "scene_camera.json"):
        assert not (scene / name).exists()
    assert not (out / "camera.json").exists()
    assert (out / "camera_left.json").read_bytes() == (out / "camera_right.json").read_bytes()
    assert set(record_of(out, "scene_gt_left")) == {"0", "1"}
    assert set(record_of(out, "scene_gt_right_sl")) == {"0"}


def test_all_images_give_an_instance_the_same_pose_in_the_world(dataset_and_samples):
    """From the files alone: the inverse of world to camera, times model to camera."""
    poses = []
    for sensor, image in PLACES:
        view = record_of(dataset_and_samples[0], f"scene_camera_{sensor}")[str(image)]
        R_w2c = np.reshape(view["cam_R_w2c"], (3, 3))
        for pose in record_of(dataset_and_samples[0], f"scene_gt_{sensor}")[str(image)]:
            R = R_w2c.T @ np.reshape(pose["cam_R_m2c"], (3, 3))
            t = R_w2c.T @ (np.array(pose["cam_t_m2c"]) - view["cam_t_w2c"])
            poses.append(np.hstack([R, t[:, None]]))
    of_image = np.array(poses).reshape(len(PLACES), -1, 3, 4)
    assert np.abs(np.diff(of_image[..., 3], axis=0)).max() < 1e-9  # mm
    assert np.abs(np.diff(of_image[..., :3], axis=0)).max() < 1e-12
    gaps = [np.abs(view[0] - of_image[0, 1]).max() for view in of_image]
    assert min(gaps) > 0.1  # two instances differ


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools'
def test_pycocotools_reads_masks_of_every_image(dataset_and_samples):
    out, samples = dataset_and_samples
    coco = COCO(str(out / "train_coco.json"))
    assert sorted(coco.imgs) == [0, 1, 2, 9, 10, 11]  # three images a scene, scenes 0 and 3
    for image_id, image in coco.imgs.items():
        scene_id, k = divmod(image_id, 3)
        sample = samples[scene_id][k]
        assert image["file_name"] == (
            f"train/{scene_id:06d}/rgb_{sample.sensor}/{sample.image:06d}.png"
        )
        picture = cv2.imread(str(out / image["file_name"]))[..., ::-1]
        np.testing.assert_array_equal(picture, sample.rgb)
        visible = [sample.truth.instance == i for i in range(8)]
        masks = [coco.annToMask(entry) for entry in coco.imgToAnns[image_id]]
        assert len(masks) > 3
        for mask, must in zip(masks, (m for m in visible if m.any()), strict=True):
            np.testing.assert_array_equal(mask, must)


def test_the_data_of_each_image_are_read_back(dataset_and_samples):
    out, samples = dataset_and_samples
    stored = open_dataset(out)
    assert stored.images == (("left", 0), ("left", 1), ("right", 0))
    for scene in stored.scenes:
        for one, sample in zip(stored.images_of(scene), samples[scene.scene_id], strict=True):
            content = scene_content(one)
            np.testing.assert_array_equal(content.rgb, sample.rgb)
            np.testing.assert_array_equal(content.label, sample.truth.instance)
            np.testing.assert_array_equal(content.reason, sample.scanner_depth.reason)
            assert content.manifest["reasons"] == sample.manifest["reasons"]
            assert content.manifest["seeds"] == sample.manifest["seeds"]


def test_further_images_do_not_change_the_first(dataset_and_samples, samples, opened, tmp_path):
    """File names differ and records have more images, but the first image's entries are equal."""
    with opened(tmp_path / "one") as store:
        store.write(0, [samples[0]])
    one, several = tmp_path / "one/train/000000", dataset_and_samples[0] / "train/000000"
    for path in one.rglob("*.png"):
        kind, number = path.relative_to(one).parts
        plain = kind.removesuffix("_sl")
        other = several / f"{plain}_left{kind[len(plain) :]}" / number
        assert other.read_bytes() == path.read_bytes()
    claim = json.loads((tmp_path / "one/graycast.json").read_text())
    assert "scanners" not in claim


def _moved(scene):
    for suffix in ("", "_sl"):
        path = scene / f"scene_gt_left{suffix}.json"
        poses = json.loads(path.read_text())
        poses["1"][2]["cam_t_m2c"][0] += 0.01
        path.write_text(json.dumps(poses))


def _untold(scene):
    path = scene / "scene_gt_info_left.json"
    infos = json.loads(path.read_text())
    del infos["1"]
    path.write_text(json.dumps(infos))


def _one_record_more(scene):
    path = scene / "scene_right_sl.json"
    entries = json.loads(path.read_text())
    path.write_text(json.dumps(entries | {"1": entries["0"]}))


def _of_another_part(scene):
    for suffix in ("", "_sl"):
        path = scene / f"scene_gt_left{suffix}.json"
        poses = json.loads(path.read_text())
        poses["1"][2]["obj_id"] = 3 - poses["1"][2]["obj_id"]
        path.write_text(json.dumps(poses))


FAULTS = {
    "a pose that is another in the world": (_moved, "instance 2 lies 0.01 mm from where"),
    "an image that no record tells of": (_untold, "scene_gt_info_left.json tells of 1 images"),
    "a record of an image too many": (_one_record_more, "it must tell of 1: see image 1"),
    "depth of another image": (
        lambda scene: shutil.copy(scene / "depth_left/000000.png", scene / "depth_left/000001.png"),
        "image 1 left: instance",
    ),
    "a mask of no image": (
        lambda scene: shutil.copy(
            scene / "mask_right/000000_000000.png", scene / "mask_right/000007_000000.png"
        ),
        "image 0 right: mask_right/ has 9 files for 8 instances: see 000007_000000.png",
    ),
    "a colour picture that is gone": (
        lambda scene: (scene / "rgb_right/000000.png").unlink(),
        "rgb_right/000000.png is missing",
    ),
    "an instance that another image has not": (
        _of_another_part,
        "image 1: its instances are not those of the first image",
    ),
}


@pytest.mark.parametrize("fault", [*list(FAULTS)[::2], *map(slow, list(FAULTS)[1::2])])
def test_validate_names_the_wrong_image(copy, fault):
    change, says = FAULTS[fault]
    change(copy / "train/000000")
    problems = [str(problem) for problem in validate(copy)]
    assert any(says in what for what in problems), problems
    assert not any(what.startswith("scene 000003") for what in problems)


@pytest.mark.slow
def test_the_dataset_stores_the_rig_of_the_first_scanner(copy):
    path = copy / "graycast.json"
    claim = json.loads(path.read_text())
    claim["rig"]["far_m"] *= 2
    path.write_text(json.dumps(claim))
    assert any("rig is not that of the first" in problem.what for problem in validate(copy))


# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_poses_are_scored_in_the_image_that_they_belong_to(dataset_and_samples, tmp_path):
    """True poses of both images of the first scanner score 1; those of exchanged images do not."""
    examples = open_examples(dataset_and_samples[0])
    (true,) = {sensor for _, sensor, _ in examples.place_of.values()} - {"right"}
    estimates = [
        PoseEstimate(
            scene_id=scene_id, im_id=image, obj_id=int(obj_id), score=1.0, T_cam_part=T.copy()
        )
        for picture, (scene_id, sensor, image) in examples.place_of.items()
        if sensor == true
        for example in [examples.read(picture)]
        for obj_id, T, hidden in zip(
            example.obj_id,
            example.T_cam_part,
            example.hidden(Protocol().min_visibility),
            strict=True,
        )
        if not hidden  # Each instance to detect has one pose that counts.
    ]
    assert {one.im_id for one in estimates} == {0, 1}
    exchanged = [replace(one, im_id=1 - one.im_id) for one in estimates]
    recalls = []
    for name, content in (("true", estimates), ("exchanged", exchanged)):
        (tmp_path / f"{name}.csv").write_text(pose_results_text(content))
        result = evaluate_poses(
            tmp_path / f"{name}.csv", dataset_and_samples[0], protocol=Protocol(draws=10)
        )
        recalls.append(result.rows[0].figures["AR_MSSD"].value)
        assert result.scenes == 2
    assert recalls[0] == 1.0 and recalls[1] < 0.5
    (tmp_path / "third.csv").write_text(pose_results_text([replace(estimates[0], im_id=2)]))
    with pytest.raises(GraycastError, match="scene 0, image 2"):
        evaluate_poses(tmp_path / "third.csv", dataset_and_samples[0], protocol=Protocol())
