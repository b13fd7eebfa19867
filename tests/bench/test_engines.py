"""The study of engines, on small scenes: who was measured, and how its ratios come about."""

import pytest
from small_cell import write_cell

from graycast.bench import engines
from graycast.bench.engines import _Contender, _figures
from graycast.cell import resolve_cell
from graycast.config import load_config


def test_ratios_are_medians_over_rounds_of_the_same_round():
    seconds = {"bare": [1.0, 10.0, 4.0], "local_1": [1.1, 11.0, 8.0], "local_2": [0.5, 5.5, 4.0]}
    contenders = {name: _Contender(make=print, seconds=s) for name, s in seconds.items()}
    figures = _figures(contenders, 30, 6)
    assert figures["local_overhead"] == pytest.approx(0.1)
    assert figures["local_speedup"] == pytest.approx(2.0)
    assert figures["seconds"] == {"bare": 4.0, "local_1": 8.0, "local_2": 4.0}
    assert "ray_overhead" not in figures


@pytest.mark.slow
def test_every_engine_makes_the_scenes(tmp_path, monkeypatch):
    path = write_cell(tmp_path)
    monkeypatch.setattr(
        engines, "paper_cell", lambda count: resolve_cell(load_config(path), tmp_path)
    )
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    shares = []
    figures = engines.measure_engines(3, 2, on_work=lambda share, what: shares.append(share))
    assert set(figures["seconds"]) == {"bare", "local_1", "local_2"}
    assert figures["local_speedup"] > 0  # how high it is, a busy machine does not tell
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
