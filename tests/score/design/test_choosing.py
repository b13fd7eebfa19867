"""Test the Pareto front, the intervals and the recommendation of a study."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from graycast.score.design.choosing import (
    SettingFigures,
    choose,
    mean_interval,
    meets,
    on_front,
    row_of,
    sentences,
    unlike,
)
from graycast.score.design.point_fates import FATES, Fate
from graycast.score.design.setting import Placed, Setting
from graycast.score.design.study import DesignSpec, NeedsSection, SweepSection


def spec(**words) -> DesignSpec:
    return DesignSpec(cell="cell.yaml", sweeps=(SweepSection(),), **words)


def placed(setting: Setting) -> Placed:
    """Return a placed setting that has only the values that the recommendation uses."""
    view = SimpleNamespace(distance_m=0.85, tilt_deg=8.0, azimuth_deg=0.0)
    cell = SimpleNamespace(
        config=SimpleNamespace(view=view),
        scene=SimpleNamespace(rig=SimpleNamespace(name="like-phoxi-m")),
    )
    placement = object.__new__(Placed)
    object.__setattr__(placement, "setting", setting)
    object.__setattr__(placement, "cell", cell)
    return placement


def row(name: str, shares, *, sigma_m=0.0002, seconds=0.5, feature_m=0.003) -> SettingFigures:
    heaps = [
        None
        if share is None
        else {
            "measured": share,
            "share": {str(fate): 0.0 for fate in FATES}
            | {"measured": share, "part_shadow": 0.75 * (1 - share), "dark": 0.25 * (1 - share)},
            "of_seen": share,
            "sigma_m": sigma_m,
            "bias_m": -0.00003,
            "pixel_m": feature_m / 3,
            "feature_m": feature_m,
            "seconds": seconds,
        }
        for share in shares
    ]
    return row_of(placed(Setting(code=name)), heaps)


def test_settings_are_dominated_exactly_if_they_are_not_on_the_front():
    """Law: all pairs of settings are compared one by one."""
    values = np.random.default_rng(5).integers(0, 6, (60, 3)).astype(float)
    front = on_front(values)
    for own, here in zip(values.tolist(), front, strict=True):
        better = [
            other
            for other in values.tolist()
            if all(a <= b for a, b in zip(other, own, strict=True)) and other != own
        ]
        assert here == (not better)
    assert 0 < sum(front) < 60


def test_equal_settings_share_the_front_and_a_setting_without_figures_is_not_on_it():
    assert on_front(np.array([[0.5, 1.0, 1.0], [0.5, 1.0, 1.0]])) == [True, True]
    assert on_front(np.array([[math.nan, 0.0, 0.0], [0.5, 1.0, 1.0]])) == [False, True]


@pytest.mark.slow
def test_intervals_contain_the_true_mean_19_times_in_20():
    """Oracle: the meaning of 95 %. Over 2000 experiments with 4 normal values, the share has a
    standard error of 0.5 %. A heap without figures is ignored."""
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(2000):
        interval = mean_interval(np.append(rng.normal(0.4, 0.1, 4), math.nan))
        inside += interval.low <= 0.4 <= interval.high
    assert inside / 2000 == pytest.approx(0.95, abs=0.015)
    assert math.isnan(mean_interval(np.array([0.3])).low)


def test_differences_between_settings_are_computed_for_each_heap():
    """Heaps differ by far more than settings do, but the difference is the same in each heap."""
    heaps = np.array([0.2, 0.4, 0.6, 0.8])
    best, other = row("best", heaps + 0.01), row("other", heaps)
    less = unlike([best, other], best)["other"]
    assert less.value == pytest.approx(0.01)
    assert less.high - less.low < 1e-9
    half = stats.t.ppf(0.975, 3) * heaps.std(ddof=1) / 2
    assert best.measured.high - best.measured.value == pytest.approx(half)


def test_the_best_setting_measures_most_among_those_that_meet_the_needs():
    rows = [
        row("noisy", [0.9, 0.9], sigma_m=0.0009),
        row("slow", [0.8, 0.8], seconds=3.0),
        row("good", [0.7, 0.7]),
        row("lost", [None, None]),
    ]
    assert choose(spec(), rows) is rows[0]
    needs = spec(needs=NeedsSection(sigma_m=0.0003, seconds=1.0))
    assert [meets(needs, one) for one in rows] == [False, False, True, False]
    assert choose(needs, rows) is rows[2]
    just = spec(needs=NeedsSection(sigma_m=0.0002, seconds=0.5, feature_m=0.003))
    assert meets(just, rows[2])  # A value equal to the limit is allowed.


def test_the_summary_names_the_best_rig_and_its_position():
    rows = [row("fine", [0.92, 0.91, 0.93]), row("gray", [0.80, 0.79, 0.81])]
    text = sentences(spec(layouts=3), rows)
    assert text.startswith(
        "The rig like-phoxi-m at 0.85 m tilted 8 degrees with the code fine measures 92.0% (95 % "
        "interval 89.5% to 94.5%) of the open surface of the parts, with a sigma of 0.20 mm and a "
        "bias of -0.03 mm. It resolves features from 3.0 mm and takes 0.50 s a scan. "
        "Most of what it misses is "
        "6.0% in the shadow of parts and 2.0% too dark. Of the 2 settings it measures most."
    )
    assert "not significant" not in text
    like = [*rows, row("twin", [0.92, 0.92, 0.915])]
    assert "On these 3 heaps its difference is not significant from twin." in sentences(
        spec(layouts=3), like
    )


def test_the_summary_says_if_no_setting_meets_the_needs():
    rows = [row("a", [0.9], sigma_m=0.0004), row("b", [0.8], sigma_m=0.0006)]
    text = sentences(spec(needs=NeedsSection(sigma_m=0.0001), layouts=1), rows)
    assert text == (
        "None of the 2 settings has a sigma of at most 0.1 mm. The least sigma is 0.4 mm, of a."
        " Warning: One heap gives no interval. Give at least 4 as layouts before you decide."
    )
    assert "3 heaps are few" in sentences(spec(layouts=3), rows)
    assert "Warning" not in sentences(spec(layouts=4), rows)


def test_reasons_for_missing_surface_are_sorted_by_share():
    assert row("a", [0.6]).missing() == [
        (Fate.PART_SHADOW, pytest.approx(0.3)),
        (Fate.DARK, pytest.approx(0.1)),
    ]
