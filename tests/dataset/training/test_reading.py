"""A dataset and every export of it give the same examples."""

import json
import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest
from simulated_dataset import SCALE_MM, visible

from graycast.base.errors import DatasetError
from graycast.base.frames import inverse
from graycast.dataset.export import Split
from graycast.dataset.files.seal import OWN, SUMS, sealed
from graycast.dataset.training import open_examples

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

FIELDS = {
    "K", "distortion", "rgb", "gray", "depth_m", "scanner_depth_m", "instance", "obj_id", "mask",
    "box_px", "T_cam_part", "visib_fract",
}  # fmt: skip
LABELS = {"instance", "obj_id", "mask", "box_px", "T_cam_part", "visib_fract"}
EXPORTS = {
    "coco": ({"depth": "both"}, FIELDS - {"gray"}),
    "coco polygons": ({"polygons": True, "image": "gray"}, LABELS | {"K", "distortion", "gray"}),
    "yolo": ({}, {"rgb", "obj_id", "mask", "box_px"}),
    "yolo boxes": ({"labels": "boxes"}, {"rgb", "obj_id", "box_px"}),
    "bop-webdataset": ({"shard_scenes": 3}, FIELDS - {"gray", "scanner_depth_m"}),
    "bop-webdataset scanner": (
        {"depth": "scanner", "image": "gray", "shard_scenes": 2},
        FIELDS - {"rgb", "depth_m"},
    ),
    "parquet": ({"image": "gray", "shard_scenes": 2}, FIELDS - {"rgb"}),
}

ABSENT = {
    "beartype", "coacd", "drjit", "jaxtyping", "lxml", "manifold3d", "mapbox_earcut",
    "matplotlib", "mitsuba", "mujoco", "networkx", "numba", "packaging", "pyoidn", "rapier3d",
    "rich", "scipy", "trimesh", "yaml",
}  # fmt: skip
READ = f"""
import importlib.abc, pickle, sys
from pathlib import Path

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
from graycast.dataset.files.seal import OWN, SUMS, sealed
from graycast.dataset.training import open_examples

read = [open_examples(Path(folder))[1] for folder in sys.argv[2:]]
Path(sys.argv[1]).write_bytes(pickle.dumps(read))
"""


def same(a, b, fields):
    for name in FIELDS:
        x, y = getattr(a, name), getattr(b, name)
        if name not in fields:
            assert y is None, name
        elif name == "T_cam_part":
            np.testing.assert_allclose(y, x, rtol=0, atol=1e-12)
        else:
            np.testing.assert_array_equal(y, x, err_msg=name)


def test_examples_read_from_a_dataset_agree_with_the_simulation(master, samples):
    examples = open_examples(master)
    assert examples.categories == {1: "box", 2: "wedge"}
    assert len(examples) == len(samples)
    for example, (scene_id, sample) in zip(examples, samples.items(), strict=True):
        instances, masks, boxes = visible(sample)
        assert example.scene_id == scene_id
        np.testing.assert_array_equal(example.rgb, sample.rgb)
        np.testing.assert_array_equal(example.gray, sample.gray)
        np.testing.assert_array_equal(example.mask, masks)
        np.testing.assert_array_equal(example.box_px, boxes)
        np.testing.assert_array_equal(example.instance, instances)
        np.testing.assert_array_equal(example.obj_id, sample.layout.part_index[instances] + 1)
        half_step_m = 0.51e-3 * SCALE_MM  # the rounding of the file, and of single precision
        np.testing.assert_allclose(example.depth_m, sample.truth.depth_m, atol=half_step_m)
        scanner = np.where(sample.scanner_depth.reason == 0, sample.scanner_depth.depth_m, np.nan)
        np.testing.assert_allclose(example.scanner_depth_m, scanner, atol=half_step_m)
        T = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part[instances]
        np.testing.assert_allclose(example.T_cam_part, T, atol=1e-12)
        np.testing.assert_array_equal(example.K, sample.scene.rig.camera.K)


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_gives_the_same_examples_as_the_dataset(master, exported, name):
    options, fields = EXPORTS[name]
    if name == "parquet":
        pytest.importorskip("pyarrow", reason="pip install 'graycast[parquet]'")
    out = exported(name.split()[0], **options)
    for a, b in zip(open_examples(master), open_examples(out), strict=True):
        assert a.scene_id == b.scene_id
        same(a, b, fields)


