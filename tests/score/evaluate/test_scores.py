"""Average precision against closed forms and against pycocotools 2.0."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.dataset.read.example import Example
from graycast.score.evaluate import labels_of, score
from graycast.score.evaluate.scores import precision_curves

from .drawn_sets import SIZE_PX, RandomSet, detected_squares, figures, ours, squares

KINDS = ("box", "mask")
FOUR = [(0, 0), (20, 0), (40, 0), (0, 20)]


def one_scene(detections, *, labels=None, kind="mask", most=300):
    labels = squares(0, FOUR) if labels is None else labels
    return score([labels], [detections], kind=kind, most=most)


def ap_of_class(scores):
    return {obj_id: precision_curves(one).mean() for obj_id, one in scores.matches.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_perfect_detections_score_exactly_one(kind):
    scores = one_scene(detected_squares(0, FOUR, [0.9, 0.8, 0.7, 0.6]), kind=kind)
    assert ours(scores).tolist() == [1.0, 1.0, 1.0, 1.0]
    assert ap_of_class(scores) == {1: 1.0}


def test_a_false_alarm_with_the_lowest_score_does_not_lower_ap():
    scores = one_scene(detected_squares(0, [*FOUR, (40, 30)], [0.9, 0.8, 0.7, 0.6, 0.5]))
    assert scores.ap == 1.0


def test_a_false_alarm_with_the_highest_score_lowers_ap():
    """Precisions at the hits are 1/2, 2/3, 3/4, 4/5; the maximum to the right is 4/5 everywhere."""
    scores = one_scene(detected_squares(0, [(40, 30), *FOUR], [0.99, 0.9, 0.8, 0.7, 0.6]))
    assert scores.ap == pytest.approx(4 / 5, abs=1e-12)
    assert scores.ar == 1.0


def test_ap_is_51_of_101_if_half_of_the_instances_are_detected():
    """Recall 0.5 is the 51st of COCO's recalls 0, 0.01, ..., 1; precision is 1 up to it."""
    scores = one_scene(detected_squares(0, FOUR[:2], [0.9, 0.8]))
    assert scores.ap == pytest.approx(51 / 101, abs=1e-12)
    assert scores.ar == 0.5


def test_a_second_detection_of_the_same_instance_is_a_mistake():
    """The order is hit, double, hit, hit, hit: precision is 1 up to recall 1/4, then 4/5."""
    scores = one_scene(detected_squares(0, [FOUR[0], *FOUR], [0.95, 0.9, 0.8, 0.7, 0.6]))
    assert scores.ap == pytest.approx((26 + 75 * 4 / 5) / 101, abs=1e-12)


def test_an_overlap_between_two_thresholds_is_a_hit_only_for_the_lower_threshold():
    """A square of 8 px is shifted by 1 px: 7/9 = 0.78 suffices for 0.50 to 0.75, six of ten."""
    scores = one_scene(detected_squares(0, [(1, 0)], [0.9]), labels=squares(0, [(0, 0)]))
    assert (scores.ap50, scores.ap75) == (1.0, 1.0)
    assert scores.ap == pytest.approx(0.6, abs=1e-12)
    assert scores.ar == pytest.approx(0.6, abs=1e-12)


def test_detections_of_ignored_instances_are_neither_required_nor_mistakes():
    labels = squares(0, FOUR, visible=[0.05, 1, 1, 1])
    missed = one_scene(detected_squares(0, FOUR[1:], [0.9, 0.8, 0.7]), labels=labels)
    places = [FOUR[0], FOUR[0], *FOUR[1:]]
    twice = one_scene(detected_squares(0, places, [0.99, 0.98, 0.9, 0.8, 0.7]), labels=labels)
    assert missed.ap == twice.ap == 1.0
    assert missed.to_find == 3


def test_a_detection_inside_an_ignored_crowd_is_no_mistake():
    """COCO's crowd rule: the detection covers 1/4 of the instance, but is completely inside it."""
    labels = squares(0, [(0, 0), (20, 0)], visible=[0.05, 1], side=8)
    small = detected_squares(0, [(0, 0)], [0.99], side=4)
    good = detected_squares(0, [(20, 0)], [0.9])
    both = replace(
        good,
        score=np.concatenate([small.score, good.score]),
        obj_id=np.array([1, 1]),
        box_px=np.concatenate([small.box_px, good.box_px]),
        mask=(*small.mask, *good.mask),
    )
    assert one_scene(both, labels=labels).ap == 1.0
    counted = replace(labels, ignored=np.array([False, False]))
    assert one_scene(both, labels=counted).ap < 0.5


def test_classes_without_instances_are_left_out_of_the_average():
    """Class 1 is perfect, class 2 is missed; class 3 has no instances, so it is not averaged."""
    labels = squares(0, FOUR, obj_id=[1, 1, 2, 2])
    detections = detected_squares(
        0, [FOUR[0], FOUR[1], (40, 30)], [0.9, 0.8, 0.7], obj_id=[1, 1, 3]
    )
    scores = one_scene(detections, labels=labels)
    assert scores.ap == 0.5
    assert ap_of_class(scores)[1] == 1.0
    assert ap_of_class(scores)[2] == 0.0
    assert np.isnan(ap_of_class(scores)[3])


def test_the_score_is_zero_without_detections_and_nan_without_instances():
    assert ours(one_scene(detected_squares(0, [], []))).tolist() == [0.0] * 4
    nothing = one_scene(detected_squares(0, FOUR, [0.9] * 4), labels=squares(0, []))
    assert np.isnan(ours(nothing)).all()
    assert np.isnan(ours(one_scene(detected_squares(0, [], []), labels=squares(0, [])))).all()


