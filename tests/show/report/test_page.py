"""A dataset's web page: its files, and the rule that only changed scenes are built again."""

import base64
import json
import re
import shutil
import zlib
from importlib import resources

import cv2
import numpy as np
import pytest
from metered import Metered
from pictured import forget, write_dataset

from graycast.base.errors import DatasetError, GraycastError
from graycast.camera.decode import Reason
from graycast.show.report.page import dataset_page, write_report
from graycast.show.report.page.packing import pack_difference, pack_words

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "bins"
    write_dataset(out)
    return out


def planes(text):
    data = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8)
    low, high = data.reshape(2, -1).astype(np.int64)
    return low + 256 * high


def content(out):
    return {
        str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize("kind", ["random", "plane", "edge"])
def test_packed_values_are_unpacked_to_the_same_values(kind):
    """Oracle: two cumulative sums undo the two differences, which are zero for a plane."""
    v, u = np.mgrid[:31, :17]
    values = {
        "random": np.random.default_rng(0).integers(0, 65536, (31, 17)),
        "plane": 9000 + 3 * u - 2 * v,
        "edge": np.where(u > 8, 65535, 0),
    }[kind].astype(np.uint16)
    left_over = planes(pack_words(values)).reshape(values.shape)
    assert kind != "plane" or not left_over[1:, 1:].any()
    unpacked = left_over.cumsum(axis=0).cumsum(axis=1) % 65536
    np.testing.assert_array_equal(unpacked, values)


def test_packed_differences_of_both_signs_are_unpacked():
    base = np.array([[0, 65535, 9000, 9000, 5]], dtype=np.uint16)
    values = np.array([[65535, 1, 9003, 8990, 0]], dtype=np.uint16)
    folded = planes(pack_difference(values, base)).reshape(values.shape)
    d = np.where(folded % 2 == 1, -(folded + 1) // 2, folded // 2)
    unpacked = np.where(values > 0, (base + d) % 65536, 0)
    np.testing.assert_array_equal(unpacked, values)
    assert folded[0, 2:].tolist() == [6, 19, 0]


def test_a_second_build_writes_no_file(dataset, tmp_path):
    first = write_report(dataset, tmp_path / "page")
    before = content(tmp_path / "page")
    again = write_report(dataset, tmp_path / "page")
    assert (first.built, again.built, again.current) == (2, 0, 2)
    assert content(tmp_path / "page") == before


def test_only_a_changed_scene_is_built_again_and_a_deleted_one_is_removed(dataset, tmp_path):
    out = tmp_path / "bins"
    shutil.copytree(dataset, out)
    write_report(out, tmp_path / "page")
    (out / "train/000000/manifest.json").write_text('{"seed": 8}')
    shutil.copytree(out / "train/000000", out / "train/000001")
    shutil.rmtree(out / "train/000003")
    meter = Metered()
    summary = write_report(out, tmp_path / "page", progress=meter)
    whole = summary.built + summary.current
    assert meter.counts == [("scenes", summary.current + k, whole) for k in range(3)]
    assert (summary.built, summary.current, summary.removed) == (2, 0, 1)
    assert not (tmp_path / "page/scenes/train-000003").exists()


def test_a_build_continues_after_a_failure(dataset, tmp_path):
    out = tmp_path / "bins"
    shutil.copytree(dataset, out)
    path = out / "train/000003/rgb/000000.png"
    whole = path.read_bytes()
    path.write_bytes(whole[:100])
    with pytest.raises(DatasetError, match="000003"):
        write_report(out, tmp_path / "page")
    assert [p.name for p in (tmp_path / "page/scenes").iterdir()] == ["train-000000"]
    path.write_bytes(whole)
    assert write_report(out, tmp_path / "page").current == 1


def test_no_page_is_written_into_a_folder_of_other_files(dataset, tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(GraycastError, match=r"thesis\.tex"):
        write_report(dataset, tmp_path)
    with pytest.raises(GraycastError, match="give another folder for the page"):
        write_report(dataset, dataset)


def test_the_page_loads_no_file_from_the_network(dataset, tmp_path):
    write_report(dataset, tmp_path / "page")
    page = (tmp_path / "page/index.html").read_text()
    for name in re.findall(r'(?:src|href)="([^"#]+)"', page):
        assert name == "data:," or (tmp_path / "page" / name).is_file(), name
    for path in (tmp_path / "page").glob("*.*s"):
        addresses = set(re.findall(r"https?://[\w./]+", path.read_text()))
        assert addresses <= {"http://www.w3.org/2000/svg"}, path.name


def test_reasons_have_the_same_colours_on_the_page_as_in_pictures(dataset, tmp_path):
    write_report(dataset, tmp_path / "page")
    text = (tmp_path / "page/index.js").read_text()
    index = json.loads(text.removeprefix("Graycast.report = ").rstrip().rstrip(";"))
    assert {r["number"]: r["color"] for r in index["reasons"]} == {
        int(reason): reason.color for reason in Reason
    }
    assert [row[1] for row in index["scenes"]] == [0, 3]
    assert len(index["scanners"][""]["code"]["frames"]) == 2 + 8 + 7


def test_wide_maps_are_reduced(dataset, tmp_path):
    write_report(dataset, tmp_path / "page", width_px=100)
    text = (tmp_path / "page/scenes/train-000000/scene.js").read_text()
    scene = json.loads(text.removeprefix("Graycast.receive(").rstrip().removesuffix(");"))
    assert (scene["stride"], scene["width"], scene["height"]) == (2, 80, 60)


def test_frames_and_columns_are_in_separate_scripts(dataset, tmp_path):
    out = tmp_path / "bins"
    write_dataset(out, scene_ids=(0,), keeps=True)
    write_report(out, tmp_path / "page", width_px=100)
    folder = tmp_path / "page/scenes/train-000000"
    scripts = {}
    for name in ("scene", "frames", "columns"):
        text = (folder / f"{name}.js").read_text()
        scripts[name] = json.loads(
            text.removeprefix("Graycast.receive(").rstrip().removesuffix(");")
        )
    assert scripts["scene"]["kept"]["columns"] == ["column", "sigma_column", "row", "sigma_row"]
    assert scripts["scene"]["kept"]["frames"][:3] == ["white", "black", "column_bit07"]
    assert len(scripts["frames"]["pictures"]) == 18
    data = base64.b64decode(scripts["frames"]["pictures"][0].split(",")[1])
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED).shape == (60, 80)
    write_report(dataset, tmp_path / "plain")
    assert not list((tmp_path / "plain").rglob("frames.js"))


def test_a_damaged_frame_is_named(tmp_path):
    out = tmp_path / "bins"
    write_dataset(out, scene_ids=(0,), keeps=True)
    (out / "train/000000/frames/0007.png").write_bytes(b"x")
    with pytest.raises(DatasetError, match=r"0007\.png is cut off"):
        write_report(out, tmp_path / "page")


def test_pages_of_real_pictures_are_built(dataset, tmp_path):
    out = tmp_path / "bins"
    shutil.copytree(dataset, out)
    forget(out)
    assert write_report(out, tmp_path / "page").built == 2


def test_every_file_for_the_browser_is_on_a_page(dataset, tmp_path):
    """The names in Python and the files in `web` are the same: no file is missing or unused."""
    write_report(dataset, tmp_path / "page")
    web = {path.name for path in (resources.files(dataset_page.__package__) / "web").iterdir()}
    web -= {"types.d.ts"}  # Only TypeScript's checker reads this file.
    written = {path.name for path in (tmp_path / "page").glob("*.*")}
    assert written == web | {"index.js"}
    page = (tmp_path / "page/index.html").read_text()
    loaded = re.findall(r'(?:src|href)="([^"#]+\.(?:js|css))"', page)
    assert sorted(loaded) == sorted(written - {"index.html"}) and "$" not in page
