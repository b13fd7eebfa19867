"""A rescan continues only with the same options and unchanged images."""

import json
import shutil
from dataclasses import fields, make_dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.camera.scanner import preset
from graycast.cell.config import RenderSection
from graycast.dataset.check.checking import validate
from graycast.dataset.training import open_examples
from graycast.dataset.write.claim import claimed_options
from graycast.real.rescan.open_source import open_source
from graycast.real.rescan.rescanning import RescanSpec, RescanTask, _claim, rescan
from graycast.real.rescan.source import SourceOptions

from .scene_files import POSE, gt_of, true_depth_m, write_dataset, write_json

RIG = preset("paper", "small")
SPEC = RescanSpec(render=RenderSection(samples=4, depth=2), seed=3)
K = "90,91,31,24.5"


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Return a folder with a dataset of two images and its rescan."""
    root = tmp_path_factory.mktemp("original")
    split = write_dataset(root / "lm", images=(0, 4), rgb=np.full((48, 64, 3), 150, np.uint8))
    rescan(open_source(split), RIG, root / "out", SPEC)
    return root


@pytest.fixture
def root(original, tmp_path):
    """Copy dataset and rescan, so that the rescan links to the copy and names it as its source."""
    shutil.copytree(original, tmp_path, symlinks=True, dirs_exist_ok=True)
    for link in [path for path in tmp_path.rglob("*") if path.is_symlink()]:
        place = tmp_path / link.readlink().relative_to(original)
        link.unlink()
        link.symlink_to(place)
    claim = json.loads((tmp_path / "out/graycast.json").read_text())
    write_json(
        tmp_path / "out/graycast.json", claim | {"sources": [str(tmp_path / "lm/train_pbr")]}
    )
    return tmp_path


def again(root, source="lm", **options):
    return rescan(
        open_source(root / source / "train_pbr", SourceOptions(**options)), RIG, root / "out", SPEC
    )


def problems(root, *, fast=False):
    return [problem.what for problem in validate(root / "out", fast=fast)]


# --- options -------------------------------------------------------------------------------------

SPECS = {
    "camera": "rig",
    "seed": 4,
    "render": RenderSection(samples=8, depth=2),
    "images": 1,
    "copies": True,
    "device": "cpu",
}
OPTIONS = {
    "sensor": "left",
    "models": Path("models"),
    "materials": Path("materials.yaml"),
    "depth_scale_mm": 0.2,
    "intrinsics": "91,91,31,24.5",
    "depth_only": True,
    "unit": "m",
    "ray_length": True,
}
NO_OTHER_RESULT = {"images", "copies", "device", "models", "materials"}


def claim_of(source, spec=SPEC):
    task = RescanTask(
        seed=spec.seed, device="cpu", source=source, scanner=RIG, spec=spec, depth_scale_mm=0.1
    )
    return _claim(task)


def test_every_option_that_changes_the_result_is_in_the_claim(original):
    source = open_source(original / "lm/train_pbr")
    options = replace(source.options, intrinsics=K)
    source = replace(source, options=options)
    before = claim_of(source)["fingerprint"]
    changed = {name: claim_of(source, replace(SPEC, **{name: SPECS[name]})) for name in SPECS}
    for name, value in OPTIONS.items():
        other = replace(source, options=replace(options, **{name: value}))
        changed[name] = claim_of(other)
    names = {field.name for kind in (RescanSpec, SourceOptions) for field in fields(kind)}
    assert set(changed) == names
    alike = {name for name, claim in changed.items() if claim["fingerprint"] == before}
    assert alike == NO_OTHER_RESULT


def test_the_claim_depends_on_the_intrinsics_but_not_on_their_file_name(original, tmp_path):
    source = open_source(original / "lm/train_pbr")
    file = tmp_path / "K.txt"
    file.write_text("90 0 31\n0 91 24.5\n0 0 1\n")

    def fingerprint(intrinsics):
        options = replace(source.options, intrinsics=intrinsics)
        return claim_of(replace(source, options=options))["fingerprint"]

    assert fingerprint(K) == fingerprint(str(file))
    file.write_text("90 0 31\n0 91 24.4\n0 0 1\n")
    assert fingerprint(K) != fingerprint(str(file))


def test_the_claim_of_a_source_changes_with_a_stated_look(original):
    """An object without a stated look gets the mean colour of the pictures, another object not."""
    source = open_source(original / "lm/train_pbr")
    assert source.plain == {1}
    stated = replace(source, plain=frozenset())
    assert claim_of(source)["fingerprint"] != claim_of(stated)["fingerprint"]


def test_a_newly_added_option_is_in_the_claim():
    new = make_dataclass("New", [("added", int, 0)], bases=(SourceOptions,), frozen=True)
    assert claimed_options(new(added=3), without=("models",)) == {
        "sensor": "",
        "materials": None,
        "depth_scale_mm": None,
        "intrinsics": None,
        "depth_only": False,
        "unit": None,
        "ray_length": False,
        "added": 3,
    }
    with pytest.raises(ValueError, match="SourceOptions has no field lens"):
        claimed_options(SourceOptions(), without=("lens",))


def test_a_rescan_is_not_continued_with_another_depth_scale(root):
    """Symptom: the rescan was continued, and `validate` accepted the mixture."""
    words = r"differs in config\.options\.depth_scale_mm \(null there, 0\.2 here\)"
    with pytest.raises(DatasetError, match=words):
        again(root, depth_scale_mm=0.2)
    assert problems(root) == []


# --- the source ----------------------------------------------------------------------------------


def change_json(path, image, **values):
    content = json.loads(path.read_text())
    entry = content[image]
    content[image] = [entry[0] | values] if isinstance(entry, list) else entry | values
    write_json(path, content)


def change_depth(scene):
    path = str(scene / "depth/000004.png")
    steps = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    steps[0, 0] += 1
    cv2.imwrite(path, steps)


MOVED = POSE.copy()
MOVED[0, 3] += 0.029
CHANGES = {
    "depth": change_depth,
    "rgb": lambda scene: shutil.copy(scene / "depth/000004.png", scene / "rgb/000004.jpg"),
    "scene_gt": lambda scene: change_json(scene / "scene_gt.json", "4", **gt_of(MOVED)),
    "scene_camera": lambda scene: change_json(
        scene / "scene_camera.json", "4", cam_K=[90, 0, 31, 0, 91, 24, 0, 0, 1]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_image_is_named(root, name):
    """Otherwise, the links would show the new original next to depth of the old one."""
    assert again(root).there == 2
    CHANGES[name](root / "lm/train_pbr/000000")
    words = (
        r"1 of the 2 images in .* are not what they were when they were scanned, first scene 0, "
        rf"image 4 \({name}\): restore .* remove the scenes 000000 in .*/out/train_pbr to scan"
    )
    with pytest.raises(DatasetError, match=words):
        again(root)
    for fast in (True, False):
        (what,) = problems(root, fast=fast)
        assert what.startswith("image 4: the original has changed since it was scanned")
        assert f"({name})" in what


def test_an_image_missing_in_the_source_is_named(root):
    for name in ("scene_gt", "scene_camera"):
        path = root / f"lm/train_pbr/000000/{name}.json"
        write_json(path, {"0": json.loads(path.read_text())["0"]})
    with pytest.raises(DatasetError, match=r"image 4 \(depth, rgb, scene_camera, scene_gt\)"):
        again(root)
    assert "has changed since it was scanned" in problems(root)[0]


def test_json_files_that_differ_only_in_layout_count_as_equal(root):
    for name in ("scene_gt", "scene_camera"):
        path = root / f"lm/train_pbr/000000/{name}.json"
        path.write_text(json.dumps(json.loads(path.read_text()), indent=7))
    assert again(root).there == 2 and problems(root) == []


def test_another_dataset_with_the_same_names_is_refused(root):
    shutil.copytree(root / "lm", root / "b")
    with pytest.raises(DatasetError, match=r"was made from .*/lm/train_pbr, not from .*/b/train"):
        again(root, "b")


def test_a_moved_dataset_can_be_continued_if_its_old_path_links_to_it(root):
    (root / "lm").rename(root / "moved")
    with pytest.raises(DatasetError, match="if the dataset was moved, put it back, or link it"):
        again(root, "moved")
    (root / "lm").symlink_to(root / "moved")
    assert again(root).there == 2 and problems(root) == []


def test_poses_are_compared_if_a_record_has_no_checksums(root):
    """Records of earlier versions have no checksums."""
    scene = root / "out/train_pbr/000000"
    for path in (scene / "scan_sl").iterdir():
        record = json.loads(path.read_text())
        del record["source"]
        write_json(path, record)
    assert problems(root) == []
    CHANGES["scene_gt"](root / "lm/train_pbr/000000")
    (what,) = problems(root)
    assert "image 4: scene_gt and scene_gt_sl: the poses of instance 0 are 29 mm apart" in what
    write_json(scene / "scene_gt.json", {"0": [gt_of(POSE)], "4": [gt_of(POSE), gt_of(POSE)]})
    (what,) = problems(root)
    assert "image 4: scene_gt has 2 objects, and scene_gt_sl other ones (1)" in what


@pytest.mark.slow
def test_a_change_that_affects_only_depth_is_named(tmp_path):
    (tmp_path / "in/depth").mkdir(parents=True)
    depth_m = true_depth_m().astype(np.float32)
    np.save(tmp_path / "in/depth/a.npy", depth_m)

    def scan(intrinsics=K):
        source = open_source(tmp_path / "in", SourceOptions(intrinsics=intrinsics))
        return rescan(source, RIG, tmp_path / "out", SPEC)

    assert (scan().written, scan().there) == (1, 1)
    with pytest.raises(DatasetError, match=r"differs in config\.options\.intrinsics"):
        scan("91,91,31,24.5")
    depth_m[0, 0] += 1e-3
    np.save(tmp_path / "in/depth/a.npy", depth_m)
    with pytest.raises(DatasetError, match=r"first scene 0, image 0 \(depth_m\)"):
        scan()


def test_a_damaged_record_is_named_with_the_remedy(root):
    (root / "out/train_pbr/000000/scan_sl/000004.json").write_text("{")
    with pytest.raises(DatasetError, match=r"000004\.json.*remove this record to scan its image"):
        again(root)


# --- links ---------------------------------------------------------------------------------------

GONE = "the original in {} is gone: put it back, or link it there (graycast rescan --copy"


def test_links_to_missing_files_are_named(root):
    """Symptom: `validate` accepted such a rescan, and readers silently gave no picture."""
    scene = root / "lm/train_pbr/000000"
    (root / "lm").rename(root / "moved")
    for fast in (True, False):
        top, of_scene = problems(root, fast=fast)
        assert f"models: {GONE.format(root / 'lm')}" in top
        listed = "depth, rgb, scene_camera.json, scene_gt.json"
        assert f"{listed}: {GONE.format(scene)}" in of_scene
    with pytest.raises(DatasetError) as caught:
        open_examples(root / "out/train_pbr")
    assert GONE.format(scene) in str(caught.value)


def test_a_picture_that_is_a_dead_link_is_not_reported_as_missing(root):
    picture = root / "lm/train_pbr/000000/rgb/000000.jpg"
    picture.rename(root / "away.jpg")
    picture.symlink_to(root / "gone/away.jpg")
    words = rf"rgb/000000\.jpg: the original in {root}/gone is gone"
    with pytest.raises(DatasetError, match=words):
        open_examples(root / "out/train_pbr")[0]
    assert any("rgb/000000.jpg: the original" in what for what in problems(root))


@pytest.mark.slow
def test_a_rescan_with_copies_replaces_existing_links(root):
    source = open_source(root / "lm/train_pbr")
    rescan(source, RIG, root / "out", replace(SPEC, copies=True))
    assert not [path for path in (root / "out").rglob("*") if path.is_symlink()]
    (root / "lm").rename(root / "moved")
    assert problems(root) == []
    assert open_examples(root / "out/train_pbr")[0].rgb is not None


def test_a_dead_link_is_replaced_by_a_valid_link(root):
    """The original exists, but the link of an earlier run points to another place."""
    link = root / "out/train_pbr/000000/rgb"
    link.unlink()
    link.symlink_to(root / "nowhere/rgb")
    assert again(root).there == 2
    assert link.resolve() == root / "lm/train_pbr/000000/rgb"