def test_more_than_100_detections_of_a_full_bin_are_scored():
    """All of 255 parts are found. With only 100 detections, 40 of the 101 recalls are reached."""
    places = [(3 * (i % 20), 3 * (i // 20)) for i in range(255)]
    labels = squares(0, places, side=2)
    detections = detected_squares(0, places, np.linspace(0.99, 0.5, 255), side=2)
    assert one_scene(detections, labels=labels).ap == 1.0
    coco = one_scene(detections, labels=labels, most=100)
    assert coco.ap == pytest.approx(40 / 101, abs=1e-12)
    assert coco.ar == pytest.approx(100 / 255, abs=1e-12)


def compared(seed):
    random_set = RandomSet.of_seed(seed)
    for kind in KINDS:
        for most in (5, 300):
            scores = score(random_set.labels, random_set.detections, kind=kind, most=most)
            precision, recall = random_set.by_pycocotools(kind, most)
            np.testing.assert_allclose(ours(scores), figures(precision, recall), rtol=0, atol=1e-9)
            for obj_id, value in ap_of_class(scores).items():
                own = precision[:, :, obj_id - 1]
                expected = own.mean() if own.max() > -1 else np.nan
                np.testing.assert_allclose(value, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_scores_of_random_sets_equal_those_of_pycocotools(seed):
    compared(seed)


@pytest.mark.slow
def test_scores_of_200_random_sets_equal_those_of_pycocotools():
    for seed in range(10, 210):
        compared(seed)


@pytest.mark.slow
def test_scores_of_random_sets_equal_those_of_faster_coco_eval():
    """faster-coco-eval is a second oracle that shares no code with the matching of pycocotools."""
    faster = pytest.importorskip(
        "faster_coco_eval", reason="needs faster-coco-eval: pip install 'graycast[test]'"
    )
    from faster_coco_eval.core.coco import COCO

    for seed in range(20):
        random_set = RandomSet.of_seed(seed)
        truth, results = random_set.coco("mask")
        known = COCO(truth)
        judge = faster.COCOeval_faster(known, known.loadRes(results), "segm")
        judge.params.maxDets = [1, 10, 300]
        judge.evaluate()
        judge.accumulate()
        theirs = judge.eval["precision"][:, :, :, 0, -1], judge.eval["recall"][:, :, 0, -1]
        scores = score(random_set.labels, random_set.detections, kind="mask")
        np.testing.assert_allclose(ours(scores), figures(*theirs), rtol=0, atol=1e-9)


def test_the_order_of_the_scenes_does_not_change_the_score():
    random_set = RandomSet.of_seed(3)
    forth = score(random_set.labels, random_set.detections, kind="box")
    back = score(
        random_set.labels[::-1], random_set.detections[1:] + random_set.detections[:1], kind="box"
    )
    assert ours(forth).tolist() == ours(back).tolist()
    assert back.scene_ids == (0, 1, 2, 3)


@pytest.mark.parametrize(
    ("labels", "detections", "words"),
    [
        ([0, 1], [0], "scene 1 has no detections"),
        ([0], [0, 7], "scene 7 has no labels"),
        ([0, 0], [0], "scene 0 has labels twice"),
        ([0], [0, 0], "scene 0 has detections twice"),
    ],
)
def test_labels_and_detections_of_other_scenes_are_refused(labels, detections, words):
    with pytest.raises(GraycastError, match=words):
        score(
            [squares(i, FOUR) for i in labels],
            [detected_squares(i, FOUR, [0.9] * 4) for i in detections],
            kind="box",
        )


def test_scoring_by_masks_without_masks_is_refused():
    detections = detected_squares(0, FOUR, [0.9] * 4)
    with pytest.raises(GraycastError, match="detections have no masks: score boxes"):
        one_scene(replace(detections, mask=None))
    with pytest.raises(GraycastError, match="labels have no masks: score boxes"):
        one_scene(detections, labels=replace(squares(0, FOUR), mask=None))
    assert one_scene(replace(detections, mask=None), kind="box").ap == 1.0


def test_masks_of_another_picture_size_are_refused():
    labels = replace(squares(0, FOUR), size_px=(96, 128))
    with pytest.raises(GraycastError, match="64 x 48 pixels, the picture has 128 x 96"):
        one_scene(detected_squares(0, FOUR, [0.9] * 4), labels=labels)


def test_labels_of_an_example_have_visibility_and_the_share_of_missing_depth():
    mask = np.zeros((2, *SIZE_PX), bool)
    mask[0, :4, :4], mask[1, 10:14, 10:20] = True, True
    depth_m = np.ones(SIZE_PX, np.float32)
    depth_m[:1, :], depth_m[10:14, 15:] = np.nan, np.nan
    example = Example(
        scene_id=5,
        obj_id=np.array([1, 2]),
        mask=mask,
        box_px=np.array([[0, 0, 4, 4], [10, 10, 10, 4]], np.float32),
        visib_fract=np.array([0.1, 0.09]),
        scanner_depth_m=depth_m,
    )
    labels = labels_of(example, min_visibility=0.1)
    assert labels.ignored.tolist() == [False, True]
    assert labels.missing.tolist() == [0.25, 0.5]
    assert labels.size_px == SIZE_PX
    with pytest.raises(GraycastError, match="scene 5: has no labels"):
        labels_of(Example(scene_id=5), min_visibility=0.1)
