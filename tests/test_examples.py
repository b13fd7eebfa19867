"""Each example runs as its first lines say, and stays short enough to read."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ARGUMENTS = {"01_make_a_mesh.py": ["plate.stl"], "02_one_scene.py": ["1"]}
ARGUMENTS["03_codes_in_a_bowl.py"] = ["codes.png", "2"]


def test_every_example_is_tested_and_under_80_lines():
    files = sorted(EXAMPLES.glob("*.py"))
    assert [file.name for file in files] == sorted(ARGUMENTS)
    assert all(len(file.read_text().splitlines()) < 80 for file in files)


@pytest.mark.slow
@pytest.mark.parametrize("name", ARGUMENTS)
def test_an_example_runs(name, tmp_path):
    command = [sys.executable, EXAMPLES / name, *ARGUMENTS[name]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    if name == "01_make_a_mesh.py":
        assert (tmp_path / "plate.stl").read_bytes() == (EXAMPLES / "data/plate.stl").read_bytes()
    elif name == "02_one_scene.py":
        assert "decoded" in done.stdout
    else:
        assert "xor_gray" in done.stdout
        assert (tmp_path / "codes.png").stat().st_size > 10_000
