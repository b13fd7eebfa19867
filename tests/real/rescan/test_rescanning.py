"""Rescans add simulated scanner depth to third-party datasets, reproducibly."""

import errno
import hashlib
import json
import pickle
import re
import shutil
from collections import Counter
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from small_cell import shrunk

from graycast.base.errors import ConfigError, DatasetError, DeviceError, GraycastError
from graycast.base.streams import image_seeds, rescan_seeds
from graycast.camera.decode import Reason
from graycast.camera.scanner import preset
from graycast.cell.config import RenderSection
from graycast.dataset.check.checking import validate
from graycast.dataset.check.rescan_check import scene_records
from graycast.dataset.read.rescanned import image_records
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.training import open_examples
from graycast.dataset.training.foreign import is_foreign, open_foreign
from graycast.real.rescan import rescan_folder
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.rescanning import ImageScanner, RescanSpec, rescan
from graycast.real.rescan.source import SourceOptions
from graycast.rig.optics import points
from graycast.show.report.rescan_page import write_rescan_page

from .scene_files import (
    CAMERA,
    POSE,
    SCALE_MM,
    gt_of,
    png,
    true_depth_m,
    write_dataset,
    write_json,
    write_scene,
)

FEW = RenderSection(samples=4, depth=2)
RIG = preset("paper", "small")


def spec(**words):
    return RescanSpec(**{"render": FEW, "seed": 3} | words)


def tree(folder):
    """Return the digest of every file below a folder; links are followed."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Make a dataset with scenes of two images and one image, and its rescan."""
    root = tmp_path_factory.mktemp("rescan")
    rgb = np.full((48, 64, 3), 150, dtype=np.uint8)
    split = write_dataset(root / "lm", images=(0, 4), rgb=rgb)
    write_scene(split / "000002", images=(1,))
    write_json(root / "lm/models/models_info.json", {"1": {"name": "nut"}})
    before = tree(root / "lm")
    summary = rescan(open_source(split), RIG, root / "out", spec())
    assert tree(root / "lm") == before
    return root, split, summary


def scanned(folder, image):
    view = json.loads((folder / "scene_camera_sl.json").read_text())[str(image)]
    steps = cv2.imread(str(folder / f"depth_sl/{image:06d}.png"), cv2.IMREAD_UNCHANGED)
    return np.where(steps > 0, steps * view["depth_scale"] / 1e3, np.nan), view


def test_a_rescan_measures_the_depth_of_the_original(dataset):
    root, _, summary = dataset
    assert (summary.written, summary.there, summary.set_aside) == (3, 0, {})
    depth_m, view = scanned(root / "out/train_pbr/000000", 4)
    assert view["cam_K"] == pytest.approx(CAMERA.K.ravel())
    alike, _ = scanned(root / "out/train_pbr/000000", 0)
    assert not np.array_equal(alike, depth_m, equal_nan=True)  # each image has independent noise
    assert summary.reasons["decoded"] == pytest.approx(np.isfinite(depth_m).mean(), abs=0.1)
    assert np.isfinite(depth_m).mean() > 0.4
    # A pixel sees ten columns of Gray code, each of which is 1 to 2 mm.
    assert np.nanmedian(np.abs(depth_m - true_depth_m())) < 5e-3


def test_shares_of_the_pixels_on_parts_agree_with_the_masks(dataset):
    """Oracle: counts of pixels in the written pictures."""
    root, _, summary = dataset
    own_pixels = []
    for scene, image in ((0, 0), (0, 4), (2, 1)):
        folder = root / f"out/train_pbr/{scene:06d}"
        record = image_records(folder)[image]
        reason, mask = (
            cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
            for name in (f"reason_sl/{image:06d}.png", f"mask_visib_sl/{image:06d}_000000.png")
        )
        for pixels, written in (
            (reason, record.reasons),
            (reason[mask == 255], record.part_reasons),
        ):
            counted = {one.label: np.mean(pixels == one) for one in Reason}
            assert written == pytest.approx(counted)
        own_pixels.append(reason[mask == 255])
    pooled = np.concatenate(own_pixels) == Reason.DECODED
    assert summary.part_reasons["decoded"] == pytest.approx(pooled.mean())


