"""The twin's own command: without its data it stops in one line, and it may be said twice."""

import subprocess
import sys
from pathlib import Path

import pytest

from graycast.dataset.training import open_examples

# pycocotools 2.0.11 has an array type from before NumPy 2, which NumPy asks it to mend.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

TESTS = Path(__file__).resolve().parents[2]


def said(tests: Path, out: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-W", "ignore", "-m", "learn.detect.phoxi_twin", "--out", str(out)]
    return subprocess.run(command, cwd=tests, capture_output=True, text=True)


@pytest.mark.slow
def test_without_the_scans_it_stops_in_one_line(tmp_path):
    """As a stranger has it: the repository with nothing beside it."""
    folder = tmp_path / "stranger" / "repository" / "tests" / "detect"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "phoxi_twin.py", "printed_cartons.py", "random_shapes.py"):
        (folder / name).write_bytes((TESTS / "detect" / name).read_bytes())
    ended = said(folder.parent, tmp_path / "out")
    assert ended.returncode == 1
    (line,) = ended.stderr.strip().splitlines()
    assert "shared/data/phoxi/bin.obj is missing: put the scans" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_it_may_be_said_twice(shared, tmp_path):
    for _ in range(2):
        ended = said(TESTS, tmp_path / "twin")
        assert ended.returncode == 0, ended.stderr
        assert len(open_examples(tmp_path / "twin" / "real")) == 5
