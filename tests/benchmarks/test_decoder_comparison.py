"""Scenes with true depth are written once, and every decoder is compared with the truth."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from benchmarks import decoder_comparison, decoder_scenes
from benchmarks.decoder_comparison import Compared, compared, read_result, table
from graycast.base.errors import GraycastError
from graycast.base.frames import pixel_grid, transform_points
from graycast.camera.scanner import preset, take
from graycast.cell.resolve import patterns_of
from graycast.dataset.files.sample import Raw
from graycast.dataset.write.raw import raw_files
from graycast.rendering import Radiance
from graycast.rig.optics import project, rays

SHAPE = (48, 64)
OFF_M = 5e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the Gray code of one scene: a plane, whose truth is off on the right."""
    whole = preset("paper", "small")
    h, w = SHAPE
    size = {"width_px": w, "height_px": h, "cx_px": (w - 1) / 2, "cy_px": (h - 1) / 2}
    whole = replace(whole, rig=replace(whole.rig, camera=replace(whole.rig.camera, **size)))
    scanner = decoder_scenes.codes_of(whole)["gray"]
    rig = scanner.rig
    z_m = np.full(SHAPE, (rig.near_m + rig.far_m) / 2)
    point = rays(rig.camera, pixel_grid(*SHAPE)) * z_m[..., None]
    place = np.round(project(rig.projector, transform_points(rig.T_proj_cam, point))).astype(int)
    light = np.array([each[place[..., 1], place[..., 0]] / 255 for each in patterns_of(scanner)])
    one, zero = np.ones(SHAPE, np.float32), np.zeros(SHAPE, np.float32)
    radiance = Radiance(
        pattern=light.astype(np.float32),
        white=one,
        ambient=zero,
        white_rgb=np.ones((*SHAPE, 3), np.float32),
        ambient_rgb=np.zeros((*SHAPE, 3), np.float32),
        albedo=np.full((*SHAPE, 3), 0.5, np.float32),
        place_px=np.moveaxis(place, -1, 0).astype(np.float32),
    )
    scene = tmp_path_factory.mktemp("scenes") / "scene_00"
    (scene / "gray").mkdir(parents=True)
    capture = take(scanner, radiance, seed=1)
    for name, content in raw_files(Raw(scanner=scanner, capture=capture)):
        (scene / "gray" / Path(name).name).write_bytes(content)
    z_m[:, w // 2 :] += OFF_M
    np.savez(scene / "truth.npz", depth_m=z_m, parts=np.ones(SHAPE, bool))
    (scene / "scene.yaml").write_text(yaml.safe_dump({"material": "matt"}))
    return scene.parent


class GrayDecoder:
    """A decoder with the interface of OpenCV's, for pictures and their inverses."""

    def __init__(self, width, height):
        self.bits = [int(size - 1).bit_length() for size in (width, height)]

    def setWhiteThreshold(self, least_dn):
        self.least_dn = least_dn

    def getProjPixel(self, pictures, x, y):
        values = np.array([int(picture[y, x]) for picture in pictures]).reshape(-1, 2)
        assert all(picture.dtype == np.uint8 for picture in pictures)
        gray = values[:, 0] > values[:, 1]
        binary = []
        for bits in (gray[: self.bits[0]], gray[self.bits[0] :]):
            binary.append(int("".join(str(bit) for bit in np.cumsum(bits) % 2), 2))
        return bool((np.abs(np.diff(values)) < self.least_dn).any()), tuple(binary)


def test_every_decoder_is_compared_with_the_truth(folder, monkeypatch, tmp_path):
    pattern = SimpleNamespace(create=GrayDecoder)
    module = SimpleNamespace(GrayCodePattern=pattern)
    monkeypatch.setattr(cv2, "structured_light", module, raising=False)
    true_m = np.load(folder / "scene_00/truth.npz")["depth_m"]
    results = tmp_path / "mine"
    (results / "scene_00").mkdir(parents=True)
    np.savez(results / "scene_00/gray.npz", depth_m=np.where(true_m < true_m.max(), true_m, np.nan))
    rows = {row.decoder: row for row in compared(folder, results)}
    assert set(rows) == {
        decoder_comparison.OURS,
        decoder_comparison.LIMITED,
        decoder_comparison.PAPER,
        decoder_comparison.OPENCV,
        "mine",
    }
    for name in (decoder_comparison.OURS, decoder_comparison.PAPER, decoder_comparison.OPENCV):
        assert len(rows[name].wrong) > 0.95 * SHAPE[0] * SHAPE[1]
        assert rows[name].wrong.mean() == pytest.approx(0.5, abs=0.02)
    assert len(rows["mine"].wrong) == SHAPE[0] * SHAPE[1] / 2
    assert not rows["mine"].wrong.any()
    assert {(row.material, row.code) for row in rows.values()} == {("matt", "gray")}


def row(decoder, wrong, p_wrong=None, material="matt"):
    return Compared(
        decoder=decoder,
        code="gray",
        material=material,
        pixels=4,
        wrong=np.array(wrong, bool),
        p_wrong=None if p_wrong is None else np.array(p_wrong),
        seconds=2.0,
    )


def test_the_table_joins_the_pixels_of_all_scenes():
    rows = [row("a", [0, 1, 0], [0.1, 0.9, 0.1]), row("a", [0], [0.1], "dark"), row("b", [1, 1])]
    lines = table(rows).splitlines()[2:]
    assert lines == [
        "| a | gray | 50.0 | 25.00 | 1.000 | 0.100 | 37.5 | 2.00 |",
        "| b | gray | 50.0 | 100.00 |  |  |  | 2.00 |",
    ]
    assert len(table(rows, by_material=True).splitlines()) == 2 + 3


def test_results_of_another_decoder_that_are_missing_or_unknown_are_named(folder, tmp_path):
    with pytest.raises(GraycastError, match="has no scenes: write them with"):
        list(compared(tmp_path))
    with pytest.raises(GraycastError, match=r"gray.npz: is missing: write one file for each stack"):
        list(compared(folder, tmp_path))
    np.savez(tmp_path / "other.npz", depth=np.zeros(SHAPE))
    with pytest.raises(GraycastError, match="has depth: store depth_m, and sigma_m"):
        read_result(tmp_path / "other.npz", SHAPE)
    np.savez(tmp_path / "small.npz", depth_m=np.zeros((2, 3)))
    with pytest.raises(GraycastError, match="depth_m has not the camera's size of 64 x 48 px"):
        read_result(tmp_path / "small.npz", SHAPE)
    (tmp_path / "text.npz").write_text("no zip")
    with pytest.raises(GraycastError, match=r"text.npz: is no NPZ file"):
        read_result(tmp_path / "text.npz", SHAPE)


def test_a_scene_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(GraycastError, match="there is no scene 16: give numbers up to 15"):
        list(decoder_scenes.write_scenes(tmp_path / "out", [16]))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_scene_is_written_once_with_all_codes(tmp_path):
    rendered = []
    for _ in range(2):
        (scene,) = decoder_scenes.write_scenes(tmp_path, [4], samples=1, on_scene=rendered.append)
    assert rendered == [4]
    stacks = [path.parent.name for path in scene.glob("*/stack.yaml")]
    assert sorted(stacks) == sorted(decoder_scenes.CODECS)
    rows = list(compared(tmp_path))
    assert {row.material for row in rows} == {"metal 0.5"}
    assert all(row.pixels == rows[0].pixels > 0 for row in rows)