@pytest.mark.slow
def test_pixels_that_the_projector_cannot_light_have_their_own_reason(tmp_path):
    """Oracle: with pinholes, the whole ray of such a pixel is outside the projector's picture."""
    own = RIG.rig.projector
    narrow = replace(own, fx_px=3 * own.fx_px, fy_px=3 * own.fy_px)
    scanner = replace(RIG, rig=replace(RIG.rig, projector=narrow))
    split = write_dataset(tmp_path / "lm")
    rescan(open_source(split), scanner, tmp_path / "out", spec())
    path = tmp_path / "out/train_pbr/000000/reason_sl/000000.png"
    reason = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    y, x = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    ray = np.linalg.inv(CAMERA.K) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    sides = []
    for z_m in (RIG.rig.near_m, RIG.rig.far_m, true_depth_m().ravel()):
        point = np.linalg.inv(RIG.rig.T_cam_proj) @ np.vstack([ray * z_m, np.ones(x.size)])
        u, v, _ = narrow.K @ (point[:3] / point[2])
        sides.append(np.array([u < -1, u > narrow.width_px, v < -1, v > narrow.height_px]))
    beside = np.all(sides, axis=0).any(axis=0).reshape(x.shape)
    assert 50 < beside.sum() < 0.9 * beside.size
    # Indirect light may give a code to pixels that the projector does not light.
    assert np.mean(reason[beside] == Reason.OUTSIDE_PROJECTOR) > 0.97


def test_the_noise_of_a_rescan_differs_from_that_of_a_dataset_and_of_another_rig(dataset):
    root, _, _ = dataset
    for image, record in image_records(root / "out/train_pbr/000000").items():
        assert record.seeds == rescan_seeds(3, 0, scanner=RIG.rig.name, image=image)
        source = image_seeds(3, 0, station=0, image=image)
        assert not set(record.seeds.values()) & set(source.values())


def test_a_rescan_has_the_layout_of_the_original_and_links_to_its_files(dataset):
    root, split, _ = dataset
    scene = root / "out/train_pbr/000000"
    assert (root / "out/models").resolve() == (root / "lm/models").resolve()
    assert (scene / "rgb").is_symlink() and (scene / "depth").resolve() == split / "000000/depth"
    own = json.loads((scene / "scene_gt.json").read_text())
    added = json.loads((scene / "scene_gt_sl.json").read_text())
    assert list(added) == list(own) == ["0", "4"]
    assert added["4"][0]["obj_id"] == 1
    assert added["4"][0]["cam_t_m2c"] == pytest.approx(own["4"][0]["cam_t_m2c"])
    assert Counter(path.name for path in (root / "out/train_pbr").iterdir()) == Counter(
        ["000000", "000002"]
    )
    info = json.loads((scene / "scene_gt_info_sl.json").read_text())["0"][0]
    cube = true_depth_m() < 0.8
    assert info["px_count_visib"] == info["px_count_all"] == cube.sum()
    coco = COCO(str(scene / "scene_gt_coco_sl.json"))
    assert [image["id"] for image in coco.loadImgs(coco.getImgIds())] == [0, 4]
    assert [one["id"] for one in coco.loadAnns(coco.getAnnIds())] == [1, 2]
    own = coco_mask.encode(np.asfortranarray(cube, dtype=np.uint8))
    assert coco.annToRLE(coco.loadAnns([2])[0]) == own


def test_the_reader_for_training_reads_true_and_rescanned_depth(dataset):
    root, _, _ = dataset
    examples = open_foreign(root / "out/train_pbr")
    assert len(examples.scene_of) == 3 and dict(examples.categories) == {1: "nut"}
    example = examples.read(1)
    np.testing.assert_allclose(example.depth_m, true_depth_m(), atol=6e-5)
    depth_m, _ = scanned(root / "out/train_pbr/000000", 4)
    np.testing.assert_allclose(example.scanner_depth_m, depth_m, atol=1e-6)
    assert example.rgb is not None and example.gray is not None and example.mask.sum() > 50
    with pytest.raises(DatasetError, match="scanner depth for a dataset of others"):
        open_dataset(root / "out")


