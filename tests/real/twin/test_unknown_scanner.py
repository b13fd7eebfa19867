"""A scanner hidden by seed: a short search with its code comes nearer to its statistics."""

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import numpy as np
import pytest

from graycast.real.twin import searching
from graycast.real.twin.parameters import candidate_codes
from graycast.real.twin.rows import loss_of

SCRIPT = Path(__file__).resolve().parents[3] / "scripts" / "twins-of-unknown-scanners"


@pytest.mark.slow
def test_a_hidden_scanner_s_statistics_are_come_nearer_to(monkeypatch):
    loader = SourceFileLoader("twins_of_unknown_scanners", str(SCRIPT))
    script = module_from_spec(spec_from_loader(loader.name, loader))
    monkeypatch.setitem(sys.modules, loader.name, script)  # dataclasses look there
    loader.exec_module(script)
    monkeypatch.setattr(searching, "_PROFILE", ())
    monkeypatch.setattr(script, "candidate_codes", lambda code: candidate_codes(code)[:1])
    scanner = script.small_scanner()
    lit = [script.light(scanner, np.random.default_rng((16, k))) for k in range(script.SCENES)]
    one = script.study(0, lit, trials=70)
    assert loss_of(one.found.after) < 0.5 * loss_of(one.found.before)
    for held in one.found.held:
        assert held.parameter.low <= held.low <= held.value <= held.high <= held.parameter.high
