"""The Python on `docs/how-to/python.md` runs as it stands there."""

import re
import shutil
from pathlib import Path

import pytest
from small_cell import content, write_cell

import graycast
from graycast.cell.generate import generate

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/how-to/python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


def test_ten_lines_make_decode_and_save_a_scene(tmp_path, monkeypatch, mitsuba_renderer):
    """On a small cell in the place of the demo: the scene that `generate` makes."""
    lines = [line for line in BLOCKS[0].splitlines() if line.strip()]
    assert len(lines) == 10
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").mkdir()
    write_cell(tmp_path / "configs").rename("configs/demo.yaml")
    names = {}
    exec(compile(BLOCKS[0], "docs/how-to/python.md", "exec"), names)
    decoded = names["depth"].depth_m[names["depth"].reason == graycast.Reason.DECODED]
    truth_m = names["shot"].rendering.truth.depth_m
    assert abs(decoded - truth_m[names["depth"].reason == 0]).mean() < 0.01
    generate(names["cell"], Path("run"), scenes=1, seed=1, device="cpu")
    assert content(Path("out/library")) == content(Path("run"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools'
def test_every_block_of_the_page_runs_in_its_order(tmp_path, monkeypatch, capsys):
    """On the demo's own files; later blocks use the names of earlier ones."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    assert len(BLOCKS) == 5
    names = {}
    for block in BLOCKS:
        exec(compile(block, "docs/how-to/python.md", "exec"), names)
    assert sorted(path.name for path in Path("out/many/train").iterdir()) == ["000000", "000001"]
    assert capsys.readouterr().out.count("missing") == 2


def test_the_page_names_every_example_and_each_name_is_there():
    told = set(re.findall(r"`examples/(\w+\.py)`", PAGE))
    assert told == {file.name for file in (ROOT / "examples").glob("*.py")}
    for name in set(re.findall(r"`graycast\.([a-zA-Z_.]+)`", PAGE)):
        value = graycast
        for word in name.split("."):
            value = getattr(value, word)