@pytest.mark.slow
def test_one_of_several_cameras_is_rescanned_and_read_for_training(tmp_path):
    """The names of all files end in the name of a camera, as in the dataset IPD."""
    split = write_dataset(tmp_path / "ipd", sensor="photoneo")
    write_scene(split / "000000", sensor="cam1")
    source = open_source(split, SourceOptions(sensor="photoneo"))
    rescan(source, RIG, tmp_path / "out", spec())
    assert validate(tmp_path / "out") == ()
    out = tmp_path / "out/train_pbr"
    assert (out / "000000/depth_cam1").is_symlink() and is_foreign(out)
    example = open_foreign(out).read(0)
    np.testing.assert_allclose(example.depth_m, true_depth_m(), atol=6e-5)
    assert np.isfinite(example.scanner_depth_m).mean() > 0.4


@pytest.mark.slow
def test_a_rescan_is_reproducible_and_continues_after_a_stop(dataset, tmp_path):
    root, split, _ = dataset
    first = rescan(open_source(split), RIG, tmp_path / "out", spec(images=1))
    assert (first.written, first.there) == (1, 0)
    left = tmp_path / "out/train_pbr/000000/depth_sl/.tmp-000004.png-0"
    left.write_text("half")
    again = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert (again.written, again.there) == (2, 1) and not left.exists()

    def without_times(folder):
        pictures = {k: v for k, v in tree(folder).items() if "scan_sl" not in k}
        return {k: v for k, v in pictures.items() if not k.startswith("graycast")}

    assert without_times(tmp_path / "out") == without_times(root / "out")
    other = rescan(open_source(split), RIG, tmp_path / "b", spec(images=1, seed=4))
    assert other.reasons != first.reasons
    with pytest.raises(DatasetError, match="differs in seed"):
        rescan(open_source(split), RIG, tmp_path / "out", spec(seed=4))


@pytest.mark.slow
def test_images_that_cannot_be_scanned_are_set_aside(tmp_path):
    """In the second image, the cube is in front of the depth; the third is too far."""
    split = write_dataset(tmp_path / "lm", images=(0, 1, 2))
    scene = split / "000000"
    gt = json.loads((scene / "scene_gt.json").read_text())
    near = POSE.copy()
    near[2, 3] -= 0.2
    write_json(scene / "scene_gt.json", gt | {"1": [gt_of(near)]})
    views = json.loads((scene / "scene_camera.json").read_text())
    views["2"]["depth_scale"] = 1.0
    write_json(scene / "scene_camera.json", views)
    summary = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert summary.written == 1
    assert list(summary.set_aside) == [(0, 1), (0, 2)]
    assert "check the unit of the models" in summary.set_aside[0, 1]
    listed = json.loads((tmp_path / "out/set_aside.json").read_text())
    assert list(listed) == ["000000/000001", "000000/000002"]
    assert "measures from 0.458 to 1.12 m: choose another rig" in listed["000000/000002"]["reason"]
    rescan(open_source(split), RIG, tmp_path / "out", spec(images=1))  # It tries neither of them.
    assert json.loads((tmp_path / "out/set_aside.json").read_text()) == listed
    assert validate(tmp_path / "out") == ()
    write_json(scene / "scene_gt.json", gt)
    write_json(scene / "scene_camera.json", views | {"2": views["0"]})
    again = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert (again.written, again.there, again.set_aside) == (2, 1, {})
    assert not (tmp_path / "out/set_aside.json").exists()


@pytest.mark.slow
def test_an_image_whose_device_is_lost_is_tried_three_times(tmp_path, monkeypatch):
    """Symptom: a rescan ended at the first error of its device."""
    split, real, tries = write_dataset(tmp_path / "lm"), ImageScanner.make, []

    def make(self, scene_id):
        tries.append(scene_id)
        if len(tries) < 3:
            raise DeviceError("the driver is lost")
        return real(self, scene_id)

    monkeypatch.setattr(ImageScanner, "make", make)
    summary = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert (tries, summary.written, summary.set_aside) == ([0, 0, 0], 1, {})


