"""One scene all the way: what its manifest says of it is what was done."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from small_cell import write_cell

from graycast import simulate
from graycast.cell import open_cell_renderer, resolve_cell
from graycast.config import RenderSection, load_config
from graycast.picture import color_picture
from graycast.render import Renderer
from graycast.scanner import take
from graycast.simulate import make_scene


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A cell whose scanner takes two exposures, and a scene of it."""
    folder = tmp_path_factory.mktemp("cell")
    path = write_cell(folder, render={"samples": 4, "denoise": False})
    rig = yaml.safe_load((folder / "rig.yaml").read_text())
    rig["exposure"] = {"exposure_s": 0.02, "factors": [0.1, 1.0, 0.4]}
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    cell = resolve_cell(load_config(path), folder)
    with open_cell_renderer(cell, device="cpu") as renderer:
        return cell, make_scene(cell, 3, seed=5, renderer=renderer)


def test_the_manifest_s_exposure_is_the_longest_of_those_taken(made):
    _, shot = made
    assert shot.sample.manifest["exposure_s"] == pytest.approx(0.02, rel=1e-6)
    assert set(np.unique(shot.capture.exposure_s)) <= set(np.float32([0.002, 0.008, 0.02]))


def test_noise_and_colour_picture_come_from_the_seeds_that_bear_their_names(made):
    """Else a change in one would change the other, and a manifest would tell the wrong seed."""
    cell, shot = made
    seeds = shot.sample.manifest["seeds"]
    assert len(set(seeds.values())) == len(seeds) == 5
    again = take(cell.scanner, shot.rendering.radiance, seed=seeds["noise"])
    assert np.array_equal(again.frames, shot.capture.frames)
    picture = color_picture(cell.scanner, shot.rendering, denoiser=None, seed=seeds["picture"])
    assert np.array_equal(picture, shot.sample.rgb)


class Held(Renderer):
    """Shows what another renderer has made."""

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
def test_a_colour_picture_is_denoised_once(made, monkeypatch, words, denoiser):
    """A back end that cleans every picture has cleaned this one already."""
    cell, shot = made
    render = RenderSection.model_validate(words)
    cell = replace(cell, config=cell.config.model_copy(update={"render": render}))
    used = []

    def picture(scanner, rendering, *, denoiser, seed):
        used.append(denoiser)
        return shot.sample.rgb

    monkeypatch.setattr(simulate, "color_picture", picture)
    make_scene(cell, 3, seed=5, renderer=Held(shot.rendering))
    assert used == [denoiser]


COMPILED = """
import os, sys
from pathlib import Path
from graycast.cell import open_cell_renderer, resolve_cell
from graycast.config import load_config
from graycast.simulate import compile_kernels, make_scene

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
def test_a_scene_compiles_nothing_that_was_not_compiled_before_the_workers_started(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    command = [sys.executable, "-c", COMPILED, str(write_cell(tmp_path))]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    before, *later = ended.stdout.split()
    assert int(before) > 10
    assert later == []
