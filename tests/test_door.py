"""`import graycast` gives access to the whole pipeline, and loads a room only when it is used."""

import ast
import inspect
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from small_cell import content, write_cell

import graycast
from graycast.base.errors import DatasetError
from graycast.cell.generate import generate
from graycast.dataset.check.checking import validate

SOURCE = Path(graycast.__file__)


def test_importing_graycast_loads_only_the_version():
    """In a fresh process, all other new entries of `sys.modules` belong to Python itself."""
    code = (
        "import sys, typing, importlib; before = set(sys.modules); import graycast;"
        "new = {m for m in set(sys.modules) - before};"
        "print(sorted(m for m in new if m.split('.')[0] not in sys.stdlib_module_names))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['graycast', 'graycast.base', 'graycast.base.version']"


def test_every_public_name_is_the_object_of_its_own_package():
    """Python reads `_MODULE`, but type checkers read the imports, so both must agree."""
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    modules = {
        alias.asname: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for alias in node.names
        if alias.asname is not None
    }
    assert modules == graycast._MODULE
    assert {"__version__", *modules} == set(graycast.__all__) <= set(dir(graycast))
    for name, module in modules.items():
        room = import_module(f"graycast.{module}")
        assert name in room.__all__ if hasattr(room, "__path__") else hasattr(room, name)
        if module.startswith("learn") and find_spec("torch") is None:
            continue  # Training needs PyTorch, which is optional.
        assert inspect.unwrap(getattr(graycast, name)) is inspect.unwrap(getattr(room, name))


def test_no_public_name_is_also_a_package():
    """After a room is loaded, it would hide a function with the same name."""
    rooms = {path.stem for path in SOURCE.parent.iterdir()}
    assert not rooms & set(graycast.__all__)


def test_only_an_unknown_name_and_not_a_broken_package_is_an_attribute_error(monkeypatch):
    with pytest.raises(AttributeError, match="'graycast' has no attribute 'scene'"):
        _ = graycast.scene
    assert not hasattr(graycast, "__wrapped__")
    monkeypatch.delattr(graycast, "rendering")  # `delattr` first loads the room.
    monkeypatch.delitem(sys.modules, "graycast.rendering")
    monkeypatch.setitem(sys.modules, "graycast.rendering.radiance", None)  # The room needs this.
    with pytest.raises(ModuleNotFoundError, match="radiance"):
        _ = graycast.rendering


def test_dir_of_graycast_lists_only_its_public_names():
    assert {name for name in dir(graycast) if name[:2] != "__"} == {*graycast.__all__[1:]}


def test_a_shot_is_printed_as_one_line(cell_and_shot):
    assert re.fullmatch(
        r"Shot\(scene 0, \d+ parts, \d+ x \d+ px, \d+% of the parts' pixels decoded\)",
        str(cell_and_shot[1]),
    )


@pytest.mark.slow
def test_python_runs_the_package_as_a_module():
    command = [sys.executable, "-m", "graycast", "--version"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout == f"graycast {graycast.__version__}\n"


@pytest.fixture(scope="module")
def cell_and_shot(tmp_path_factory, mitsuba_renderer):
    """Return a small cell and one of its scenes, made without `generate`."""
    path = write_cell(tmp_path_factory.mktemp("cell"))
    cell = graycast.load_cell(path)
    return cell, graycast.make_scene(cell, 0, seed=5, renderer=mitsuba_renderer)


@pytest.mark.slow
def test_a_scene_saved_by_a_script_equals_the_scene_of_generate(cell_and_shot, tmp_path):
    """All bytes except the timings are equal, and `generate` can continue in the folder."""
    cell, shot = cell_and_shot
    saved = graycast.save_scene(cell, shot, tmp_path / "hand")
    assert saved == tmp_path / "hand/train/000000" and not validate(tmp_path / "hand")
    run = generate(cell, tmp_path / "hand", scenes=2, seed=5, device="cpu")
    assert (run.found, run.written) == (1, 1)
    generate(cell, tmp_path / "run", scenes=2, seed=5, device="cpu")
    assert content(tmp_path / "hand") == content(tmp_path / "run")


def test_a_scene_is_saved_only_once_and_only_with_its_own_cell(cell_and_shot, tmp_path):
    cell, shot = cell_and_shot
    graycast.save_scene(cell, shot, tmp_path / "out")
    before = content(tmp_path / "out")
    graycast.save_scene(cell, shot, tmp_path / "out")  # Saving the same scene again is allowed.
    assert content(tmp_path / "out") == before
    darker = replace(shot, sample=replace(shot.sample, rgb=shot.sample.rgb // 2))
    with pytest.raises(DatasetError, match=r"000000 exists already, and its rgb/000000.png "):
        graycast.save_scene(cell, darker, tmp_path / "out")
    other = write_cell(tmp_path, count=4)
    other = graycast.load_cell(other)
    with pytest.raises(ValueError, match="another configuration than this cell's"):
        graycast.save_scene(other, shot, tmp_path / "other")
    assert content(tmp_path / "out") == before and not (tmp_path / "other").exists()
