"""Notes on labels whose scores the simulation confirms or contradicts."""

import pytest

from graycast.robot.grasp_labels.label_success import BANDS, Band, Ranking, describe_ranking
from graycast.score.evaluate.intervals import Interval


def ranking_of(*counts):
    """Return the ranking of labels with the given (grips, successes) in each band."""
    bands = tuple(
        Band(low=low, high=high, grips=grips, held=successes)
        for (low, high), (grips, successes) in zip(BANDS, counts, strict=True)
    )
    grips, successes = (sum(column) for column in zip(*counts, strict=True))
    unknown = Interval(value=float("nan"), low=float("nan"), high=float("nan"))
    return Ranking(
        scenes=1,
        labels=grips,
        reach={"free": grips},
        ended={"held": successes, "not held": grips - successes},
        bands=bands,
        auc=unknown,
        auc_above_0=unknown,
    )


NOTHING = (0, 0)


@pytest.mark.parametrize(
    ("counts", "notes"),
    [
        ((38, 38), ["38 of 38 grips with score 0 were held"]),
        ((38, 3), []),  # A few grips hold although their score is low.
        ((3, 3), []),  # There are too few grips to decide: the interval begins at 44 %.
    ],
)
def test_grips_that_hold_despite_a_score_of_0_cause_a_note(counts, notes):
    text = describe_ranking(ranking_of(counts, *[NOTHING] * 4, (20, 19)))
    remarks = [line for line in text.splitlines() if line.startswith("note: ")]
    assert len(remarks) == len(notes)
    for line, note in zip(remarks, notes, strict=True):
        assert note in line and "contradict" in line and "use them, and not the score" in line


def test_lost_grips_with_a_high_score_cause_a_note():
    text = describe_ranking(ranking_of((30, 0), *[NOTHING] * 4, (40, 2)))
    assert "note: 2 of 40 grips with score above 0.999 to 1 were held" in text
    assert text.count("note: ") == 1
