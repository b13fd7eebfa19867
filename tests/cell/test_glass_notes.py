"""Solid glass is rendered too dark, so each command that reads such a cell prints a note."""

import pytest
import trimesh

from graycast.cell.resolve import load_cell
from graycast.cli.command import main


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "notes"), [("glass-clear", 1), ("pmma-clear", 1), ("plastic", 0)]
)
def test_a_part_of_solid_glass_causes_a_note(tmp_path, monkeypatch, capsys, surface, notes):
    """Symptom: the light behind a plate of glass-clear is 0.10 instead of 0.84, without a note."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.08, 0.08, 0.005)).export("slab.stl")
    assert main(["new", "cell", "--part", "slab.stl", "--unit", "m", "--surface", surface]) == 0
    assert capsys.readouterr().out.count("slab is solid glass") == notes
    cell = load_cell(tmp_path / "cell/cell.yaml")
    assert sum("slab is solid glass" in note for note in cell.notes) == notes
    assert all("transparent: thin" in note for note in cell.notes)
