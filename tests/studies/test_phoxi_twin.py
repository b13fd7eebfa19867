"""The study of five real scans stops with one line if data is missing, and can run twice."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from graycast.dataset.training import open_examples

# The array type of pycocotools 2.0.11 is older than NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

ROOT = Path(__file__).resolve().parents[2]


def run_twin(root: Path, out: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-W", "ignore", "-m", "studies.phoxi_twin", "--out", str(out)]
    return subprocess.run(command, cwd=root, capture_output=True, text=True)


@pytest.mark.slow
def test_the_study_stops_with_one_line_if_the_scans_are_missing(tmp_path):
    """A clone of the repository has no data folder next to it."""
    root = tmp_path / "stranger" / "repository"
    for folder in ("studies", "benchmarks"):
        shutil.copytree(ROOT / folder, root / folder)
    ended = run_twin(root, tmp_path / "out")
    assert ended.returncode == 1
    (line,) = ended.stderr.strip().splitlines()
    assert "shared/data/phoxi/bin.obj is missing: put the scans" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_study_can_run_twice(shared, tmp_path):
    for _ in range(2):
        ended = run_twin(ROOT, tmp_path / "twin")
        assert ended.returncode == 0, ended.stderr
        assert len(open_examples(tmp_path / "twin" / "real")) == 5
