"""Each notebook in `examples/notebooks` runs, and is stored with the outputs of its run.

To run and store them: `.venv/bin/jupyter execute --inplace examples/notebooks/*.ipynb`.
"""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = ROOT / "examples/notebooks"
LARGEST_BYTES = 600_000


def figures(pattern, text):
    """Return the numbers of the only place that matches the pattern."""
    (place,) = re.finditer(pattern, text)
    return [float(number) for number in place.groups()]


def check_detector(text):
    """Check that a score is inside its interval, and that the detector finds some parts."""
    assert "errors of the dataset: 0" in text
    for name in ("AP", "AP50"):
        value, low, high = figures(rf"{name} +([\d.]+), interval ([\d.]+) to ([\d.]+)", text)
        assert 0 <= low <= value <= high <= 1
    assert value > 0.02


def check_depth(text):
    """Check that layouts are equal, that sigma fits the error, and that metal has less depth."""
    assert "same layout: True" in text
    assert figures(r"card: median error ([\d.]+) mm", text)[0] < 0.3
    least, largest = figures(r"over stated sigma: ([\d.]+) to ([\d.]+)", text)
    assert 0.5 < least < largest < 2
    card, metal = figures(r"decoded +([\d.]+)% +([\d.]+)%", text)
    assert metal < card / 2
    card, metal = figures(r"wrong by more than 1 mm +([\d.]+)% +([\d.]+)%", text)
    assert metal > card


def check_stack(text):
    """Check that a right stack gives no warning, and that the fault of a wrong stack is named."""
    assert "warnings: none" in text and "the steps run backwards" in text
    assert figures(r"median error ([\d.]+) mm", text)[0] < 0.3
    shares = re.findall(r"^[a-z ]+ ([\d.]+)%$", text, re.MULTILINE)
    assert len(shares) == 9 and sum(map(float, shares)) == pytest.approx(100, abs=0.5)


# The number of pictures in each notebook, and the check of its text.
EXPECTED = {
    "decode_a_stack": (3, check_stack),
    "own_part_to_detector": (2, check_detector),
    "what_a_scanner_does_to_depth": (3, check_depth),
}


def check(notebook, name):
    """Check that every cell ran once, in order and without an error, and made its pictures."""
    count, check_text = EXPECTED[name]
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert all(output["output_type"] != "error" for output in outputs)
    kinds = [" ".join(output.get("data", ())) for output in outputs]
    assert sum("image/" in kind for kind in kinds) == count
    check_text("".join("".join(output.get("text", "")) for output in outputs))


def test_every_notebook_is_small_and_stored_with_the_outputs_of_its_run():
    files = sorted(NOTEBOOKS.glob("*.ipynb"))
    assert [file.stem for file in files] == sorted(EXPECTED)
    for file in files:
        assert file.stat().st_size < LARGEST_BYTES
        check(json.loads(file.read_text(encoding="utf-8")), file.stem)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Jupyter's warnings do not count.
@pytest.mark.parametrize("name", EXPECTED)
def test_every_notebook_runs_without_errors(tmp_path, name):
    """A notebook runs next to a link to the examples' data, in a folder for its output."""
    nbclient = pytest.importorskip("nbclient", reason="needs nbclient: run make extras")
    pytest.importorskip("ipykernel", reason="needs ipykernel: run make extras")
    if name == "own_part_to_detector":
        pytest.importorskip("torch", reason="needs torch: run make extras")
    import nbformat

    (tmp_path / "notebooks").mkdir()
    (tmp_path / "data").symlink_to(ROOT / "examples/data")
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    place = {"metadata": {"path": str(tmp_path / "notebooks")}}
    nbclient.NotebookClient(notebook, timeout=1200, resources=place).execute()
    check(notebook, name)
