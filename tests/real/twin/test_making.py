"""The command `real twin` on scans of a simulated scanner: files, output, reproducibility."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from small_cell import write_cell

from graycast.camera.picture import color_picture
from graycast.camera.rig_file import load_scanner, save_scanner
from graycast.camera.scanner import scan
from graycast.cell.config import load_config
from graycast.cell.resolve import resolve_cell
from graycast.cell.simulate import cell_seeds, varied
from graycast.cli import main
from graycast.real.twin import making, searching
from graycast.real.twin.parameters import OF_BIN, PARAMETERS
from graycast.rendering import Quality
from graycast.rig.pattern import CodeSpec
from graycast.world.drop import drop

SCANS = 5


@pytest.fixture(scope="module")
def scanned(tmp_path_factory, mitsuba_renderer):
    """Return a cell, and five scans of its heaps with their colour pictures."""
    folder = tmp_path_factory.mktemp("cell")
    path = write_cell(folder, count=8)
    # With Gray code alone, errors would exceed the least height of objects above the bin.
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=16.0, steps=4)
    save_scanner(replace(load_scanner(folder / "rig.yaml"), code=code), folder / "rig.yaml")
    cell = resolve_cell(load_config(path), folder)
    for number in range(SCANS):
        seeds = cell_seeds(cell, number, seed=5)
        fall = varied(cell, number, seeds)
        layout = drop(fall.scene, fall.counts, seed=seeds["drop"], limits=cell.config.drop)
        rendering = mitsuba_renderer.render(
            fall.scene, layout, cell.patterns(), quality=Quality(samples=16, depth=3), seed=number
        )
        shot = scan(cell.scanner, rendering.radiance, seed=number)
        np.save(folder / f"depth_{number}.npy", shot.depth.depth_m)
        rgb = color_picture(cell.scanner, rendering, denoiser=None, seed=number)
        cv2.imwrite(str(folder / f"rgb_{number}.png"), rgb[..., ::-1])
    return folder, path


def twin(folder, path, out, *options):
    depth = [str(folder / f"depth_{k}.npy") for k in range(SCANS)]
    rgb = [str(folder / f"rgb_{k}.png") for k in range(SCANS)]
    words = [
        "real",
        "twin",
        *depth,
        "--rgb",
        *rgb,
        "--config",
        str(path),
        "--out",
        str(folder / out),
    ]
    return main([*words, "--trials", "2", *options])


@pytest.mark.slow
def test_the_command_writes_the_same_twin_in_every_run(scanned, monkeypatch, capsys):
    few = [p for p in PARAMETERS if p.key in (*OF_BIN, "sensor.read_noise_e")]
    monkeypatch.setattr(making, "PARAMETERS", few)
    monkeypatch.setattr(searching, "_STARTS", 0)
    folder, path = scanned
    for out in ("one.yaml", "two.yaml"):
        assert twin(folder, path, out, "--kept-aside", "2") == 0
    assert "statistics met: " in capsys.readouterr().out
    ends = (".yaml", ".rig.yaml", ".twin.md", ".twin.png")
    one, two = ([(folder / (n + end)).read_bytes() for end in ends] for n in ("one", "two"))
    assert one[1:] == two[1:]
    assert one[0].replace(b"one.rig", b"two.rig") == two[0]
    report = one[2].decode()
    assert "on the scenes of 3 real scans" in report and "### Kept aside" in report
    content = yaml.safe_load(one[0])
    assert content["rig"] == "one.rig.yaml"
    assert resolve_cell(load_config(folder / "one.yaml"), folder).scanner.rig.name == "small-twin"


@pytest.mark.slow
def test_too_few_scans_to_fit_or_to_test_are_refused(scanned, capsys):
    folder, path = scanned
    assert twin(folder, path, "few.yaml", "--kept-aside", "3") == 1
    assert "5 scans are given, 3 of them to keep aside: give at least 3 to fit" in errors(capsys)
    assert twin(folder, path, "few.yaml", "--kept-aside", "1") == 1
    assert "1 scan is kept aside: keep at least 2" in errors(capsys)
    assert not (folder / "few.yaml").exists()


def errors(capsys):
    return " ".join(capsys.readouterr().err.split())
