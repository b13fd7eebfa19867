"""The study of denoisers: its rows, and the denoiser and number of samples that it advises."""

import json

import numpy as np
import pytest
from drawn import axes_of, figures_of, points_of

from benchmarks import denoise, plots
from benchmarks.cells import opened
from benchmarks.denoise import recommended, sample_counts
from benchmarks.figures import describe


def rows(renderer="cycles", **shares):
    """Return the rows of a series of sample counts that starts at 4."""
    return [
        {"renderer": renderer, "denoise": denoise, "samples": 4 * 2**k, "bad_share": share}
        for denoise, series in shares.items()
        for k, share in enumerate(series)
    ]


def test_the_advice_names_the_best_denoiser_and_the_fewest_samples_within_the_limit():
    series = {"none": (0.4, 0.2, 0.1, 0.009, 0.001), "oidn": (0.3, 0.1, 0.05, 0.02, 0.004)}
    advice = recommended(rows(**series) + rows("mitsuba", none=(0.0,) * 5), "cycles")
    assert advice == {
        "renderer": "cycles",
        "denoise": "oidn",
        "bad_share": 0.05,
        "bad_share_at": 16,
        "samples": 64,
    }


def test_no_number_is_advised_if_the_error_rises_with_more_samples():
    advice = recommended(rows(none=(0.1, 0.005, 0.008, 0.02)), "cycles")
    assert advice["samples"] is None
    assert recommended(rows(none=(0.1, 0.02, 0.008, 0.006)), "cycles")["samples"] == 16


def test_numbers_of_samples_double_up_to_the_maximum():
    assert sample_counts(256) == (4, 8, 16, 32, 64, 128, 256)
    assert sample_counts(100) == (4, 8, 16, 32, 64)
    with pytest.raises(ValueError, match="samples is 3"):
        sample_counts(3)


@pytest.mark.slow
def test_errors_and_noise_fall_equally_with_more_samples(painted):
    """Errors and noise are zero for a renderer without noise, with any denoiser and samples."""
    noisy = painted(name="cycles", noise=0.6)
    figures = denoise.study(
        painted(), noisy, painted(name="cycles", noise=0.6), count=3, most=16, size_px=(48, 20),
        show=lambda text: None,
    )  # fmt: skip
    figures = json.loads(json.dumps(figures))
    by = {(r["renderer"], r["denoise"], r["samples"]): r for r in figures["rows"]}
    assert len(by) == 2 * 2 * 3
    assert by["cycles", "none", 4]["bad_share"] > 2 * by["cycles", "none", 16]["bad_share"] > 0
    assert not any(by["mitsuba", "oidn", n]["bad_share"] for n in (4, 8, 16))
    assert [quality.denoise for _, quality, _ in noisy.requests] == ["none"] * 4 + ["oidn"] * 3 + [
        "none",
        "oidn",
    ]
    assert {r["samples"] for r in figures["with_sensor_noise"]} == {16}
    assert {r["renderer"] for r in figures["in_one_band"]} == {"cycles"}
    assert "edge_growth_px" in describe(figures)


@pytest.mark.slow
def test_denoising_reduces_bad_pixels_of_cycles_at_few_samples(cycles_renderer, tmp_path):
    """A small crop with 12 patterns is rendered with 4 samples."""
    with opened(1, 3) as renderers:
        figures = denoise.study(
            *renderers, count=30, most=8, size_px=(86, 64), show=lambda text: None
        )
    by = {(r["renderer"], r["denoise"], r["samples"]): r for r in figures["rows"]}
    assert by["cycles", "oidn", 4]["bad_share"] < 0.8 * by["cycles", "none", 4]["bad_share"]
    assert by["mitsuba", "none", 4]["bad_share"] < by["cycles", "none", 4]["bad_share"]
    with figures_of(plots) as pictures:
        plots.draw(figures | {"benchmark": "denoise"}, tmp_path / "denoise.png")
    axes = axes_of(pictures[0])
    for title, x, y in (
        ("Wrong, lost or extra pixels", "samples", "bad_share"),
        ("Depth of right pixels", "samples", "depth_rms_right_mm"),
        ("What a second buys", "seconds", "bad_share"),
        ("How far lit stripes grow at an edge", "samples", "edge_growth_px"),
    ):
        expected = sorted((row[x], row[y]) for row in figures["rows"] if y in row)
        assert points_of(axes[title]) == pytest.approx(np.array(expected))
