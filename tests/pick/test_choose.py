"""The order in which grips are tried, if the arm finds no way to the first ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from graycast.frames import rigid
from graycast.optics import Optics
from graycast.pick import choose
from graycast.pick.aim import Aim, Sight, Target
from graycast.pick.choose import Choice
from graycast.pick.clock import Clock
from graycast.pick.outcome import Outcome
from graycast.pick.ready import Ready
from graycast.pick.ways import Blocked, Ways

CAMERA = Optics(width_px=8, height_px=6, fx_px=9.0, fy_px=9.0, cx_px=3.5, cy_px=2.5)
T_WORLD_CAM = rigid(np.eye(3), np.array([0.0, 0.0, -0.5]))
VIEW = Sight(depth_m=np.full((6, 8), 0.5), camera=CAMERA, T_world_cam=T_WORLD_CAM)
TARGET = Target(kind=None, score=1.0, mask=np.ones((6, 8), bool))
# The second grip is on the same face as the first, 20 mm beside it; the third is elsewhere.
FIRST, BESIDE, ELSEWHERE = (np.array([x, 0.0, 0.0]) for x in (0.0, 0.02, 0.1))


def bare(kind, **fields):
    """One of a class with those fields alone."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


@pytest.fixture
def chosen(monkeypatch):
    """`choose` between three grips, whose scores fall from one to the next, and what it sought."""
    sought = []

    def chosen(reached, *, tabu=(), blocked=(), grips=12):
        sought.clear()
        aims = [
            Aim(T_world_tool=rigid(np.eye(3), place), score=score, target=TARGET)
            for place, score in ((FIRST, 0.9), (BESIDE, 0.8), (ELSEWHERE, 0.7))
        ]

        def ways(ready, q, aim, heap, seed):
            sought.append(float(aim.place_m[0]))
            if sought[-1] in reached:
                return bare(Ways)
            return Blocked(outcome=Outcome.UNREACHABLE, detail="too far")

        monkeypatch.setattr(choose, "_aims", lambda *_: aims)
        monkeypatch.setattr(choose, "_Heaps", lambda *_: SimpleNamespace(of=lambda aim: None))
        monkeypatch.setattr(choose, "_unlike", lambda *_: None)
        monkeypatch.setattr(choose, "_blocked_tool", lambda *_: None)
        monkeypatch.setattr(choose, "_ways", ways)
        picking = SimpleNamespace(targets=3, least_score=0.25, grips=grips)
        ready = bare(Ready, cell=SimpleNamespace(config=SimpleNamespace(picking=picking)))
        found = choose.choose(
            ready, VIEW, [TARGET], np.zeros(6), tabu, blocked, seed=0, clock=Clock()
        )
        return found, list(sought)

    return chosen


def test_a_grip_beside_one_without_a_way_waits_for_all_others(chosen):
    found, sought = chosen({0.02, 0.1})
    assert isinstance(found, Choice) and sought == [0.0, 0.1]
    found, sought = chosen({0.02})
    assert isinstance(found, Choice) and sought == [0.0, 0.1, 0.02]


def test_the_next_scan_begins_elsewhere(chosen):
    found, sought = chosen({})
    assert found.outcome is Outcome.UNREACHABLE and sought == [0.0, 0.1, 0.02]
    assert [float(place[0]) for place in found.places_m] == sought
    assert chosen({0.1}, blocked=(FIRST,))[1] == [0.1]
    assert chosen({0.02}, blocked=found.places_m)[1] == [0.0, 0.02]  # all of them again


def test_no_more_ways_are_sought_than_stated(chosen):
    found, sought = chosen({0.02}, grips=2)
    assert isinstance(found, Blocked) and sought == [0.0, 0.1]


def test_where_a_grip_failed_none_is_tried(chosen):
    found, sought = chosen({}, tabu=(FIRST, BESIDE, ELSEWHERE))
    assert found.outcome is Outcome.GIVEN_UP and not sought and not found.places_m


@pytest.mark.parametrize(
    ("found", "depth_m", "posed", "scores", "told"),
    [
        ([], 0.5, True, (), "no detection"),
        ([TARGET], np.nan, True, (), "no depth"),
        ([TARGET], 0.5, False, (), "no pose"),
        ([TARGET], 0.5, True, (), "no grip: the tool fits nowhere"),
        ([TARGET], 0.5, True, (0.1, 0.2), "no grip: all have less than the least score"),
    ],
)
def test_nothing_found_says_what_was_not_found(monkeypatch, found, depth_m, posed, scores, told):
    def aims(ready, targets, view, seed, of_those):
        of_those += targets if posed else []
        return [Aim(T_world_tool=np.eye(4), score=score, target=TARGET) for score in scores]

    monkeypatch.setattr(choose, "_aims", aims)
    monkeypatch.setattr(choose, "_Heaps", lambda *_: None)
    picking = SimpleNamespace(targets=3, least_score=0.25, grips=12)
    ready = bare(Ready, cell=SimpleNamespace(config=SimpleNamespace(picking=picking)))
    view = Sight(depth_m=np.full((6, 8), depth_m), camera=CAMERA, T_world_cam=T_WORLD_CAM)
    got = choose.choose(ready, view, found, np.zeros(6), (), (), seed=0, clock=Clock())
    assert got.outcome is Outcome.NOTHING_FOUND and got.detail.startswith(told)
