"""The order in which grips are tried, the grips that are not tried, and the recorded outcome."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.frames import axis_rotation, inverse, pixel_grid, rigid
from graycast.rig.optics import Optics, rays
from graycast.robot.grasp import DepthView, Grip
from graycast.robot.pick import load_pick_config, resolve_pick_cell
from graycast.robot.pick.arm.obstacles import standing
from graycast.robot.pick.arm.robot import Robot
from graycast.robot.pick.arm.ways import Blocked, Load, Surroundings, Ways, WaySearch
from graycast.robot.pick.bin import choose
from graycast.robot.pick.bin.aim import Candidate, KnownPart
from graycast.robot.pick.bin.choose import Choice
from graycast.robot.pick.bin.clock import Clock
from graycast.robot.pick.bin.ready import Ready
from graycast.robot.pick.outcome import Outcome
from graycast.robot.pick.tool.tools import T_flange_tip
from graycast.robot.pose import pose_model

CAMERA = Optics(width_px=160, height_px=120, fx_px=300.0, fy_px=300.0, cx_px=79.5, cy_px=59.5)
LOOKING_DOWN = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.6]))
# The part of 60 x 40 x 30 mm is in the middle of the bin, in a layer of the same height.
TOP_M = 0.03
T_CAM_PART = inverse(LOOKING_DOWN) @ rigid(np.eye(3), np.array([0.0, 0.0, TOP_M / 2]))
EVERYWHERE = np.ones((120, 160), bool)
TARGET = Candidate(kind=0, score=1.0, mask=EVERYWHERE, T_cam_part=T_CAM_PART)
# The second grip is on the same face as the first, 20 mm away; the third grip is elsewhere.
FIRST, BESIDE, ELSEWHERE = (np.array([x, 0.0, TOP_M]) for x in (0.0, 0.02, 0.08))


def bare(kind, **fields):
    """Return an object of a class that has only these fields."""
    result = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(result, name, value)
    return result


def grips(*scores):
    """Return upright grips with tips at the three positions."""
    places = (FIRST, BESIDE, ELSEWHERE)
    return tuple(
        Grip(T_part_tool=rigid(np.eye(3), place - [0, 0, TOP_M / 2]), score=score)
        for place, score in zip(places, scores, strict=False)
    )


@pytest.fixture(scope="module")
def ready(tmp_path_factory):
    """Return the data that a choice needs, without the libraries for robots."""
    folder = tmp_path_factory.mktemp("cell")
    path = write_cell(folder, tool={"kind": "suction"}, picking={"pose": "truth"})
    cell = resolve_pick_cell(load_pick_config(path), folder)
    part = cell.cell.scene.parts[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graycast.robot.pose.closest.CELLS", 20)  # No pose is estimated.
        model = pose_model(part.mesh, part.symmetry)
    return bare(
        Ready,
        cell=cell,
        known={0: KnownPart(model=model, grips=grips(0.9, 0.8, 0.7))},
        load=Load(below_m=0.08, aside_m=0.04),
        bodies=(SimpleNamespace(mass_kg=0.05),),
        robot=bare(Robot),
    )


def like(ready, **changes):
    """Return `ready` with other fields, or with other keys of its section `picking`."""
    fields = {name: getattr(ready, name) for name in ("cell", "known", "load", "bodies", "robot")}
    words = {name: changes.pop(name) for name in ("knows", "grips") if name in changes}
    config = ready.cell.config
    picking = config.picking.model_copy(update=words)
    cell = replace(ready.cell, config=config.model_copy(update={"picking": picking}))
    return bare(Ready, **fields | {"cell": cell} | changes)


def scan(*bumps, lean_rad=0.0):
    """Return a scan of a flat layer, inclined about x, that is higher or lower at some places."""
    ray = rays(CAMERA, pixel_grid(120, 160)) @ LOOKING_DOWN[:3, :3].T
    normal = axis_rotation("x", lean_rad)[:, 2]
    depth = normal @ (FIRST - LOOKING_DOWN[:3, 3]) / (ray @ normal)
    place = LOOKING_DOWN[:3, 3] + ray * depth[..., None]
    for (about, radius_m), higher_m in bumps:
        depth[np.linalg.norm(place - about, axis=-1) < radius_m] -= higher_m
    return DepthView(depth_m=depth, camera=CAMERA, T_world_cam=LOOKING_DOWN)


def choice_of(ready, view, candidates=(TARGET,), *, tabu=(), blocked=()):
    return choose.choose(
        ready, view, list(candidates), np.zeros(6), tabu, blocked, seed=0, clock=Clock()
    )


@pytest.fixture
def reaching(robots, ready, monkeypatch):
    """Choose among the three grips with an arm that reaches only some of them.

    The fixture records the requests: the tip's pose, and the height and size of the load.
    """
    tool = ready.cell.config.tool
    here = Surroundings(
        T_base_world=np.eye(4), T_flange_tip=T_flange_tip(tool),
        standing=standing(ready.cell.cell.scene, np.eye(4)), q_place=np.zeros(6),
        approach_m=0.06, straight_m_s=0.25, lift_off_m_s=0.05,
    )  # fmt: skip

    def reaching(*reached, view=None, candidates=(TARGET,), tabu=(), blocked=(), **changes):
        sought = []

        def ways(search, q, tip, *, round_tool):
            sought.append((tip, search, round_tool))
            if any(abs(tip[0, 3] - place[0]) < 1e-6 for place in reached):
                return bare(Ways)
            return Blocked(outcome=Outcome.UNREACHABLE, detail="too far")

        monkeypatch.setattr(WaySearch, "ways", ways)
        view = scan() if view is None else view
        setup = like(ready, here=here, **changes)
        return choice_of(setup, view, candidates, tabu=tabu, blocked=blocked), sought

    return reaching


def places(sought):
    return [round(float(tip[0, 3]), 6) for tip, *_ in sought]


def test_a_grip_near_an_unreachable_grip_is_tried_last(reaching):
    result, sought = reaching(BESIDE, ELSEWHERE)
    assert isinstance(result, Choice) and places(sought) == [0.0, 0.08]
    np.testing.assert_allclose(result.aim.place_m, ELSEWHERE, atol=1e-9)
    result, sought = reaching(BESIDE)
    assert isinstance(result, Choice) and places(sought) == [0.0, 0.08, 0.02]


def test_the_next_scan_starts_with_grips_that_were_not_tried(reaching):
    result, sought = reaching()
    assert result.outcome is Outcome.UNREACHABLE and places(sought) == [0.0, 0.08, 0.02]
    assert [round(float(place[0]), 6) for place in result.places_m] == places(sought)
    assert places(reaching(ELSEWHERE, blocked=(FIRST,))[1]) == [0.08]
    assert places(reaching(BESIDE, blocked=result.places_m)[1]) == [0.0, 0.02]  # from the beginning


def test_the_number_of_planned_paths_is_limited(reaching):
    result, sought = reaching(BESIDE, grips=2)
    assert isinstance(result, Blocked) and places(sought) == [0.0, 0.08]


def test_no_grip_is_tried_near_a_failed_grip(reaching):
    result, sought = reaching(tabu=(FIRST, BESIDE, ELSEWHERE))
    assert result.outcome is Outcome.GIVEN_UP and not sought and not result.places_m
    assert places(reaching(tabu=(FIRST,))[1]) == [0.02, 0.08]


@pytest.mark.parametrize(
    ("higher_m", "outcome", "words"),
    [
        (0.006, Outcome.COLLISION_SEEN, "an object is at the place of the cup"),
        (-0.006, Outcome.NOTHING_FOUND, "the part is not at the place of the cup"),
    ],
)
def test_no_path_is_planned_if_depth_shows_another_surface(reaching, higher_m, outcome, words):
    """The deviation is next to the centres of all three cups; 2 mm are permitted."""
    aside = [(np.array([x, 0, TOP_M]), 0.007) for x in (0.01, 0.07)]
    result, sought = reaching(view=scan(*((place, higher_m) for place in aside)))
    assert result.outcome is outcome and result.detail == words and not sought
    assert reaching(view=scan(*((place, higher_m / 3) for place in aside)))[1]


def test_no_path_is_planned_if_the_tool_would_collide_with_the_heap(reaching):
    """A tower is 25 mm from the tool's axis; the radius of the tube is 12 mm."""
    tower = (np.array([-0.025, 0, TOP_M]), 0.011)
    result, sought = reaching(ELSEWHERE, view=scan((tower, 0.05)))
    assert isinstance(result, Choice) and places(sought) == [0.02, 0.08]
    assert places(reaching(FIRST, view=scan((tower, 0.01)))[1]) == [0.0]