def test_a_rig_of_another_range_is_refused_before_any_work(tmp_path):
    split = write_dataset(tmp_path / "lm")
    far = replace(RIG, rig=replace(RIG.rig, near_m=1.0, far_m=1.2))
    with pytest.raises(ConfigError, match=r"scene 0, image 0: its depth is .*graycast rig list"):
        rescan(open_source(split), far, tmp_path / "out", spec())
    assert not list((tmp_path / "out").rglob("*_sl"))


@pytest.mark.slow
def test_a_first_image_that_cannot_be_scanned_does_not_end_the_run(tmp_path):
    split = write_dataset(tmp_path / "lm", images=(0, 1))
    file = split / "000000/scene_camera.json"
    views = json.loads(file.read_text())
    write_json(file, views | {"0": views["0"] | {"depth_scale": 1.0}})
    summary = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert summary.written == 1 and list(summary.set_aside) == [(0, 0)]
    views = json.loads(file.read_text())
    write_json(file, views | {"0": views["1"]})
    again = rescan(open_source(split), RIG, tmp_path / "out", spec())
    assert (again.written, again.there, again.set_aside) == (1, 1, {})


@pytest.mark.slow
def test_a_rescan_contains_only_complete_copies_of_scanned_scenes(dataset, tmp_path, monkeypatch):
    _, split, _ = dataset
    copy = shutil.copy2

    def full(path, place, **words):
        if str(path).endswith("depth/000004.png"):
            raise OSError(errno.ENOSPC, "No space left on device")
        return copy(path, place, **words)

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(
            rescan_folder.shutil, "copytree", partial(shutil.copytree, copy_function=full)
        )
        with pytest.raises(DatasetError, match=r"cannot be written \(.*\): free space"):
            rescan(open_source(split), RIG, out, spec(images=1, copies=True))
    assert not (out / "train_pbr/000000/depth").exists()
    rescan(open_source(split), RIG, out, spec(images=1, copies=True))
    assert len(list((out / "train_pbr/000000/depth").iterdir())) == 2
    assert not (out / "train_pbr/000002").exists()
    assert not [path for path in out.rglob("*") if path.is_symlink()]


def test_a_rescan_does_not_write_to_the_original(tmp_path):
    split = write_dataset(tmp_path / "lm")
    with pytest.raises(GraycastError, match="which is not changed"):
        rescan(open_source(split), RIG, split / "new", spec())
    with pytest.raises(GraycastError, match="holds no earlier result"):
        rescan(open_source(split), RIG, tmp_path / "lm", spec())


