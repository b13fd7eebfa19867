"""Intervals over scenes, against copies of scenes, a known mean, and their own definition."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy import stats

from graycast.base.errors import GraycastError
from graycast.score.evaluate import score
from graycast.score.evaluate.intervals import differences, draw_scenes, interval_of, with_intervals
from graycast.score.evaluate.scores import figures_of_draws

from .drawn_sets import RandomSet, detected_squares, figures, squares

PLACES = [(12 * (i % 5), 12 * (i // 5)) for i in range(15)]


@pytest.mark.parametrize("kind", ["box", "mask"])
@pytest.mark.parametrize("seed", [1, 10, 16])
def test_a_bootstrap_draw_has_the_score_of_pycocotools_for_the_same_scenes(kind, seed):
    """Oracle: pycocotools on images that repeat the scenes of the draw."""
    # With even seeds, scores have one digit, and many of them are equal.
    random_set = RandomSet.of_seed(seed)
    scores = score(random_set.labels, random_set.detections, kind=kind)
    rng = np.random.default_rng(4)
    draws = [np.sort(rng.integers(0, 4, 4)) for _ in range(3)]
    times = np.array([np.bincount(places, minlength=4) for places in draws])
    got = np.array(list(figures_of_draws(scores.matches, times).values())).T
    expected = [figures(*random_set.by_pycocotools(kind, scenes=places)) for places in draws]
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)


def bin_of(scene_id, rng, *, share, parts=15):
    """Return a scene with boxes only, of which a share is found without false alarms."""
    hits = np.flatnonzero(rng.random(parts) < share)
    score = rng.uniform(0.5, 1, len(hits))
    labels = squares(scene_id, PLACES[:parts], masked=False)
    return labels, detected_squares(scene_id, [PLACES[i] for i in hits], score, masked=False)


def interval(scenes, *, seed, name="ar"):
    scores = score([one[0] for one in scenes], [one[1] for one in scenes], kind="box")
    return with_intervals(scores, draw_scenes(scores.scene_of, seed=seed))[name]


def test_the_interval_is_reproducible_and_hardly_depends_on_the_seed():
    rng = np.random.default_rng(0)
    scenes = [bin_of(i, rng, share=rng.uniform(0.4, 1)) for i in range(30)]
    first, again, other = (interval(scenes, seed=seed) for seed in (1, 1, 2))
    assert first == again != other
    width = first.high - first.low
    assert abs(first.low - other.low) < 0.15 * width
    assert first.low < first.value < first.high


@pytest.mark.parametrize(("scenes", "t"), [(3, 4.303), (5, 2.776), (12, 2.201), (60, 2.001)])
def test_normal_draws_of_a_mean_have_students_interval(scenes, t):
    """Oracle: mean +- t s / sqrt(n) with t from a printed table. The spread of bootstrap means is
    s sqrt((n - 1) / n) / sqrt(n). The tolerance is five standard errors for 200,000 draws."""
    spread = np.sqrt((scenes - 1) / scenes / scenes)  # s is 1.
    draws = 0.7 + spread * np.random.default_rng(5).standard_normal(200_000)
    limits = interval_of(0.7, draws, scenes)
    half = t / np.sqrt(scenes)
    z = half / spread
    share, density = stats.norm.sf(z), stats.norm.pdf(z)
    error = 5 * spread * np.sqrt(share / 200_000) / density
    assert limits.high - 0.7 == pytest.approx(half, abs=error)
    assert 0.7 - limits.low == pytest.approx(half, abs=error)


def test_an_estimate_off_centre_of_its_draws_gets_a_bias_corrected_interval():
    """Oracle: draws about `value + b sigma` have the limits `value - b sigma +- z sigma`."""
    draws = 0.6 + 0.05 * stats.norm.ppf((np.arange(100_000) + 0.5) / 100_000)
    z = np.sqrt(30 / 29) * stats.t.ppf(0.975, 29)
    for b in (-0.8, 0.0, 0.5):
        value = 0.6 - 0.05 * b
        limits = interval_of(value, draws, 30)
        assert limits.low == pytest.approx(value + 0.05 * (-b - z), abs=1e-3)
        assert limits.high == pytest.approx(value + 0.05 * (-b + z), abs=1e-3)


@pytest.mark.parametrize("value", [0.2, 0.9])
def test_an_interval_contains_its_estimate_even_beyond_all_draws(value):
    limits = interval_of(value, np.linspace(0.4, 0.6, 500), 10)
    assert limits.low <= value <= limits.high
    assert limits.high - limits.low == pytest.approx(abs(value - 0.5))  # from the draws' median


def alike(scene_id, rng):
    """Return a scene with equal scores, in which hits precede up to six false alarms."""
    labels, detections = bin_of(scene_id, rng, share=0.9, parts=8)
    wrong = [(x + 5, y + 5) for x, y in PLACES[: rng.integers(0, 7)]]
    every = [*detections.box_px[:, :2].astype(int).tolist(), *wrong]
    return labels, detected_squares(scene_id, every, np.ones(len(every)), masked=False)


@pytest.mark.slow
def test_equal_scores_do_not_move_the_draws_away_from_the_estimate():
    """Adjacent copies of detections once raised the draws by 0.033 above the estimate."""
    apart = []
    for seed in range(40):
        scenes = [alike(i, np.random.default_rng((i, seed))) for i in range(10)]
        scores = score([one[0] for one in scenes], [one[1] for one in scenes], kind="box")
        draws = figures_of_draws(scores.matches, draw_scenes(scores.scene_of, seed=seed, draws=200))
        apart.append(draws["ap"].mean() - scores.ap)
    assert abs(np.mean(apart)) < 0.01


def test_draws_without_a_score_do_not_change_the_interval():
    draws = np.where(np.arange(400) % 2 == 0, np.nan, np.linspace(0, 1, 400))
    assert interval_of(0.5, draws, 30) == interval_of(0.5, draws[1::2], 30)
    assert np.isnan(interval_of(0.5, np.full(9, np.nan), 30).low)


def test_equal_results_differ_by_exactly_zero():
    random_set = RandomSet.of_seed(2)
    scores = score(random_set.labels, random_set.detections, kind="mask")
    for one in differences(scores, scores, draw_scenes(range(4), seed=0)).values():
        assert (one.value, one.low, one.high) == (0.0, 0.0, 0.0)


def test_a_paired_difference_has_a_narrower_interval_than_either_result():
    """Scenes differ much, but results do not: one of them misses one more part in every scene."""
    rng = np.random.default_rng(6)
    scenes = [bin_of(i, rng, share=rng.uniform(0.3, 1)) for i in range(25)]
    labels = [one[0] for one in scenes]
    fewer = [detected_squares(i, one[1].box_px[1:, :2].astype(int), one[1].score[1:])
             for i, one in enumerate(scenes)]  # fmt: skip
    times = draw_scenes(range(25), seed=0)
    full, less = (score(labels, f, kind="box") for f in ([one[1] for one in scenes], fewer))
    gap, own = differences(full, less, times)["ar"], with_intervals(full, times)["ar"]
    assert gap.value == pytest.approx(1 / 15, abs=1e-12)
    assert gap.low == pytest.approx(1 / 15, abs=1e-12)
    assert own.high - own.low > 0.1


def test_a_second_equal_view_of_every_scene_leaves_the_interval_unchanged():
    """Oracle: the interval of the first views; an interval from resampled pictures is narrower."""
    rng = np.random.default_rng(8)
    scenes = [bin_of(i, rng, share=rng.uniform(0.3, 1)) for i in range(20)]
    views = [
        (replace(labels, scene_id=2 * i + k), replace(detections, scene_id=2 * i + k))
        for i, (labels, detections) in enumerate(scenes)
        for k in (0, 1)
    ]
    once, twice = interval(scenes, seed=0), interval(views, seed=0)
    np.testing.assert_allclose(astuple(twice), astuple(once), rtol=0, atol=1e-12)
    alone = [(replace(labels, scene=labels.scene_id), detections) for labels, detections in views]
    narrow = interval(alone, seed=0)
    assert narrow.high - narrow.low < 0.8 * (once.high - once.low)


def test_one_scene_has_no_interval():
    one = interval([bin_of(0, np.random.default_rng(0), share=0.5)], seed=0)
    assert not np.isnan(one.value)
    assert np.isnan(one.low)
    assert np.isnan(one.high)


def test_results_for_different_scenes_are_not_compared():
    random_set = RandomSet.of_seed(2)
    scores = score(random_set.labels, random_set.detections, kind="box")
    fewer = score(random_set.labels[:3], random_set.detections[:3], kind="box")
    with pytest.raises(GraycastError, match="results of the same scenes"):
        differences(scores, fewer, draw_scenes(range(4), seed=0))


def coverage(count, *, scenes, figure, truth, make):
    covered = 0
    for seed in range(count):
        rng = np.random.default_rng((scenes, seed))
        one = interval([make(i, rng) for i in range(scenes)], seed=seed, name=figure)
        covered += one.low <= truth <= one.high
    return covered / count


def uneven(scene_id, rng):
    """Return a scene with a random share of found parts, because real scenes differ, too."""
    return bin_of(scene_id, rng, share=rng.uniform(0.4, 1.0))


def with_mistakes(scene_id, rng):
    """Return such a scene with false alarms, whose scores are mostly lower than those of hits."""
    labels, detections = uneven(scene_id, rng)
    places = [(x + 5, y + 5) for x, y in PLACES[: rng.poisson(2)]]
    score = np.concatenate([detections.score, rng.uniform(0.2, 0.8, len(places))])
    order = np.argsort(-score)
    every = [*detections.box_px[:, :2].astype(int).tolist(), *places]
    return labels, detected_squares(scene_id, [every[i] for i in order], score[order], masked=False)


@pytest.mark.slow
@pytest.mark.parametrize(("scenes", "least"), [(5, 0.90), (20, 0.925)])
def test_95_of_100_intervals_of_recall_contain_the_known_mean(scenes, least):
    """The mean is 0.7 by construction. For 600 sets, two standard errors of 95 % are 1.8 %."""
    share = coverage(600, scenes=scenes, figure="ar", truth=0.7, make=uneven)
    assert least <= share <= 0.975


@pytest.mark.slow
def test_95_of_100_intervals_of_average_precision_contain_its_value_for_many_scenes():
    """AP is not a mean over scenes, so the AP of 6,000 scenes approximates its true value."""
    rng = np.random.default_rng(99)
    many = [with_mistakes(i, rng) for i in range(6000)]
    truth = score([one[0] for one in many], [one[1] for one in many], kind="box").ap
    share = coverage(400, scenes=25, figure="ap", truth=truth, make=with_mistakes)
    assert 0.92 <= share <= 0.98
