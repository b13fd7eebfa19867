"""The study of speed: its extrapolated times equal the times of fake renderers."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from drawn import axes_of, figures_of, points_of

from benchmarks import plots, renderers
from benchmarks.cells import opened
from benchmarks.figures import describe
from benchmarks.renderers import Stopwatch, equal_error

WORDS = {"count": 3, "samples": 16, "size_px": (48, 20), "show": lambda text: None}


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that the fake renderers advance; processor time is twice the wall time."""

    class Time:
        now_s = 0.0

    monkeypatch.setattr(renderers, "time", type("T", (), {"perf_counter": lambda: Time.now_s}))
    monkeypatch.setattr(renderers, "cpu_s", lambda: 2 * Time.now_s)
    monkeypatch.setattr(renderers, "ERROR_MOST", 16)
    return Time


def slow(painted, clock, **words):
    """Return a fake renderer. A render takes `start_s`, and `per_sample_s` for each sample."""

    @dataclass
    class Slow(painted):
        start_s: float = 0.0
        per_sample_s: float = 0.0

        def render(self, scene, layout, pattern, *, quality, seed):
            heard, self.on_frame = self.on_frame, None
            result = super().render(scene, layout, pattern, quality=quality, seed=seed)
            self.on_frame = heard
            clock.now_s += self.start_s
            count = -(-len(pattern) // self.patterns_per_render) if self.name == "cycles" else 1
            for done in range(1, count + 1):
                clock.now_s += quality.samples * self.per_sample_s
                if heard is not None:
                    heard(done, count)
            return result

    return Slow(**words)


def test_an_extrapolated_stack_takes_as_long_as_a_rendered_stack(painted, clock):
    """Without white and black, 11 of 13 patterns are rendered. One pass takes 0.5 + 1.6 s. Cycles
    takes 7 + 11 * 16 s, or 7 + 4 * 32 s with three patterns per render.
    """
    three = slow(painted, clock, name="cycles", start_s=7, per_sample_s=2, patterns_per_render=3)
    figures = renderers.study(
        slow(painted, clock, start_s=0.5, per_sample_s=0.1),
        slow(painted, clock, name="cycles", start_s=7, per_sample_s=1),
        three,
        **WORDS,
    )
    assert figures["onepass_s"] == pytest.approx(2.1)
    assert figures["cycles_s"] == pytest.approx(7 + 11 * 16)
    assert figures["cycles3_s"] == pytest.approx(7 + 4 * 32)
    assert figures["cycles_over_onepass"] == pytest.approx(183 / 2.1)
    assert figures["cycles3_over_onepass"] == pytest.approx(135 / 2.1)
    assert figures["cycles_over_onepass_cpu"] == pytest.approx(183 / 2.1)
    assert figures["cycles_cpu_s"] == pytest.approx(2 * 183)
    assert figures["cycles_frame_cpu_s"] == pytest.approx(2 * 16)
    assert figures["cycles_frame_cpu_s_at_few_samples"] == pytest.approx(2 * 4)
    assert figures["cycles_renders_timed"] == 3
    assert len(figures["rounds"]) == 2


def test_the_number_of_samples_for_equal_error_follows_the_power_law():
    """The errors are 1 / n (one pass) and 6 / n (Cycles) at n samples, so Cycles needs 96 samples
    for the error of one pass with 16. A frame takes 2 + n / 2 s of processor time.
    """
    rows = [
        {"renderer": name, "samples": n, "bad_share": factor / n, "depth_rms_right_mm": factor / n}
        for name, factor in (("mitsuba", 1.0), ("cycles", 6.0))
        for n in (4, 8, 16, 32, 64, 128)
    ]
    timed = {
        "cycles_frame_s": 9.0,  # includes a serial half, which is no cost of samples
        "cycles_over_onepass": 99.0,
        "cycles_frame_cpu_s": 2 + 16 * 0.5,
        "cycles_frame_cpu_s_at_few_samples": 2 + 4 * 0.5,
        "cycles_over_onepass_cpu": 70.0,
        "cycles3_over_onepass_cpu": 30.0,
    }
    for row in equal_error(rows, timed, 16):
        assert row["cycles_samples"] == pytest.approx(96) and row["cycles_side"] == ""
        assert row["cycles_over_onepass_cpu"] == pytest.approx(70 * 50 / 10)
        assert row["cycles3_over_onepass_cpu"] == pytest.approx(30 * 50 / 10)
        assert row["onepass_samples_for_cycles_error"] == 4.0 and row["onepass_side"] == "<"


def test_a_disturbed_frame_does_not_change_the_measured_time(clock):
    """The first frame builds the scene and is not counted; the median ignores one slow frame."""
    watch = Stopwatch()
    for frame_s in (30, 4, 4, 19, 1):
        clock.now_s += frame_s
        watch.mark()
    assert watch.steady(4) == pytest.approx((4, 8))


def test_too_few_samples_are_refused(painted):
    with pytest.raises(ValueError, match="more than 4"):
        renderers.study(painted(), painted(), painted(), **WORDS | {"samples": 4})


@pytest.mark.slow
def test_figures_of_the_benchmark_are_written_as_json_text_and_plot(painted, clock, tmp_path):
    words = {"name": "cycles", "noise": 0.3, "per_sample_s": 1}
    figures = renderers.study(
        slow(painted, clock, per_sample_s=0.1, noise=0.3),
        slow(painted, clock, **words),
        slow(painted, clock, patterns_per_render=3, **words),
        **WORDS,
    )
    figures = json.loads(json.dumps(figures))
    assert "cycles_over_onepass" in describe(figures)
    with figures_of(plots) as pictures:
        plots.draw(figures | {"benchmark": "renderers"}, tmp_path / "r.png")
    axes = axes_of(pictures[0])
    for title, y in (
        ("Wrong, lost or extra pixels", "bad_share"),
        ("Depth of right pixels", "depth_rms_right_mm"),
    ):
        expected = sorted((row["samples"], row[y]) for row in figures["errors"] if y in row)
        assert points_of(axes[title]) == pytest.approx(np.array(expected))
    (bars,) = (ax.patches for title, ax in axes.items() if "patterns" in title)
    seconds = [figures[f"{name}_s"] for name in ("onepass", "cycles3", "cycles")]
    assert [bar.get_width() for bar in bars] == pytest.approx(seconds)


@pytest.mark.slow
def test_one_pass_is_many_times_faster_than_a_frame_for_each_pattern(cycles_renderer, monkeypatch):
    """A crop gives a smaller ratio than a whole picture, since the time to start counts more."""
    monkeypatch.setattr(renderers, "ERROR_MOST", 8)
    monkeypatch.setattr(renderers, "ERROR_SIZE_PX", (86, 64))
    with opened(1, 3) as all_three:
        figures = renderers.study(*all_three, **WORDS | {"count": 30, "size_px": (258, 194)})
    assert figures["cycles_over_onepass"] > 10
    assert 1.5 < figures["cycles_over_onepass_cpu"] / figures["cycles3_over_onepass_cpu"] < 3.5
    assert figures["cycles_peak_rss_bytes"] > 100e6
