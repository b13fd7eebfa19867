"""One complete scene: its manifest agrees with its files."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml
from small_cell import write_cell

from graycast.camera.decode import Reason
from graycast.camera.picture import color_picture
from graycast.camera.scanner import measure, take
from graycast.cell import simulate
from graycast.cell.config import RenderSection, load_config
from graycast.cell.resolve import load_cell, open_cell_renderer, resolve_cell
from graycast.cell.simulate import counts_of, make_scene
from graycast.rendering import Renderer


@pytest.fixture(scope="module")
def cell_and_shot(tmp_path_factory):
    """Return a cell whose scanner takes two exposures, and a scene of it."""
    folder = tmp_path_factory.mktemp("cell")
    path = write_cell(folder, render={"samples": 4, "denoise": False})
    rig = yaml.safe_load((folder / "rig.yaml").read_text())
    rig["exposure"] = {"exposure_s": 0.02, "factors": [0.1, 2.0, 0.4]}
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    cell = resolve_cell(load_config(path), folder)
    with open_cell_renderer(cell, device="cpu") as renderer:
        return cell, make_scene(cell, 3, seed=5, renderer=renderer)


def test_the_manifest_states_the_exposure_of_the_grey_picture(cell_and_shot):
    _, shot = cell_and_shot
    assert shot.sample.manifest["exposure_s"] == pytest.approx(0.02, rel=1e-6)
    assert set(np.unique(shot.capture.exposure_s)) <= set(np.float32([0.002, 0.008, 0.04]))
    assert shot.capture.exposure_s.max() > 0.03


def test_noise_and_colour_picture_use_their_own_seeds_from_the_manifest(cell_and_shot):
    """Otherwise a change in one would change the other, and a manifest would have a wrong seed."""
    cell, shot = cell_and_shot
    seeds = shot.sample.manifest["seeds"]
    assert len(set(seeds.values())) == len(seeds) == 5
    again = take(cell.scanner, shot.rendering.radiance, seed=seeds["noise"])
    assert np.array_equal(again.frames, shot.capture.frames)
    picture = color_picture(cell.scanner, shot.rendering, denoiser=None, seed=seeds["picture"])
    assert np.array_equal(picture, shot.sample.rgb)


@pytest.mark.parametrize(("fill", "count"), [(0.5, 17), (1.0, 35), (0.001, 1)])
def test_the_number_of_parts_fills_the_configured_share_of_the_bin(tmp_path, fill, count):
    """Boxes of 60 x 40 x 30 mm are in a bin of 250 x 200 x 100 mm, full at half of its volume."""
    cell = load_cell(write_cell(tmp_path, "count", fill=fill))
    assert counts_of(cell, 0, np.random.default_rng(0)) == (count,)
    assert count == max(1, round(fill * 0.5 * (0.25 * 0.2 * 0.1) / (0.06 * 0.04 * 0.03)))


def test_mixed_kinds_of_parts_together_fill_the_configured_share_of_the_bin(tmp_path):
    """A box and one twice as high have a mean of one and a half boxes."""
    trimesh.creation.box((60, 40, 60)).export(tmp_path / "high.stl")
    parts = [{"mesh": name, "unit": "mm"} for name in ("box.stl", "high.stl")]
    cell = load_cell(write_cell(tmp_path, "count", fill=1.0, mix=True, parts=parts))
    assert sum(counts_of(cell, 0, np.random.default_rng(0))) == round(34.72 / 1.5)


def test_decoding_the_saved_pictures_gives_the_saved_reasons(cell_and_shot):
    """Only the decoder gives reasons; the truth, which a real scanner lacks, is not used."""
    cell, shot = cell_and_shot
    noise = shot.rendering.radiance.path_noise
    _, depth = measure(cell.scanner, shot.capture, path_noise=noise)
    stored = shot.sample.scanner_depth
    np.testing.assert_array_equal(depth.reason, stored.reason)
    np.testing.assert_array_equal(depth.depth_m, stored.depth_m)


def test_the_shares_in_a_manifest_agree_with_the_map_of_reasons(cell_and_shot):
    _, shot = cell_and_shot
    reason, on_part = shot.sample.scanner_depth.reason, shot.rendering.truth.instance >= 0
    assert on_part.any()
    for key, within in (("reasons", np.ones_like(on_part)), ("part_reasons", on_part)):
        for name, share in shot.sample.manifest[key].items():
            assert share == pytest.approx((reason[within] == Reason[name.upper()]).mean())


class Playback(Renderer):
    """A renderer that returns the pictures of another one."""

    name, versions, device, denoiser = "held", {}, "cpu", "oidn"

    def __init__(self, rendering):
        self.rendering = rendering

    def render(self, scene, layout, pattern, *, quality, seed):
        return self.rendering


@pytest.mark.parametrize(
    ("words", "denoiser"),
    [
        ({"denoise": False}, None),
        ({"denoise": True}, "oidn"),
        ({"denoise": True, "backend": "cycles", "cycles": {"denoise": "none"}}, "oidn"),
        ({"denoise": True, "backend": "cycles", "cycles": {"denoise": "oidn"}}, None),
    ],
)
def test_a_colour_picture_is_denoised_only_once(cell_and_shot, monkeypatch, words, denoiser):
    """A renderer that denoises every picture has denoised this one already."""
    cell, shot = cell_and_shot
    render = RenderSection.model_validate(words)
    cell = replace(cell, config=cell.config.model_copy(update={"render": render}))
    used = []

    def picture(scanner, rendering, *, denoiser, seed):
        used.append(denoiser)
        return shot.sample.rgb

    monkeypatch.setattr(simulate, "color_picture", picture)
    make_scene(cell, 3, seed=5, renderer=Playback(shot.rendering))
    assert used == [denoiser]


COMPILED = """
import os, sys
from pathlib import Path
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.config import load_config
from graycast.cell.simulate import compile_kernels, make_scene

path = Path(sys.argv[1])
cell = resolve_cell(load_config(path), path.parent)
kernels = lambda: {file.name for file in Path(os.environ["NUMBA_CACHE_DIR"]).rglob("*.nbc")}
compile_kernels(cell)
before = kernels()
with open_cell_renderer(cell, device="cpu") as renderer:
    make_scene(cell, 0, seed=0, renderer=renderer)
print(len(before), *sorted(kernels() - before))
"""


@pytest.mark.slow
def test_every_kernel_of_a_scene_is_compiled_before_the_workers_start(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    command = [sys.executable, "-c", COMPILED, str(write_cell(tmp_path))]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    before, *later = ended.stdout.split()
    assert int(before) > 10
    assert later == []