def test_a_known_part_is_lifted_above_the_rim_by_its_own_size(reaching):
    """The part extends 30 mm down from the centre of its top, and half its diagonal sideways."""
    ((_, search, round_tool),) = reaching(FIRST)[1]
    assert search.load.below_m == pytest.approx(0.03)
    assert search.load.aside_m == pytest.approx(np.hypot(0.03, 0.02))
    assert search.up_m == pytest.approx(0.1 + 0.03 + 0.05 - TOP_M)  # rim, part, clearance
    assert round_tool


@pytest.mark.parametrize("lean_rad", [0.0, 0.3])
def test_an_unknown_part_extends_at_most_down_to_the_floor(reaching, lean_rad):
    """Oracle: the lowest of all points that are within the part's size of the tip and above the
    floor, after the tool has become upright."""
    unknown = (Candidate(kind=None, score=1.0, mask=few(9)),)
    view = scan(lean_rad=lean_rad)
    ((tip, search, _),) = reaching(candidates=unknown, view=view, knows="depth", grips=1)[1]
    assert tip[2, 2] == pytest.approx(np.cos(lean_rad))
    aside, up = np.mgrid[-0.08:0.08:400j, -0.08:0.08:400j]
    there = (np.hypot(aside, up) <= 0.08) & (up >= -tip[2, 3])
    deepest_m = (np.cos(lean_rad) * -up + np.sin(lean_rad) * aside)[there].max()
    assert deepest_m - 0.001 < search.load.below_m < deepest_m + 0.003


def few(pixels):
    """Return a mask of a few pixels in the middle of the picture."""
    mask = np.zeros(EVERYWHERE.shape, bool)
    mask[60, 80 : 80 + pixels] = True
    return mask


UPSIDE_DOWN = T_CAM_PART @ rigid(axis_rotation("x", np.pi), np.zeros(3))


@pytest.mark.parametrize(
    ("candidates", "depth_m", "scores", "message"),
    [
        ([], 0.57, (), "no detection"),
        ([TARGET], np.nan, (), "no depth"),
        (
            [Candidate(kind=0, score=1.0, mask=few(1))],
            0.57,
            (),
            "no pose",
        ),
        ([replace(TARGET, T_cam_part=UPSIDE_DOWN)], 0.57, (0.9,), "no grip: the tool fits nowhere"),
        ([TARGET], 0.57, (0.1, 0.2), "no grip: all have less than the least score"),
    ],
)
def test_a_failed_detection_names_the_reason(ready, candidates, depth_m, scores, message):
    known = {0: replace(ready.known[0], grips=grips(*scores))}
    view = replace(scan(), depth_m=np.full((120, 160), depth_m))
    got = choice_of(like(ready, known=known), view, candidates)
    assert got.outcome is Outcome.NOTHING_FOUND and got.detail.startswith(message)
