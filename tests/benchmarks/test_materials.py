"""The table of materials: the limit for wrong depth, the renders, and the text of the page."""

import numpy as np
import pytest

from benchmarks.decoders import shared_patterns
from benchmarks.materials import MATERIALS, Worth, _scanners, page, worth
from graycast.camera.decode import DepthMap
from graycast.camera.scanner import preset


def test_a_depth_with_an_error_above_1_mm_and_5_sigmas_is_wrong():
    off_m = np.array([[0.0, 0.5e-3, 2e-3, 2e-3, 9.0, 9.0]])  # the last pixel shows no part
    sigma_m = np.array([[1e-4, 5e-5, 5e-4, 3e-4, np.nan, 1e-4]])
    parts = np.array([[True] * 5 + [False]])
    depth_m = np.where(np.isnan(sigma_m), np.nan, 0.8 + off_m)
    depth = DepthMap(
        depth_m=depth_m,
        sigma_m=sigma_m,
        reason=np.zeros((1, 6), np.uint8),
        camera=preset("like-phoxi-m", "small").rig.camera,
    )
    figures = worth(depth, np.full((1, 6), 0.8), parts)
    assert figures["decoded"] == pytest.approx(4 / 5)
    assert figures["right"] == pytest.approx(3 / 5)
    assert figures["wrong"] == pytest.approx(1 / 4)
    ratios = [0, 10, 4, 2e-3 / 3e-4]
    assert figures["error_over_sigma"] == pytest.approx(np.median(ratios) / 0.6745)


@pytest.mark.slow
def test_every_picture_of_every_code_is_rendered_once():
    """The variants of the preset share their pictures."""
    scanners = _scanners("like-phoxi-m", preset("like-phoxi-m", "small"))
    keys, patterns = shared_patterns([*scanners.values()])
    assert len(set(keys)) == len(keys) == len(patterns)
    codes = [scanner.light_code() for scanner in scanners.values()]
    assert len(keys) < sum(len(code.frames) for code in codes)


def test_the_page_has_a_row_for_every_material():
    own = {"scanner": "like-phoxi-m", "decoded": 0.5, "error_over_sigma": 1.0}
    rows = [
        Worth(code=code, material=material, wrong=wrong, right=right, place=place, **own)
        for place in ("parts", "around")
        for material in MATERIALS
        for code, wrong, right in (("preset", 0.004, 0.36), ("without a limit", 0.3, 0.4))
    ]
    about = {"date": "2026-01-02", "commit": "abc", "resolution": "low", "cores": 2, "cpu": "x"}
    (_, words), (heading, table), (where, beside) = page(rows, **about)
    assert (heading, where) == ("Presets", "Around the parts")
    assert len(beside.splitlines()) > len(table.splitlines())
    assert len(table.splitlines()) == 2 + len(MATERIALS)
    assert table.startswith("| decoded; wrong; error/sigma | like-phoxi-m | without a limit |")
    words = words.replace("\n", " ")
    assert "2026-01-02 at commit `abc`" in words
    assert "up to 30.0 % of the depths are wrong. With it, at most 0.4 % (`like-phoxi-m`)." in words
    assert "the limit keeps 90 to 90 % of the right depths" in words
    assert "| matt | 50; 0.4; 1.00 | 50; 30.0; 1.00 |" in table


def test_the_page_names_the_best_and_the_worst_code_on_the_smoothest_metal():
    own = {"scanner": "like-phoxi-m", "decoded": 0.5, "right": 0.4, "error_over_sigma": 1.0}
    wrong = {
        "preset": 0.0,
        "without a limit": 0.0,
        "gray": 0.12,
        "gray_phase": 0.05,
        "xor_gray": 0.2,
    }
    rows = [
        Worth(code=code, material=material, place=place, wrong=share * (place == "parts"), **own)
        for place in ("parts", "around")
        for material in MATERIALS
        for code, share in wrong.items()
    ]
    about = {"date": "2026-01-02", "commit": "abc", "resolution": "low", "cores": 2, "cpu": "x"}
    words = dict(page(rows, **about))["Codes"].replace("\n", " ")
    assert "`gray_phase` has the fewest wrong depths, 5.0 %, and" in words
    assert "and `xor_gray` the most, 20.0 %" in words
