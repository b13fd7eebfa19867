"""The commands that print figures: their options, their JSON, and their plots."""

import json
import subprocess
import sys

import pytest

from benchmarks import __main__ as program
from benchmarks import agree, plots, poses


def test_options_are_the_arguments_of_measure_and_figures_become_json(
    capsys, monkeypatch, tmp_path
):
    requests = []

    def measure(*, show, **words):
        requests.append(words)
        return {"share": 0.125, "rows": [{"samples": 4, "off": 1.5}, {"samples": 16, "off": 0.25}]}

    monkeypatch.setattr(poses, "measure", measure)
    file = tmp_path / "figures.json"
    words = ["poses", "one", "two", "--instances", "7", "--json", str(file)]
    assert program.main(words) == 0
    assert {"instances": 7, "detector": None, "out": None}.items() <= requests[0].items()
    assert list(map(str, requests[0]["datasets"])) == ["one", "two"]
    figures = json.loads(file.read_text())
    assert figures["benchmark"] == "poses" and figures["share"] == 0.125
    assert figures["peak_rss_bytes"] > 10e6 and figures["cores"] >= 1
    printed = capsys.readouterr().out
    table = printed[printed.index("rows:") :].splitlines()[1:4]
    assert [line.split() for line in table] == [["samples", "off"], ["4", "1.5"], ["16", "0.25"]]


def test_a_plot_is_drawn_from_the_figures(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(agree, "measure", lambda *, samples, show: {"samples": samples})
    monkeypatch.setattr(plots, "draw", lambda figures, path: calls.append((figures, path)))
    assert program.main(["agree", "--plot", str(tmp_path / "a.png")]) == 0
    assert calls[0][0]["samples"] == 64 and calls[0][1] == tmp_path / "a.png"


@pytest.mark.parametrize("name", program.FIGURES)
def test_every_command_has_its_module_and_page(capsys, name):
    with pytest.raises(SystemExit) as ended:
        program.main([name, "--help"])
    assert ended.value.code == 0
    assert "docs/" in capsys.readouterr().out
    assert (program.ROOT / "benchmarks" / f"{name}.py").is_file()


def test_the_command_line_loads_without_numpy():
    """`compare` can run without packages, and would start much later if it imported NumPy."""
    code = "import sys; from benchmarks import __main__; print('numpy' in sys.modules)"
    words = [sys.executable, "-c", code]
    run = subprocess.run(words, cwd=program.ROOT, capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"