@pytest.mark.slow
def test_depth_without_models_becomes_a_dataset_in_bop_format(tmp_path):
    """The camera of the rig is used, and files are copied, so that the result has no links."""
    (tmp_path / "in/depth").mkdir(parents=True)
    np.save(tmp_path / "in/depth/a.npy", true_depth_m().astype(np.float32))
    K = ",".join(str(v) for v in (CAMERA.fx_px, CAMERA.fy_px, CAMERA.cx_px, CAMERA.cy_px))
    source = open_source(tmp_path / "in", SourceOptions(intrinsics=K))
    rig = replace(RIG, rig=replace(RIG.rig, camera=shrunk(RIG.rig.camera, 172, 129)))
    rescan(source, rig, tmp_path / "out", spec(camera="rig", copies=True))
    scene = tmp_path / "out/depth/000000"
    plain = json.loads((scene / "scene_camera.json").read_text())["0"]
    assert plain["cam_K"] == pytest.approx(CAMERA.K.ravel())
    steps = cv2.imread(str(scene / "depth/000000.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(steps * plain["depth_scale"] / 1e3, true_depth_m(), atol=2e-5)
    rescan(source, RIG, tmp_path / "same", spec())
    example = open_foreign(tmp_path / "same/depth").read(0)
    np.testing.assert_allclose(example.depth_m, true_depth_m(), atol=2e-5)
    depth_m, view = scanned(scene, 0)
    assert depth_m.shape == (129, 172)
    assert view["cam_K"] == pytest.approx(rig.rig.camera.K.ravel())
    assert np.isfinite(depth_m).mean() > 0.2  # The rig's camera sees more than the image shows.
    assert validate(tmp_path / "out") == ()
    assert open_foreign(tmp_path / "out/depth").read(0).scanner_depth_m.shape == (129, 172)


def test_the_page_shows_every_image_before_and_after_the_rescan(dataset, tmp_path):
    root, _, summary = dataset
    page = write_rescan_page(root / "out", tmp_path / "page")
    assert (page.images, page.of) == (3, 3)
    text = page.page.read_text()
    assert text.count("<img") == 18 and f"{summary.reasons['decoded']:.1%}" in text
    named = set(re.findall(r'src="([^"]+)"', text))
    assert {path.name for path in (tmp_path / "page/images").iterdir()} == {
        name.removeprefix("images/") for name in named
    }
    scanner = cv2.imread(str(tmp_path / "page/images/000000-000004-3.jpg"))
    depth_m, _ = scanned(root / "out/train_pbr/000000", 4)
    # Without depth, the picture is black, apart from JPEG errors in single pixels.
    assert scanner[np.isfinite(depth_m)].mean() > 2 * scanner[np.isnan(depth_m)].mean()


def test_a_pickled_source_reads_the_same_images(dataset):
    _, split, _ = dataset
    source = open_source(split)
    copy = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(copy.read(0, 4).depth_m, source.read(0, 4).depth_m)


@pytest.mark.parametrize(
    ("file", "damage", "words"),
    [
        ("depth_sl/000004.png", lambda image: np.where(image > 0, image + 1, image), "SHA-256"),
        ("mask_visib_sl/000000_000000.png", lambda image: 0 * image, "visible"),
        ("reason_sl/000000.png", lambda image: 0 * image, "disagree"),
    ],
)
def test_validate_detects_changed_files(dataset, tmp_path, file, damage, words):
    root, _, _ = dataset
    out = shutil.copytree(root / "out", tmp_path / "out", symlinks=True)
    assert validate(out) == () == validate(out, fast=True)
    path = out / "train_pbr/000000" / file
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), damage(image).astype(image.dtype))
    assert any(words in str(problem) for problem in validate(out))
    assert validate(out, fast=True)


def sealed_again(scene):
    """Recompute all checksums and JSON files of a scene, so that only its data are wrong."""
    for path in (scene / "scan_sl").iterdir():
        record = json.loads(path.read_text())
        sums = {
            name: hashlib.sha256((scene / name).read_bytes()).hexdigest()
            for name in record["sha256"]
        }
        write_json(path, record | {"sha256": sums})
    for name, content in scene_records(image_records(scene)).items():
        write_json(scene / f"{name}.json", content)


def repainted(name, change):
    def do(scene):
        image = cv2.imread(str(scene / name), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(scene / name), change(image))

    return do


def recorded(change):
    def do(scene):
        record = json.loads((scene / "scan_sl/000004.json").read_text())
        change(record["entries"])
        write_json(scene / "scan_sl/000004.json", record)

    return do


def twice(scene):
    recorded(lambda e: e["scene_gt_info_sl"].append(e["scene_gt_info_sl"][0]))(scene)
    for kind in ("mask_sl", "mask_visib_sl"):
        shutil.copy(scene / kind / "000004_000000.png", scene / kind / "000004_000001.png")


