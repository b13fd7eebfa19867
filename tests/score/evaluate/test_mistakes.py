"""Test groups of instances, the working point, missed instances and false alarms."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.score.evaluate.judging import AREA_EDGES, Protocol, groups, judge
from graycast.score.evaluate.matching import match, overlaps
from graycast.score.evaluate.mistakes import false_alarms, misses, working_point
from graycast.score.evaluate.scores import scores_of

from .drawn_sets import SIZE_PX, RandomSet, detected_squares, figures, ours, squares

FOUR = [(0, 0), (20, 0), (40, 0), (0, 20)]


def judgement_of(labels, detections, kind="mask"):
    return judge(
        [labels], [detections], kind=kind, categories={1: "a", 2: "b"}, protocol=Protocol()
    )


def rows(judgement, by):
    return {row.name: row for row in judgement.rows if row.by == by}


def test_instances_of_another_visibility_are_ignored():
    """Two instances are hardly visible. One of them is missed, and all others are found."""
    labels = squares(0, FOUR, visible=[0.2, 0.25, 0.95, 1.0])
    detections = detected_squares(0, [FOUR[0], *FOUR[2:]], [0.9, 0.8, 0.7])
    by = rows(judgement_of(labels, detections), "visibility")
    assert by["90 to 100 %"].figures["ap"].value == 1.0
    assert by["90 to 100 %"].to_find == 2
    assert by["10 to 30 %"].figures["ar"].value == 0.5
    assert np.isnan(by["50 to 70 %"].figures["ap"].value)
    assert sum(row.to_find for row in by.values()) == 4


def test_a_mistake_counts_in_every_group_of_visibility():
    labels = squares(0, FOUR, visible=[0.2, 0.25, 0.95, 1.0])
    detections = detected_squares(0, [(40, 30), *FOUR], [0.99, 0.9, 0.8, 0.7, 0.6])
    by = rows(judgement_of(labels, detections), "visibility")
    assert by["90 to 100 %"].figures["ap"].value == pytest.approx(2 / 3, abs=1e-12)
    assert by["10 to 30 %"].figures["ap"].value == pytest.approx(2 / 3, abs=1e-12)


def test_instances_are_grouped_by_their_missing_depth():
    labels = replace(squares(0, FOUR), missing=np.array([0.0, 0.1, 0.6, 1.0]))
    by = rows(judgement_of(labels, detected_squares(0, FOUR[:2], [0.9, 0.8])), "missing depth")
    assert [row.to_find for row in by.values()] == [1, 1, 0, 2]
    assert by["50 to 100 %"].figures["ap"].value == 0.0
    assert by["0 to 5 %"].figures["ap"].value == 1.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["mask", "box"])
def test_scores_by_size_equal_those_of_pycocotools_area_ranges(seed, kind):
    """Oracle: areaRng of pycocotools, with the instances' areas set to those of boxes or masks.

    A range of pycocotools includes both ends; no area in these sets is exactly at an end.
    """
    random_set = RandomSet.of_seed(seed)
    known = overlaps(random_set.labels, random_set.detections, kind=kind, most=300)
    pixels = SIZE_PX[0] * SIZE_PX[1]
    by_size = [g for g in groups(known.labels, kind=kind, min_visibility=0.1) if g.by == "size"]
    assert [g.low for g in by_size] == list(AREA_EDGES[:-1])
    for group in by_size:
        own = scores_of(match(known, group), known)
        areas = [group.low * pixels, group.high * pixels]
        theirs = figures(*random_set.by_pycocotools(kind, areas=areas, box_areas=kind == "box"))
        np.testing.assert_allclose(ours(own), theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("decimals", [9, 1])
def test_the_working_point_has_the_highest_f1(decimals):
    """Oracle: F1 is counted with each score as threshold; equal scores cannot be separated."""
    random_set = RandomSet.of_seed(11, scenes=6)
    detections = [replace(one, score=one.score.round(decimals)) for one in random_set.detections]
    known = overlaps(random_set.labels, detections, kind="mask", most=300)
    matches = match(known)
    point = working_point(matches)
    wanted = sum(int(one.to_find.sum()) for one in matches.values())
    tried = {}
    for least in np.unique(np.concatenate([one.score for one in matches.values()])):
        hits = sum((one.hit[0] & (one.score >= least)).sum() for one in matches.values())
        count = sum((one.counted[0] & (one.score >= least)).sum() for one in matches.values())
        tried[float(least)] = 2 * hits / (count + wanted)
    assert tried[point.score] == max(tried.values())
    missed = misses(known, matches, point.score)
    alarms = false_alarms(known, matches, point.score)
    assert len(missed) == round(wanted * (1 - point.recall))
    hits = wanted - len(missed)
    assert point.precision == pytest.approx(hits / (hits + len(alarms)))


def test_every_mistake_has_its_kind():
    labels = squares(0, FOUR, obj_id=[1, 1, 2, 1], visible=[1, 1, 1, 0.5])
    places = [FOUR[0], FOUR[0], FOUR[2], (24, 0), (40, 30)]
    detections = detected_squares(0, places, [0.9, 0.8, 0.7, 0.6, 0.5], obj_id=[1, 1, 1, 1, 2])
    known = overlaps([labels], [detections], kind="mask", most=300)
    alarms = false_alarms(known, match(known), 0.0)
    assert [(one.detection, one.why) for one in alarms] == [
        (1, "found twice"),
        (2, "another class"),
        (3, "badly placed"),
        (4, "nothing there"),
    ]
    assert alarms[2].overlap == pytest.approx(1 / 3)
    missed = misses(known, match(known), 0.0)
    assert [one.instance for one in missed] == [1, 2, 3]  # in descending order of visibility
    assert missed[0].overlap == pytest.approx(1 / 3)
    assert missed[0].score == 0.6
    assert np.isnan(missed[2].score)


def test_results_without_hits_have_no_working_point():
    labels = squares(0, FOUR)
    judgement = judgement_of(labels, detected_squares(0, [], []), kind="box")
    assert np.isnan(judgement.point.score)
    assert judgement.point.recall == 0.0
    assert len(judgement.misses) == 4
    assert judgement.false_alarms == ()
