"""Writing of fitted values into a configuration whose other text does not change."""

import errno

import numpy as np
import pytest
import yaml
from PIL import Image

from graycast.base.errors import ConfigError, GraycastError
from graycast.base.frames import axis_rotation, rigid
from graycast.cell.config import Config, load_config
from graycast.cell.resolve import resolve_cell
from graycast.real.fit_bin import summary, write_fit
from graycast.real.fit_bin.box import open_box
from graycast.real.fit_bin.fitting import BinFit, sections
from graycast.real.fit_bin.look import BinAppearance
from graycast.real.fit_bin.pose_fit import settle
from graycast.real.fitted_config import fitted_text, refuse_existing

from .empty_bins import BOX, perfect_depth, pose, view, without

BASE = """\
# our cell
parts:
  - builtin: toothpaste  # the small one
count: 3
view: {tilt_deg: 10}
# the crate from the store
bin:
  inner_m: [0.3, 0.2, 0.1]
  friction: 0.7

# how much
scenes: 5
"""
T = rigid(axis_rotation("x", 3.0), np.array([0.01, 0.02, 0.9]))
VIEW = {"T_world_cam": [round(float(v), 9) for v in T.ravel()]}


def test_fitted_sections_replace_only_the_same_sections(tmp_path):
    path = tmp_path / "cell.yaml"
    sections = {"view": VIEW, "table": {"base_color": [0.1, 0.2, 0.3]}}
    text = fitted_text(BASE, path, sections, {"view": "from a fit\nof two lines"})
    path.write_text(text)
    config = load_config(path)
    assert np.reshape(config.view.T_world_cam, (4, 4)) == pytest.approx(T, abs=1e-9)
    assert config.table.base_color == (0.1, 0.2, 0.3)
    assert yaml.safe_load(text) == yaml.safe_load(BASE) | sections
    rest = [line for line in BASE.splitlines() if not line.startswith("view")]
    assert [line for line in text.splitlines() if line in rest] == rest
    assert "# from a fit\n# of two lines\nview:" in text


def test_a_configuration_in_braces_is_rewritten_on_separate_lines(tmp_path):
    base = "{parts: [{builtin: toothpaste}], count: 4}"
    text = fitted_text(base, tmp_path / "c.yaml", {"view": VIEW}, {})
    assert yaml.safe_load(text) == yaml.safe_load(base) | {"view": VIEW}


def test_an_invalid_result_is_not_written(tmp_path):
    with pytest.raises(ConfigError, match="T_world_cam"):
        fitted_text(BASE, tmp_path / "c.yaml", {"view": {"T_world_cam": [1.0, 2.0]}}, {})


def test_existing_files_and_folders_that_break_relative_paths_are_refused(tmp_path):
    base = tmp_path / "cell.yaml"
    base.write_text(BASE)
    refuse_existing(tmp_path / "new.yaml", base)
    with pytest.raises(GraycastError, match="exists already"):
        refuse_existing(base, base)
    with pytest.raises(GraycastError, match="where its relative paths start"):
        refuse_existing(tmp_path / "sub" / "new.yaml", base)