RESEALED = {
    "a depth picture of another size": (
        repainted("depth_sl/000004.png", lambda image: image[1:]), "depth_sl is (47, 64) uint16"
    ),
    "another step of depth": (
        recorded(lambda e: e["scene_camera_sl"].update(depth_scale=9.0)), "its depth_scale is not"
    ),
    "a mask of another size": (
        repainted("mask_sl/000004_000000.png", lambda image: image[1:]), "the masks of instance 0"
    ),
    "an instance twice": (twice, "the visible mask of instance 1 overlaps"),
    "another count of pixels": (
        recorded(lambda e: e["scene_gt_info_sl"][0].update(px_count_visib=1)),
        "scene_gt_info_sl others",
    ),
    "another box": (
        recorded(lambda e: e["scene_gt_info_sl"][0].update(bbox_visib=[0, 0, 1, 1])),
        "instance 0: bbox_visib is not",
    ),
    "another outline": (
        recorded(
            lambda e: e["scene_gt_coco_sl"]["annotations"][0]["segmentation"].update(counts=[3072])
        ),
        "instance 0: its segmentation",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", RESEALED)
def test_validate_detects_implausible_data_despite_recomputed_checksums(dataset, tmp_path, fault):
    out = shutil.copytree(dataset[0] / "out", tmp_path / "out", symlinks=True)
    do, words = RESEALED[fault]
    do(out / "train_pbr/000000")
    sealed_again(out / "train_pbr/000000")
    problems = [problem.what for problem in validate(out)]
    assert any(what.startswith("image 4: ") and words in what for what in problems), problems


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("graycast.json", '{"kind": "rescan"}', "graycast.json: "),
        ("train_pbr/000000/scan_sl/000004.json", "{", "000004.json: "),
        (
            "train_pbr/000000/scene_camera_sl.json",
            "{",
            "scene_camera_sl.json is missing or damaged",
        ),
        ("train_pbr/000000/scene_gt_sl.json", "{}", "scene_gt_sl.json is not what the records"),
    ],
)
def test_validate_names_a_changed_record(dataset, tmp_path, file, content, words):
    out = shutil.copytree(dataset[0] / "out", tmp_path / "out", symlinks=True)
    (out / file).write_text(content)
    problems = [problem.what for problem in validate(out, fast=True)]
    assert any(words in what for what in problems), problems


def test_a_rescan_without_images_is_not_a_valid_dataset(dataset, tmp_path):
    out = shutil.copytree(dataset[0] / "out", tmp_path / "out", symlinks=True)
    for path in (out / "train_pbr").glob("*/scan_sl"):
        shutil.rmtree(path)
    assert ["holds no image with a scan" in problem.what for problem in validate(out)] == [True]


@pytest.mark.slow
def test_validate_detects_depth_of_another_scene(dataset, tmp_path):
    _, split, _ = dataset
    out = tmp_path / "out"
    rescan(open_source(split), RIG, out, spec(images=1))
    (out / "train_pbr/000000/depth").unlink()
    steps = np.full((48, 64), 7000, dtype=np.uint16)
    (out / "train_pbr/000000/depth").mkdir()
    cv2.imwrite(str(out / "train_pbr/000000/depth/000000.png"), steps)
    changed, other = map(str, validate(out))
    assert "the original has changed since it was scanned (depth)" in changed
    assert "looked at another scene" in other


@pytest.mark.slow
def test_a_rescan_of_ray_lengths_stores_z(tmp_path):
    """The result has its own depth file, because a link to the original would give lengths."""
    split = write_dataset(tmp_path / "lm")
    length_m = np.linalg.norm(points(CAMERA, true_depth_m()), axis=-1)
    path = split / "000000/depth/000000.png"
    png(path, np.rint(length_m * 1e3 / SCALE_MM).astype(np.uint16))
    before = path.read_bytes()
    source = open_source(split, SourceOptions(ray_length=True))
    assert rescan(source, RIG, tmp_path / "out", spec()).set_aside == {}
    assert validate(tmp_path / "out") == () and path.read_bytes() == before
    (example,) = open_examples(tmp_path / "out/train_pbr")
    assert np.abs(example.depth_m - true_depth_m()).max() < 1e-3 * SCALE_MM
    off_m = np.abs(example.scanner_depth_m - true_depth_m())
    assert np.nanmedian(off_m) < 5e-3
    np.testing.assert_allclose(example.T_cam_part[0], POSE, atol=1e-6)


@pytest.mark.slow
def test_depth_files_with_four_digit_names_are_rescanned_and_read(tmp_path):
    split = write_dataset(tmp_path / "lm")
    folder = split / "000000/depth"
    (folder / "000000.png").rename(folder / "0000.png")
    assert rescan(open_source(split), RIG, tmp_path / "out", spec()).set_aside == {}
    assert validate(tmp_path / "out") == ()
    (example,) = open_examples(tmp_path / "out/train_pbr")
    assert np.abs(example.depth_m - true_depth_m()).max() < 1e-3 * SCALE_MM
