"""Each example runs as its first lines say, and stays short enough to read."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn import shares_of

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ARGUMENTS = {"01_make_a_mesh.py": ["plate.stl"], "02_one_scene.py": ["1"]}
ARGUMENTS["03_codes_in_a_bowl.py"] = ["codes.png", "2"]


def test_every_example_is_tested_and_under_80_lines():
    files = sorted(EXAMPLES.glob("*.py"))
    assert [file.name for file in files] == sorted(ARGUMENTS)
    assert all(len(file.read_text().splitlines()) < 80 for file in files)


def shown_medians_mm(path):
    """Of each large picture on a sheet, row by row: the median error that its colours stand for.

    Red and blue are errors of 5 mm, and white is none.
    """
    picture = cv2.imread(str(path))[..., ::-1]
    inked = (picture < 255).any(axis=-1).astype(np.uint8)
    inked = cv2.morphologyEx(inked, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    count, label, box, _ = cv2.connectedComponentsWithStats(inked)
    large = [k for k in range(1, count) if box[k, cv2.CC_STAT_AREA] > 0.05 * inked.size]
    large.sort(key=lambda k: (box[k, cv2.CC_STAT_TOP] // 50, box[k, cv2.CC_STAT_LEFT]))
    share = [shares_of(picture[label == k] / 255, "RdBu_r", within=0.02) for k in large]
    return [float(np.nanmedian(np.abs(10 * of - 5))) for of in share]


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
        told_mm = [float(line.split()[-2]) for line in done.stdout.splitlines()[1:]]
        shown_mm = shown_medians_mm(tmp_path / "codes.png")
        # The sheet is smaller than the pictures: means of up to four pixels err less than one.
        for shown, told in zip(shown_mm, told_mm, strict=True):
            assert told / 2 < shown < told + 10 / 255
