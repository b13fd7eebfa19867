"""Rates, reasons and pairs of episodes that are written by hand."""

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from graycast.base.errors import GraycastError
from graycast.robot.pick.outcome import TAKEN, Outcome
from graycast.robot.pick.results.pick_files import StoredEpisode
from graycast.robot.pick.results.summary import COLOR, compared, pair, plot_runs, summarize
from graycast.score.evaluate import mcnemar, wilson


def episode(bin_id, *outcomes, left=0, spilled=0):
    attempts = tuple(
        {"outcome": outcome, "seconds": {"scan": 0.5, "motion": 4.0}} for outcome in outcomes
    )
    taken = sum(outcome == "picked" for outcome in outcomes)
    return StoredEpisode(
        bin_id=bin_id,
        kinds=(0,) * (taken + left + spilled),
        filled=taken + left + spilled,
        taken=taken,
        left=left,
        spilled=spilled,
        attempts=attempts,
        work_s=tuple({"scan": 2.0, "grips": 0.75, "plan": 0.25, "physics": 1.0} for _ in outcomes),
    )


def test_a_part_that_never_moved_is_not_counted_as_gripped():
    total = summarize(
        [
            episode(0, "picked", "lost seal", "nothing found", "picked", spilled=1),
            episode(1, "unreachable", "picked", "collision unseen", left=2),
        ]
    )
    assert (total.grips, total.picked) == (5, 3)
    assert total.rate == (3 / 5, *wilson(3, 5))
    assert (total.filled, total.taken, total.left, total.spilled, total.cleared) == (6, 3, 2, 1, 1)
    assert total.outcomes["picked"] == 3 and sum(total.outcomes.values()) == 7
    # There are 7 attempts of 4.5 s, each with a second of computing.
    assert total.picks_per_hour == pytest.approx(3600 * 3 / (7 * 4.5))
    assert total.picks_per_hour_here == pytest.approx(3600 * 3 / (7 * 5.5))


def test_missed_parts_are_counted():
    one = episode(0, "nothing found", "nothing found", "picked")
    for attempt, detail in zip(
        one.attempts, ("no pose: none fits", "no detection", ""), strict=True
    ):
        attempt["detail"] = detail
    assert summarize([one]).missing == {"no pose: none fits": 1, "no detection": 1}


def test_attempts_in_the_same_bin_are_paired_in_order():
    first = [episode(0, "picked", "lost seal", "picked"), episode(2, "picked")]
    second = [
        episode(0, "nothing found", "lost seal", "picked", "picked", "picked"),
        episode(1, "picked"),
        episode(2, "picked"),
    ]
    paired = pair(first, second)
    assert (paired.pairs, paired.both) == (4, 2)
    assert (paired.only_first, paired.only_second) == (1, 1)
    assert paired.p == mcnemar(1, 1) == 1.0


def test_a_summary_without_attempts_says_that_there_are_none():
    with pytest.raises(GraycastError, match="no bin is finished"):
        summarize([])
    with pytest.raises(GraycastError, match="have no common bin"):
        pair([episode(0, "picked")], [episode(1, "picked")])


def test_runs_are_compared_with_the_first_in_a_table():
    runs = {
        "scanner": [episode(0, "picked", "lost seal")],
        "perfect": [episode(0, "picked", "picked")],
    }
    head, _, first, second = compared(runs).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in (first, second)]
    assert len(head.strip("|").split("|")) == len(cells[0]) == len(cells[1]) == 12
    assert (
        cells[0][:3] == ["scanner", "2", "50.0%"]
        and cells[0][4] == "1 of 1"
        and cells[0][8:] == [""] * 4
    )
    assert cells[1][:3] == ["perfect", "2", "100.0%"] and cells[1][8:] == ["2", "1", "0", "1"]


@pytest.mark.slow
def test_every_failure_has_a_colour_and_an_area_in_proportion_to_its_count(tmp_path):
    """Oracle: the areas of the two failures' colours in the plot have the ratio 3 to 1."""
    assert set(COLOR) == set(Outcome) - set(TAKEN)
    outcomes = ["picked"] * 6 + ["lost seal"] * 3 + ["wrong pose"]
    plot_runs({"run": summarize([episode(0, *outcomes)])}, tmp_path / "runs.png")
    picture = cv2.imread(str(tmp_path / "runs.png"))
    plotted = picture[: int(0.55 * len(picture))]  # without the legend
    apart = {one: np.abs(plotted[..., ::-1] - 255 * np.array(to_rgb(COLOR[one]))) for one in COLOR}
    area = {one: (apart[one].max(axis=2) <= 2).sum() for one in COLOR}
    pose = area[Outcome.WRONG_POSE]
    assert pose > 100 and area[Outcome.LOST_SEAL] == pytest.approx(3 * pose, rel=0.05)
