"""A cell with a code and a sensor that its configuration does not name."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_cell import write_cell

import graycast as gc
from graycast.cell.generate import generate, save_scene
from graycast.cell.simulate import make_scene, own_record


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return gc.load_cell(write_cell(tmp_path_factory.mktemp("cell")))


def listed(cell, **change):
    """Return a code of the library as a list of frames, to compare it with the named code."""
    projector = cell.scanner.rig.projector
    spec = gc.CodeSpec(codec="gray", axes=("column",), inverses=True)
    return spec, replace(spec.code(projector.width_px, projector.height_px), **change)


@pytest.mark.slow
def test_a_code_given_as_frames_measures_like_the_named_code(cell, mitsuba_renderer):
    spec, code = listed(cell)
    named = replace(cell, scanner=replace(cell.scanner, code=spec))
    own = cell.with_own(code=code)
    a, b = (make_scene(one, 0, seed=3, renderer=mitsuba_renderer) for one in (named, own))
    assert own.code.frames == named.code.frames != cell.code.frames
    np.testing.assert_array_equal(a.sample.scanner_depth.depth_m, b.sample.scanner_depth.depth_m)
    assert "own" not in a.sample.manifest
    assert b.sample.manifest["own"]["code"]["frames"][2]["bit"] == 6  # after white and black


@pytest.mark.slow
def test_a_dataset_records_its_own_code_and_is_not_continued_without_this_code(
    cell, tmp_path, mitsuba_renderer
):
    sensor = replace(cell.scanner.sensor, read_noise_e=40.0)
    own = cell.with_own(code=listed(cell)[1]).with_own(sensor=sensor)
    shot = make_scene(own, 0, seed=3, renderer=mitsuba_renderer)
    plain = make_scene(cell, 0, seed=3, renderer=mitsuba_renderer)
    for wrong_cell, wrong_shot in ((cell, shot), (own, plain)):
        with pytest.raises(ValueError, match="another configuration than this cell's"):
            save_scene(wrong_cell, wrong_shot, tmp_path / "wrong")
    folder = save_scene(own, shot, tmp_path / "own")
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["own"] == own_record(own) and set(manifest["own"]) == {"code", "sensor"}
    assert manifest["own"]["sensor"]["read_noise_e"] == 40.0
    claim = json.loads((tmp_path / "own/graycast.json").read_text())
    assert claim["config"]["scanner"]["code"] == manifest["own"]["code"]
    assert not gc.validate(tmp_path / "own")
    with pytest.raises(gc.GraycastError, match="scanner"):
        generate(cell, tmp_path / "own", scenes=2, seed=3, device="cpu")


def test_a_given_code_that_does_not_fit_the_cell_is_refused(cell, tmp_path):
    with pytest.raises(ValueError, match=r"made for 64 x 96 px, and the projector has 128 x 96"):
        cell.with_own(code=listed(cell, width_px=64)[1])
    rows = gc.CodeSpec(codec="gray", axes=("row",)).code(128, 96)
    with pytest.raises(gc.GraycastError, match="code has no column frames: rig small needs them"):
        cell.with_own(code=rows)
    with pytest.raises(gc.GraycastError, match="a list of frames: give a code that has a name"):
        gc.save_scanner(cell.with_own(code=listed(cell)[1]).scanner, tmp_path / "rig.yaml")
