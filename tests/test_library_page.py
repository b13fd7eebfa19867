"""The Python code on `docs/how-to/python.md` runs unchanged."""

import re
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest
from pictured import write_dataset
from small_cell import content, write_cell

import graycast
from graycast.cell.generate import generate

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs/how-to/python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_the_first_lines_on_the_page_make_and_save_a_scene(tmp_path, monkeypatch, mitsuba_renderer):
    """With a small cell instead of the demo, the code makes the same scene as `generate`."""
    assert len([line for line in BLOCKS[0].splitlines() if line.strip()]) < 10
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").mkdir()
    write_cell(tmp_path / "configs").rename("configs/demo.yaml")
    names = {}
    exec(compile(BLOCKS[0], "docs/how-to/python.md", "exec"), names)
    scene = names["scene"]
    decoded = scene.depth.reason == graycast.Reason.DECODED
    assert abs(names["cloud"][:, 2] - scene.truth.depth_m[decoded]).mean() < 0.01
    generate(names["cell"], Path("run"), scenes=1, seed=1, device="cpu")
    assert content(Path("out/library")) == content(Path("run"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools'
def test_the_code_blocks_of_the_page_run_in_order(tmp_path, monkeypatch, capsys):
    """The blocks use the demo's files, and later blocks use names of earlier blocks."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    assert len(BLOCKS) == 6
    names = {}
    for block in BLOCKS:
        exec(compile(block, "docs/how-to/python.md", "exec"), names)
    assert sorted(path.name for path in Path("out/many/train").iterdir()) == ["000000", "000001"]
    assert capsys.readouterr().out.count("missing") == 2


def test_the_page_names_every_example_and_only_existing_names():
    examples = set(re.findall(r"`examples/(\w+\.py)`", PAGE))
    assert examples == {file.name for file in (ROOT / "examples").glob("*.py")}
    for name in set(re.findall(r"`graycast\.([a-zA-Z_.]+)`", PAGE)):
        module = graycast._MODULE.get(name.split(".")[0], "")
        if module.startswith("learn") and find_spec("torch") is None:
            continue  # The training of detectors needs PyTorch, which is optional.
        value = graycast
        for word in name.split("."):
            value = getattr(value, word)


ELSEWHERE = (ROOT / "docs/how-to/elsewhere.md").read_text(encoding="utf-8")
OTHERS = re.findall(r"^```python\n(.*?)^```$", ELSEWHERE, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Warnings of other libraries do not count.
@pytest.mark.parametrize("library", ["open3d", "trimesh", "torch", "supervision"])
def test_another_library_accepts_the_returned_values(tmp_path, monkeypatch, library):
    """A block of the page runs if its library is installed."""
    pytest.importorskip(
        library, reason=f"needs {library}: run pip install {library}", exc_type=ImportError
    )
    monkeypatch.chdir(tmp_path)
    write_dataset(tmp_path / "out/demo")
    first, block = OTHERS[0], next(code for code in OTHERS if f"import {library}" in code)
    assert len(block.splitlines()) <= 10
    names = {}
    exec(compile(first + block, "docs/how-to/elsewhere.md", "exec"), names)
    assert len(names["cloud"]) > 1000
    if library == "supervision":
        assert (names["picture"] != names["example"].rgb).any()
    if library == "torch":
        assert len(names["targets"]) == len(names["batch"]) == len(names["images"])