def test_a_dataset_and_its_export_are_divided_into_the_same_sets(master, exported):
    division = Split(shares=(0.5, 0.5, 0.0), seed=4)
    out = exported("bop-webdataset", split=division)
    scene_ids = []
    for split in ("train", "val"):
        own = open_examples(master, split=split, division=division)
        assert own.scene_ids == open_examples(out, split=split).scene_ids
        scene_ids += own.scene_ids
    assert sorted(scene_ids) == [0, 3, 4, 5]
    with pytest.raises(DatasetError, match="has no set 'test': choose one of train, val"):
        open_examples(out, split="test")
    with pytest.raises(DatasetError, match="was divided when it was exported"):
        open_examples(out, division=division)


@pytest.mark.parametrize("form", ["coco", "bop-webdataset", "parquet"])
def test_examples_can_be_pickled(exported, form):
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="pip install 'graycast[parquet]'")
    examples = open_examples(exported(form))
    sent = pickle.loads(pickle.dumps(examples))
    same(examples[-1], sent[-1], FIELDS - {f for f in FIELDS if getattr(sent[-1], f) is None})
    assert len(sent[1:3]) == 2
    with pytest.raises(IndexError):
        sent[4]


@pytest.mark.parametrize(
    ("form", "path"),
    [
        ("coco", "images/train/000003.png"),
        ("yolo", "images/train/000003.png"),
        ("bop-webdataset", "train/shard-000000.tar"),
        ("parquet", "train/part-000000.parquet"),
        ("coco", "annotations/instances_train.json"),
        ("yolo", "export.json"),
    ],
)
def test_a_truncated_file_is_reported(exported, form, path):
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="pip install 'graycast[parquet]'")
    out = exported(form)
    data = (out / path).read_bytes()
    (out / path).write_bytes(data[: int(len(data) * 0.4)])
    with pytest.raises(DatasetError) as caught:
        list(open_examples(out))
    assert "\n" not in str(caught.value)


def test_clouds_and_other_folders_are_refused_as_examples(exported, tmp_path, master):
    with pytest.raises(DatasetError, match="is not for training"):
        open_examples(exported("clouds"))
    with pytest.raises(DatasetError, match="is not a Graycast dataset"):
        open_examples(tmp_path)
    empty = shutil.copytree(master, tmp_path / "copy", ignore=shutil.ignore_patterns("train"))
    with pytest.raises(DatasetError, match="has no finished scene"):
        open_examples(empty)


@pytest.mark.parametrize("former", ["bop-imagewise", "webdataset"])
def test_the_error_for_a_former_export_format_names_the_new_format(exported, former):
    out = exported("yolo")
    path = out / "export.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": former}))
    words = f"the format {former} is no longer written or read: export as bop-webdataset, or as"
    with pytest.raises(DatasetError, match=words):
        open_examples(out)


@pytest.mark.slow
def test_a_dataset_and_its_exports_are_read_with_few_packages_installed(master, exported, tmp_path):
    options_of = {name: options for name, (options, _) in EXPORTS.items() if name != "parquet"}
    folders = [master, *(exported(name.split()[0], **options_of[name]) for name in options_of)]
    out = tmp_path / "examples.pickle"
    subprocess.run([sys.executable, "-c", READ, out, *folders], check=True)
    for folder, there in zip(folders, pickle.loads(out.read_bytes()), strict=True):
        here = open_examples(folder)[1]
        assert here.scene_id == there.scene_id
        same(here, there, {name for name in FIELDS if getattr(here, name) is not None})
    assert here.mask.any()


@pytest.mark.slow
def test_a_package_hidden_by_the_test_cannot_be_imported():
    """So the test above would notice an import of it."""
    wrong = READ.replace(
        "from graycast.dataset.training",
        "import graycast.camera.decode\nfrom graycast.dataset.training",
    )
    ended = subprocess.run([sys.executable, "-c", wrong, "x"], capture_output=True, text=True)
    assert ended.returncode == 1 and "No module named" in ended.stderr


def test_the_checksum_of_a_dataset_depends_on_contents_and_not_on_file_times(master, tmp_path):
    own = shutil.copytree(master, tmp_path / "own")
    before = open_examples(own).content_sum()
    assert before == open_examples(master).content_sum()
    path = open_examples(own).origins[-1]
    manifest = json.loads(path.read_text())
    for change, alike in (({"timings": {"render_s": 99.0}}, True), ({"device": "abacus"}, False)):
        changed = {k: v for k, v in (manifest | change).items() if k not in (SUMS, OWN)}
        files = [(name, (path.parent / name).read_bytes()) for name in manifest[SUMS]]
        *_, (name, content) = sealed(files, changed)
        assert name == path.name
        path.write_bytes(content)
        assert (open_examples(own).content_sum() == before) == alike
    path.unlink()
    with pytest.raises(DatasetError):
        open_examples(own).content_sum()
