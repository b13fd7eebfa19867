"""The probability that a depth is wrong: its table, its effect on depth, and its reasons."""

import numpy as np
import pytest
from stage import centred

from graycast.camera.decode import DepthMap, Reason
from graycast.camera.decode.evidence import CUES, NAMES
from graycast.camera.decode.evidence.wrong import Evidence, _weigh, evidence, spoken_against

FIRST, SECOND = 3, 7  # the cues of the small table


def small_table():
    """Return two trees: one on the first cue, and one on the second and then on the first.

    The first tree gives -2 up to 1.5 and +1 above. The second gives 4 where the second cue is
    unknown or above 0; else it gives -1 up to 5 of the first cue and 3 above.
    """
    leaf = -1
    return Evidence(
        start=np.array([0, 3], np.int32),
        cue=np.array([FIRST, leaf, leaf, SECOND, FIRST, leaf, leaf, leaf], np.int16),
        limit=np.array([1.5, -2, 1, 0, 5, 4, -1, 3], np.float32),
        lacking=np.array([True, 0, 0, False, False, 0, 0, 0], bool),
        next=np.array([1, 0, 0, 4, 6, 0, 0, 0], np.int32),
        typical=np.zeros(len(CUES), np.float32),
    )


def probabilities(cues, table):
    p_wrong = np.full((1, cues.shape[1]), np.nan, np.float32)
    _weigh(cues[:, None], np.ones(p_wrong.shape, bool), table, p_wrong)
    return p_wrong[0]


@pytest.mark.parametrize(
    ("first", "second", "log_odds"),
    [(1.5, -1, -3), (2, -1, 0), (6, 0, 4), (0, 1, 2), (np.nan, np.nan, 2), (np.nan, -1, 1)],
)
def test_the_log_odds_of_all_trees_are_summed(first, second, log_odds):
    cues = np.zeros((len(CUES), 1), np.float32)
    cues[FIRST], cues[SECOND] = first, second
    expected = 1 / (1 + np.exp(-log_odds))
    assert probabilities(cues, small_table())[0] == pytest.approx(expected, rel=1e-5)


def random_cues(count, seed=1):
    """Return cues around their typical values, with a spread of the usual size."""
    typical = evidence().typical
    rng = np.random.default_rng(seed)
    spread = 1 + 0.5 * np.abs(typical)
    return (typical + spread * rng.standard_normal((count, len(CUES)))).astype(np.float32).T


@pytest.mark.parametrize("cue", [cue for cue in CUES if cue.sense], ids=lambda cue: cue.name)
def test_better_evidence_never_counts_against_a_depth(cue):
    cues = random_cues(2000)
    better = cues.copy()
    better[NAMES.index(cue.name)] -= cue.sense * 0.7
    table = evidence()
    assert (probabilities(better, table) <= probabilities(cues, table) * (1 + 1e-5)).all()


def test_typical_right_pixels_are_unlikely_to_be_wrong():
    assert probabilities(evidence().typical[:, None], evidence())[0] < 0.003


def test_a_pixel_gets_the_reason_of_the_evidence_against_it():
    typical = evidence().typical
    cues = np.repeat(typical[:, None], 2, axis=1)
    for name in NAMES:
        if "fine contrast" in name:
            cues[NAMES.index(name), 0] = 0.1
        if "epipolar" in name:
            cues[NAMES.index(name), 1] = 5.0
    against = spoken_against(cues, evidence())
    assert list(against) == [Reason.INTERREFLECTION, Reason.OUTLIER]


def depth_map(p_wrong=None):
    camera = centred(3, 2, 10.0)
    return DepthMap(
        depth_m=np.arange(1, 7, dtype=np.float32).reshape(2, 3),
        sigma_m=np.full((2, 3), 1e-3, np.float32),
        reason=np.zeros((2, 3), np.uint8),
        camera=camera,
        p_wrong=p_wrong,
    )


def test_pixels_without_depth_have_no_probability():
    p_wrong = np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3)
    removed = np.array([[True, False, False], [False, False, True]])
    reasons = np.array([Reason.OUTLIER, Reason.CONTRADICTORY], np.uint8)
    left = depth_map(p_wrong).without(removed, reasons)
    for values in (left.depth_m, left.sigma_m, left.p_wrong):
        assert np.array_equal(np.isnan(values), removed)
    assert left.reason.tolist() == [[Reason.OUTLIER, 0, 0], [0, 0, Reason.CONTRADICTORY]]
    assert np.array_equal(left.depth_m[~removed], depth_map().depth_m[~removed])


def test_a_map_without_probabilities_stays_without_them():
    assert depth_map().without(np.ones((2, 3), bool), Reason.OUTLIER).p_wrong is None
