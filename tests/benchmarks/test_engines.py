"""The study of engines on small scenes: the engines that run, and the ratios of their times."""

import pytest
from small_cell import write_cell

from benchmarks import engines
from benchmarks.engines import _Contender, _figures
from graycast.cell.config import load_config
from graycast.cell.resolve import resolve_cell


def test_ratios_are_medians_of_ratios_within_rounds():
    seconds = {"bare": [1.0, 10.0, 4.0], "local_1": [1.1, 11.0, 8.0], "local_2": [0.5, 5.5, 4.0]}
    contenders = {name: _Contender(make=print, seconds=s) for name, s in seconds.items()}
    figures = _figures(contenders, 30, 6)
    assert figures["local_overhead"] == pytest.approx(0.1)
    assert figures["local_speedup"] == pytest.approx(2.0)
    assert figures["seconds"] == {"bare": 4.0, "local_1": 8.0, "local_2": 4.0}
    assert "ray_overhead" not in figures


@pytest.mark.slow
def test_every_available_engine_makes_the_scenes(tmp_path, monkeypatch):
    path = write_cell(tmp_path)
    cell = resolve_cell(load_config(path), tmp_path)
    monkeypatch.setattr(engines, "cell_of", lambda settings: cell)
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    figures = engines.measure(count=3, scenes=2, show=lambda text: None)
    assert set(figures["seconds"]) == {"bare", "local_1", "local_2"}
    assert figures["local_speedup"] > 0  # a busy machine may have any speedup