def test_an_undetermined_pose_is_not_written(tmp_path):
    """Two walls have no depth, and the ends of the floor between them are missing, too."""
    T = pose(tilt_deg=0.0, aside_m=(0.0, 0.0), azimuth_deg=0.0, roll_deg=0.0)
    lost = lambda p: (np.abs(p[..., 0]) > 0.15) | (p[..., 2] < -0.004)  # noqa: E731
    scans = [view(without(perfect_depth(T), T, lost))]
    box = open_box(BOX.inner_m)
    fit = BinFit(views=("a",), shape=box, pose=settle(scans, box, T), apart=())
    assert fit.pose.loose == ("x",)
    assert any("NOT DETERMINED by the views: x" in line for line in summary(fit))
    base = tmp_path / "cell.yaml"
    base.write_text(BASE)
    config = load_config(base)
    with pytest.raises(GraycastError, match="no wall or edge determines x of the bin"):
        write_fit(fit, resolve_cell(config, tmp_path), scans, base, tmp_path / "new.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["cell.yaml"]


@pytest.mark.slow
def test_a_full_disk_leaves_no_partial_file(tmp_path, monkeypatch):
    T = pose()
    scans = [view(perfect_depth(T))]
    box = open_box(BOX.inner_m)
    fit = BinFit(views=("a",), shape=box, pose=settle(scans, box, T), apart=())
    base = tmp_path / "cell.yaml"
    base.write_text(BASE)

    def full(pose, shape, views, path):
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("graycast.real.fit_bin.fitting.draw_residuals", full)
    cell = resolve_cell(load_config(base), tmp_path)
    with pytest.raises(GraycastError, match="No space left on device"):
        write_fit(fit, cell, scans, base, tmp_path / "new.yaml")
    assert [path.name for path in tmp_path.iterdir()] == ["cell.yaml"]


@pytest.mark.slow
def test_a_file_that_appeared_meanwhile_is_not_overwritten(tmp_path, monkeypatch):
    T = pose()
    scans = [view(perfect_depth(T))]
    box = open_box(BOX.inner_m)
    fit = BinFit(views=("a",), shape=box, pose=settle(scans, box, T), apart=())
    base = tmp_path / "cell.yaml"
    base.write_text(BASE)

    def slowly(pose, shape, views, path):
        path.write_bytes(b"picture")
        (tmp_path / "new.yaml").write_text("of another run")

    monkeypatch.setattr("graycast.real.fit_bin.fitting.draw_residuals", slowly)
    cell = resolve_cell(load_config(base), tmp_path)
    with pytest.raises(GraycastError, match="exists already"):
        write_fit(fit, cell, scans, base, tmp_path / "new.yaml")
    assert (tmp_path / "new.yaml").read_text() == "of another run"
    assert {path.name for path in tmp_path.iterdir()} == {"cell.yaml", "new.yaml"}


# --- the written keys --------------------------------------------------------------------------


def cell(**changes):
    return Config.model_validate({"parts": [{"builtin": "toothpaste"}]} | changes)


def test_an_exact_pose_is_the_pose_of_the_camera(tmp_path):
    scene = resolve_cell(
        cell(view=VIEW, bin={"material": {"base_color": [0.5, 0.4, 0.3]}}), tmp_path
    ).scene
    assert np.array_equal(scene.T_world_cam.ravel(), VIEW["T_world_cam"])


def test_an_exact_pose_excludes_other_keys_of_the_view():
    with pytest.raises(ValueError, match="T_world_cam is the whole pose: remove it, or tilt_deg"):
        cell(view=VIEW | {"tilt_deg": 3.0})
    with pytest.raises(ValueError, match="16"):
        cell(view={"T_world_cam": [1.0] * 15})
    with pytest.raises(ValueError, match="not a rotation"):
        cell(view={"T_world_cam": [2.0, *VIEW["T_world_cam"][1:]]})


def test_a_configuration_with_a_pose_can_be_read_back_from_a_manifest():
    config = cell(view=VIEW)
    assert Config.model_validate(config.model_dump(mode="json")) == config


def test_a_surface_of_another_colour_keeps_its_roughness_map(tmp_path):
    """Walls, floor and table have different maps; a floor without a section has the walls' map."""
    T, box = pose(), open_box(BOX.inner_m)
    color = dict.fromkeys(("walls", "floor", "table"), (0.1, 0.2, 0.3))
    look = BinAppearance(reflectance=color, pixels={}, off=0.0, light_scale=None, exposure=1.0)
    fit = BinFit(
        views=("a",), shape=box, pose=settle([view(perfect_depth(T))], box, T), apart=(), look=look
    )
    for name in "abc":
        Image.fromarray(np.zeros((2, 2), dtype=np.uint8)).save(tmp_path / f"{name}.png")
    walls, floor, table = ({"roughness_map": f"{name}.png"} for name in "abc")
    for own, of_floor in (({"floor": floor}, "b.png"), ({}, "a.png")):
        config = cell(bin={"material": walls} | own, table=table)
        settings = sections(fit, resolve_cell(config, tmp_path))
        box_words = settings["bin"]
        assert box_words["material"]["roughness_map"] == "a.png"
        assert box_words["floor"]["roughness_map"] == of_floor
        assert settings["table"]["roughness_map"] == "c.png"


def test_a_surface_of_another_colour_keeps_its_grooves(tmp_path):
    T, box = pose(), open_box(BOX.inner_m)
    color = {"walls": (0.1, 0.2, 0.3), "floor": (0.1, 0.2, 0.3)}
    look = BinAppearance(reflectance=color, pixels={}, off=0.0, light_scale=None, exposure=1.0)
    fit = BinFit(
        views=("a",), shape=box, pose=settle([view(perfect_depth(T))], box, T), apart=(), look=look
    )
    config = cell(bin={"material": "steel-brushed"})
    words = sections(fit, resolve_cell(config, tmp_path))["bin"]["material"]
    assert words["base_color"] == [0.1, 0.2, 0.3]
    assert (words["anisotropy"], words["grain"]) == (0.8, [1.0, 0.0, 0.0])


def test_floor_and_table_can_have_different_materials(tmp_path):
    walls, floor, table = ({"base_color": [c, c, c], "specular": 0.0} for c in (0.1, 0.2, 0.3))
    scene = resolve_cell(cell(bin={"material": walls, "floor": floor}, table=table), tmp_path).scene
    assert scene.bin.material.base_color == (0.1, 0.1, 0.1)
    assert scene.bin.floor.base_color == (0.2, 0.2, 0.2)
    assert scene.table.base_color == (0.3, 0.3, 0.3)
    assert resolve_cell(cell(bin={"material": walls}), tmp_path).scene.bin.floor is None
