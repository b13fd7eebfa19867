"""An export appears completely or not at all, and its error has one line."""

import json
import os
import shutil
import sys

import pytest
from metered import Metered
from PIL import Image
from simulated_dataset import require_library, visible

from graycast.base.errors import DatasetError, GraycastError
from graycast.dataset.export import FORMATS, Options, Split, export, read_record

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

EACH_FORMAT = [
    pytest.param(form, marks=pytest.mark.slow) if form == "rerun" else form for form in FORMATS
]
SEED = next(
    seed
    for seed in range(100)  # a seed that gives four scenes to three sets
    if len({Split(shares=(0.5, 0.25, 0.25), seed=seed).place(i) for i in (0, 3, 4, 5)}) == 3
)


@pytest.mark.parametrize("form", EACH_FORMAT)
def test_every_format_lists_its_content_and_reports_each_scene(master, samples, tmp_path, form):
    require_library(form)
    meter = Metered()
    split = Split(shares=(0.5, 0.25, 0.25), seed=SEED)
    options = Options(format=form, split=split)
    record = export(master, tmp_path / form, options, progress=meter)
    assert meter.counts == [("pictures", k + 1, len(samples)) for k in range(len(samples))]
    assert read_record(tmp_path / form) == record
    assert record.splits == split.assign(samples)
    assert record.fingerprint == json.loads((master / "graycast.json").read_text())["fingerprint"]


@pytest.mark.parametrize(
    "form, module, extra",
    [("parquet", "pyarrow", "parquet"), ("ros2bag", "rosbags", "ros"), ("mcap", "rosbags", "ros"),
     ("rerun", "rerun", "rerun")],
)  # fmt: skip
def test_the_error_for_a_missing_library_names_its_extra(
    master, tmp_path, monkeypatch, form, module, extra
):
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, module, None)
    writer = f"graycast.dataset.export.{FORMATS[form].writer.partition('.')[0]}"
    monkeypatch.delitem(sys.modules, writer, raising=False)
    with pytest.raises(
        GraycastError, match=rf"is not installed: run pip install 'graycast\[{extra}"
    ):
        export(master, tmp_path / "out", Options(format=form))
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def truncated(master, tmp_path_factory):
    copy = shutil.copytree(master, tmp_path_factory.mktemp("truncated") / "copy")
    picture = copy / "train" / "000003" / "rgb" / "000000.png"
    picture.write_bytes(picture.read_bytes()[:-200])
    return copy


@pytest.mark.parametrize("form", EACH_FORMAT)
def test_a_truncated_picture_is_named_and_the_partial_export_is_removed(truncated, tmp_path, form):
    require_library(form)
    with pytest.raises(DatasetError, match=r"000003: rgb/000000.png is cut off or damaged"):
        export(truncated, tmp_path / "out", Options(format=form))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("form", [form for form in FORMATS if form != "rerun"])
def test_the_number_of_processes_does_not_change_an_export(master, tmp_path, form):
    """Recordings of rerun contain random ids; `test_rerun_log.py` compares their values."""
    require_library(form)
    options = Options(format=form, split=Split(shares=(0.5, 0.25, 0.25), seed=SEED))
    contents = []
    for workers in (1, 2):
        out, meter = tmp_path / f"{workers}", Metered()
        export(master, out, options, workers=workers, progress=meter)
        assert [count[1] for count in meter.counts] == [1, 2, 3, 4]
        files = sorted(path for path in out.rglob("*") if path.is_file())
        contents.append({str(path.relative_to(out)): path.read_bytes() for path in files})
    assert contents[0] == contents[1]


@pytest.mark.slow
def test_an_export_of_several_processes_fails_with_the_first_fault_and_leaves_nothing(
    truncated, tmp_path
):
    copy = shutil.copytree(truncated, tmp_path / "copy")
    (copy / "train" / "000004" / "rgb" / "000000.png").unlink()
    with pytest.raises(DatasetError, match=r"000003: rgb/000000.png is cut off or damaged"):
        export(copy, tmp_path / "out", Options(format="clouds"), workers=2)
    assert list(tmp_path.iterdir()) == [copy]


def test_missing_or_contradictory_labels_are_reported(master, tmp_path):
    copy = shutil.copytree(master, tmp_path / "copy")
    scene = copy / "train" / "000003"
    coco = json.loads((scene / "scene_gt_coco.json").read_text())
    coco["annotations"].pop()
    (scene / "scene_gt_coco.json").write_text(json.dumps(coco))
    with pytest.raises(DatasetError, match=r"visible of 8, scene_gt_coco.json \d annotations"):
        export(copy, tmp_path / "out", Options(format="yolo"))
    (scene / "scene_gt.json").unlink()
    with pytest.raises(DatasetError, match=r"000003: scene_gt.json is missing"):
        export(copy, tmp_path / "out", Options(format="coco"))


def test_a_folder_with_files_is_refused_as_export_folder(master, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(GraycastError, match="is not empty: choose another folder"):
        export(master, tmp_path, Options(format="coco"))
    with pytest.raises(GraycastError, match="is a file"):
        export(master, tmp_path / "thesis.txt", Options(format="coco"))
    with pytest.raises(GraycastError, match="is inside the dataset: choose a folder outside of it"):
        export(master, master / "export", Options(format="coco"))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(DatasetError, match="is not a Graycast dataset"):
        export(tmp_path, tmp_path / "out", Options(format="coco"))


def test_an_option_of_another_format_is_refused():
    with pytest.raises(GraycastError, match="parquet has no option polygons: remove it"):
        Options(format="parquet", polygons=True)
    with pytest.raises(GraycastError, match="depth is 'both': choose one of perfect, scanner"):
        Options(format="bop-webdataset", depth="both")
    with pytest.raises(GraycastError, match="mcap has no option link: remove it"):
        Options(format="mcap", link=True)
    with pytest.raises(GraycastError, match="format is 'voc': choose one of coco"):
        Options(format="voc")
    for former in ("bop-imagewise", "webdataset"):
        with pytest.raises(GraycastError, match=f"{former} is no longer .* as bop-webdataset"):
            Options(format=former)


def test_exported_links_share_the_file_and_copies_do_not(master, tmp_path):
    for name, link in (("linked", True), ("copied", False)):
        export(master, tmp_path / name, Options(format="yolo", link=link))
        picture = tmp_path / name / "images" / "train" / "000003.png"
        assert picture.samefile(master / "train/000003/rgb/000000.png") == link
        with Image.open(picture) as image:
            assert image.size == (160, 120)


def test_the_error_for_a_link_to_another_disk_names_the_cause(master, tmp_path, monkeypatch):
    def refuse(source, target):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(GraycastError, match="export to the same disk, or omit --link"):
        export(master, tmp_path / "out", Options(format="yolo", link=True))
    assert not list(tmp_path.iterdir())


def test_hidden_instances_are_left_out_if_requested(master, samples, tmp_path):
    export(master, tmp_path / "out", Options(format="coco", min_visibility=0.5))
    coco = json.loads((tmp_path / "out/annotations/instances_train.json").read_text())
    for scene_id, sample in samples.items():
        instances, masks, _ = visible(sample)
        shares = {
            i: mask.sum() / sample.truth.amodal[i].mask.sum()
            for i, mask in zip(instances, masks, strict=True)
        }
        gt_ids = [a["gt_id"] for a in coco["annotations"] if a["image_id"] == scene_id]
        assert gt_ids == [i for i, share in shares.items() if share >= 0.5]
        assert min(shares.values()) < 0.5
