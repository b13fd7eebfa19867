"""Grips on shapes with known solutions: boxes, a plate with a hole, a U profile."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from graycast.base.frames import axis_rotation, rigid
from graycast.rig.optics import Optics, rays
from graycast.robot.grasp import (
    Burden,
    Cup,
    DepthView,
    Doubt,
    Jaws,
    SuctionSearch,
    best_first,
    closing,
    jaw_load_factor,
    jaw_places,
    patch_of_mesh,
    robustness,
    suction_places,
)
from graycast.robot.grasp.grip import downs
from graycast.robot.grasp.robust import SHAKE
from graycast.world.parts import Mesh

CUP = Cup(radius_m=0.008, height_m=0.012, vacuum_pa=50e3, friction=0.5)
SURE = Doubt(position_m=0.0, angle_rad=0.0, friction_share=0.0, center_m=0.0)
DOUBT = Doubt()
SIDES_M = (0.040, 0.030, 0.020)


def mesh_of(body):
    return Mesh(vertices_m=np.array(body.vertices), faces=np.array(body.faces))


def box(sides=SIDES_M):
    return mesh_of(trimesh.creation.box(sides))


@pytest.mark.slow
def test_suction_grips_on_a_box_are_a_cup_radius_inside_its_faces():
    places = suction_places(
        box(), CUP, weight_n=0.5, center_m=np.zeros(3), doubt=SURE, count=250, seed=1
    )
    grips = best_first(places)
    half = np.array(SIDES_M) / 2
    for grip in grips:
        T = grip.T_part_tool
        axis = int(np.argmax(np.abs(T[:3, 2])))
        assert abs(T[axis, 2]) == pytest.approx(1)
        assert T[axis, 3] * T[axis, 2] == pytest.approx(half[axis])
        others = [k for k in range(3) if k != axis]
        # The nodes of the patch are 0.5 mm apart, so an edge may be detected 0.5 mm too late.
        assert all(abs(T[k, 3]) <= half[k] - CUP.radius_m + 0.5e-3 for k in others)
    # This share of evenly distributed points is far enough from the edges.
    inner = 2 * sum(
        max(SIDES_M[a] - 0.016, 0) * max(SIDES_M[b] - 0.016, 0) for a, b in ((0, 1), (0, 2), (1, 2))
    )
    area = 2 * (0.04 * 0.03 + 0.04 * 0.02 + 0.03 * 0.02)
    expected = 250 * inner / area
    assert len(grips) == pytest.approx(expected, abs=3 * math.sqrt(expected) + 0.1 * expected)


def test_the_robustness_of_a_cup_follows_a_normal_distribution():
    """A cup near an edge seals if the tool's error is smaller than the remaining distance."""
    left_m = 1.0e-3
    plate = mesh_of(trimesh.creation.box((0.1, 0.1, 0.002)))
    T = rigid(np.eye(3), np.array([0.05 - CUP.radius_m - left_m, 0.0, 0.001]))
    patch = patch_of_mesh(plate, T, radius_m=0.012, step_m=0.2e-3)
    burden = Burden(weight_n=0.1, center_m=np.zeros(3), down=np.array([0, 0, -1.0]))
    doubt = Doubt(position_m=1e-3, angle_rad=0.0, friction_share=0.0, center_m=0.0)
    share = robustness(CUP, patch, [burden], doubt, seed=0, chances=500)
    law = 0.5 * (1 + math.erf(1 / math.sqrt(2)))  # P(off < 1 sigma), along x only
    assert share == pytest.approx(law, abs=4 * math.sqrt(law * (1 - law) / 500))


def test_the_uncertainty_of_a_cup_s_position_changes_the_load_s_lever_arm():
    """The load is 0.5 mm closer to the axis than the tilt limit. Oracle: a normal law of 1 mm."""
    plate = mesh_of(trimesh.creation.box((0.1, 0.1, 0.002)))
    patch = patch_of_mesh(
        plate, rigid(np.eye(3), np.array([0, 0, 1e-3])), radius_m=0.012, step_m=5e-4
    )
    center = np.array([tilting_m(1.0) - 0.5e-3, 0.0, 0.0])
    burden = Burden(weight_n=1.0, center_m=center, down=np.array([0, 0, -1.0]))
    doubt = Doubt(position_m=1e-3, angle_rad=0.0, friction_share=0.0, center_m=0.0)
    share = robustness(CUP, patch, [burden], doubt, seed=0, chances=500)
    law = norm.cdf(0.5)
    assert share == pytest.approx(law, abs=4 * math.sqrt(law * (1 - law) / 500))


def tilting_m(weight_n):
    """Return the distance at which a weight tilts an upright cup: load d = (pull - load) r / 2."""
    load_n = SHAKE * weight_n
    return (CUP.pull_n - load_n) * CUP.radius_m / 2 / load_n


def test_a_tool_may_tilt_by_30_degrees_to_each_side():
    down = downs()
    np.testing.assert_allclose(np.linalg.norm(down, axis=1), 1)
    np.testing.assert_allclose(down[:, 2], [-1, *[-math.cos(math.pi / 6)] * 4])
    turn = np.sort(np.arctan2(down[1:, 1], down[1:, 0]))
    np.testing.assert_allclose(np.diff(turn), math.pi / 2)


@pytest.mark.slow
def test_a_heavy_part_is_gripped_near_its_centre_of_mass():
    """A part tilts the cup off if weight * SHAKE * distance exceeds N r / 2."""
    long = box((0.2, 0.03, 0.02))
    weight_n, center = 1.0, np.array([0.03, 0.0, 0.0])
    places = suction_places(
        long, CUP, weight_n=weight_n, center_m=center, doubt=SURE, count=150, seed=2
    )
    top = [g.T_part_tool for g in best_first(places) if abs(g.T_part_tool[2, 2]) > 0.9]
    # Leaning adds to the moment, so no grip is farther away than an upright tool permits.
    reach = max(abs(T[0, 3] - center[0]) for T in top)
    assert 0.3 * tilting_m(weight_n) < reach <= tilting_m(weight_n)
    # The choice of the part's frame must not change the grips.
    R = Rotation.from_euler("xyz", [0.4, 1.2, -0.7]).as_matrix()
    turned = Mesh(vertices_m=long.vertices_m @ R.T, faces=long.faces)
    again = suction_places(
        turned, CUP, weight_n=weight_n, center_m=R @ center, doubt=SURE, count=150, seed=2
    )
    same = [one.score == other.score for one, other in zip(places, again, strict=True)]
    assert np.mean(same) > 0.99  # A node may be exactly on an edge.
    assert 0.02 < np.mean([one.score > 0 for one in places]) < 0.98


JAWS = Jaws(opening_m=0.05, force_n=40.0, friction=0.3, finger_m=(0.006, 0.010, 0.040))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opening_m", "sides_mm"), [(0.050, {20, 30, 40}), (0.035, {20, 30}), (0.033, {20})]
)
def test_jaws_grip_a_box_on_parallel_faces_that_fit_between_the_pads(opening_m, sides_mm):
    """The open pads need 2 mm of clearance on both sides."""
    jaws = replace(JAWS, opening_m=opening_m)
    places = jaw_places(
        box(), jaws, weight_n=0.5, center_m=np.zeros(3), doubt=SURE, count=40, chances=1
    )
    assert {round(1e3 * grip.opening_m, 6) for grip in best_first(places)} == sides_mm


@pytest.mark.slow
def test_the_palm_limits_how_far_a_part_extends_between_the_fingers():
    """The palm is 36 mm above the pads' centre: the finger's length minus the pad's radius."""
    tall = box((0.01, 0.02, 0.12))
    places = jaw_places(
        tall, JAWS, weight_n=0.1, center_m=np.zeros(3), doubt=SURE, count=50, chances=1
    )
    # These grips point along the part's long axis, away from its centre.
    upright = [g.T_part_tool for g in best_first(places) if abs(g.T_part_tool[2, 2]) > 0.99]
    above = [0.06 - T[2, 3] * np.sign(T[2, 2]) for T in upright]
    assert 0.030 < max(above) <= 0.036 + 1e-9


@pytest.mark.slow
def test_a_jaw_grip_s_score_is_the_probability_of_sufficient_friction():
    """Oracle: the normal law of friction, at the planned grip's safety factor in its worst tilt."""
    doubt = Doubt(position_m=0.0, angle_rad=0.0, friction_share=0.15, center_m=0.0)
    weight_n, chances = 5.0, 50
    places = jaw_places(
        box(), JAWS, weight_n=weight_n, center_m=np.zeros(3), doubt=doubt, count=3, chances=chances
    )
    between = 0
    for grip in places:
        T = grip.T_part_tool
        load_n = SHAKE * weight_n * downs()
        arm = np.broadcast_to(-T[:3, 3] @ T[:3, :3], load_n.shape)
        factor = jaw_load_factor(JAWS, load_n, np.cross(arm, load_n)).min()
        law = norm.cdf((1 - 1 / factor) / 0.15)
        if grip.score > 0 or law < 1 / chances:
            error = math.sqrt(law * (1 - law) / chances)
            assert grip.score == pytest.approx(law, abs=4 * error + 1 / chances)
            between += 0.05 < law < 0.95
    assert between >= 2


@pytest.mark.slow
def test_a_jaw_grip_s_score_includes_the_probability_that_two_pads_touch_the_part():
    """Oracle: two normal laws. The centre of a pad must stay on the face, and the part must stay
    between the open pads, with 2 mm of clearance on each side."""
    doubt = Doubt(position_m=1e-3, angle_rad=0.0, friction_share=0.0, center_m=0.0)
    places = jaw_places(
        box(), JAWS, weight_n=0.1, center_m=np.zeros(3), doubt=doubt, count=80, chances=150
    )
    half, near_edge = np.array(SIDES_M) / 2, 0
    for grip in places:
        R, middle = grip.T_part_tool[:3, :3], grip.T_part_tool[:3, 3]
        if grip.score == 0 or np.abs(R).max(axis=0).min() < 0.999:
            continue  # This grip has a collision, or it is not parallel to the edges.
        room = [half[np.abs(R[:, k]).argmax()] - abs(middle @ R[:, k]) for k in (1, 2)]
        if max(room) < JAWS.pad_radius_m + 3e-3:
            continue  # At a corner, both edges cut the pad's disc.
        expected = norm.cdf(min(room) / 1e-3) * (2 * norm.cdf(2) - 1)
        error = math.sqrt(expected * (1 - expected) / 150)
        assert grip.score == pytest.approx(expected, abs=4 * error + 1 / 150)
        near_edge += expected < 0.9
    assert near_edge >= 2  # Some grips are near an edge.


@pytest.mark.slow
def test_no_finger_of_a_jaw_grip_overlaps_the_part():
    """In a U of 3 mm walls that are 10 mm apart, a finger of 6 mm with 2 mm clearance just fits."""
    walls = [
        trimesh.creation.box((0.040, 0.020, 0.003)),
        trimesh.creation.box((0.003, 0.020, 0.030), rigid(np.eye(3), np.array([0.0185, 0, 0.015]))),
        trimesh.creation.box(
            (0.003, 0.020, 0.030), rigid(np.eye(3), np.array([-0.0185, 0, 0.015]))
        ),
    ]
    u = mesh_of(trimesh.boolean.union(walls))
    places = jaw_places(
        u, JAWS, weight_n=0.3, center_m=np.zeros(3), doubt=SURE, count=100, chances=1
    )
    grips = best_first(places)
    assert any(grip.opening_m == pytest.approx(0.003) for grip in grips)  # around one wall
    points = trimesh.sample.sample_surface(trimesh.Trimesh(u.vertices_m, u.faces), 5000, seed=1)[0]
    for grip in grips[:50]:
        local = (points - grip.T_part_tool[:3, 3]) @ grip.T_part_tool[:3, :3]
        beside = np.abs(np.abs(local[:, 0]) - grip.opening_m / 2 - 0.003) < 0.0028
        inside = beside & (np.abs(local[:, 1]) < 0.0048) & (local[:, 2] > -0.003)
        assert not (inside & (local[:, 2] < 0.035)).any()


@pytest.mark.parametrize(
    ("force_n", "point_m", "limit"),
    [
        ((0, 0, -1.5), (0, 0, -0.03), 2 * 0.3 * 40 / 1.5),  # The part hangs below the pads.
        ((-1, 0, 0), (0, 0, 0), math.inf),  # The drive resists forces along the axis.
        ((0, 0, -1), (0, 0.01, 0), 24 / math.hypot(1, 0.01 / (2 / 3 * 0.004))),
    ],
)
def test_the_holding_force_of_jaws_agrees_with_a_hand_calculation(force_n, point_m, limit):
    factor = jaw_load_factor(
        JAWS, np.array([force_n], float), np.cross([point_m], [force_n]) * 1.0
    )[0]
    assert factor == pytest.approx(limit)


CAMERA = Optics(width_px=240, height_px=200, fx_px=500.0, fy_px=500.0, cx_px=119.5, cy_px=99.5)
LOOKING_DOWN = rigid(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


def plate_depth(tilt_rad=0.0):
    """Return the depth of a plane through (0, 0, 0.6) after a rotation about x."""
    y, x = np.mgrid[:200, :240].astype(float)
    ray = rays(CAMERA, np.stack([x, y], axis=-1))
    normal = axis_rotation("x", tilt_rad) @ np.array([0, 0, -1.0])
    return (0.6 * normal[2]) / (ray @ normal)


def search(depth_m, weight_n, doubt):
    view = DepthView(depth_m=depth_m, camera=CAMERA, T_world_cam=LOOKING_DOWN)
    return SuctionSearch(view=view, cup=CUP, weight_n=weight_n, doubt=doubt)


@pytest.mark.slow
def test_a_heavier_part_is_gripped_closer_to_the_centre_of_its_mask():
    """The weight is not along the axis; its component across the axis tilts the cup."""
    lean_rad, weight_n = 0.6, 1.0
    depth_m = plate_depth(lean_rad)
    mask = np.zeros(depth_m.shape, bool)
    mask[60:140, 80:160] = True
    grips = search(depth_m, weight_n, SURE).grips(mask)
    rows, columns = np.nonzero(mask)
    point = rays(CAMERA, np.stack([columns, rows], axis=-1).astype(float)) * depth_m[mask][:, None]
    press_n = SHAKE * weight_n * math.cos(lean_rad)
    most_m = (CUP.pull_n - press_n) * CUP.radius_m / 2 / press_n
    away_m = [np.linalg.norm(grip.T_cam_tool[:3, 3] - point.mean(axis=0)) for grip in grips]
    assert 0.8 * most_m < max(away_m) <= most_m < np.ptp(point[:, 0]) / 2
    normal = axis_rotation("x", lean_rad) @ np.array([0, 0, -1.0])
    for grip in grips:
        T = grip.T_cam_tool
        np.testing.assert_allclose(T[:3, 2], normal, atol=1e-6)
        x, y = CAMERA.fx_px * T[:2, 3] / T[2, 3] + [119.5, 99.5]
        assert mask[round(y), round(x)]
    # The plate is tilted by more than 45 degrees.
    assert not search(plate_depth(0.9), 0.5, DOUBT).grips(mask, count=20)


@pytest.mark.slow
def test_no_grip_is_planned_where_depth_is_missing():
    """Holes in a grid that is finer than the cup leave no position."""
    depth_m = plate_depth()
    mask = np.ones(depth_m.shape, bool)
    mask[:20], mask[-20:], mask[:, :20], mask[:, -20:] = False, False, False, False
    holed = depth_m.copy()
    holed[::8, ::8] = np.nan  # The holes are 9.6 mm apart, and the cup is 16 mm wide.
    assert not search(holed, 0.5, DOUBT).grips(mask)
    half = depth_m.copy()
    half[::8, 120::8] = np.nan
    grips = search(half, 0.5, SURE).grips(mask)
    assert grips
    for grip in grips:
        x = CAMERA.fx_px * grip.T_cam_tool[0, 3] / grip.T_cam_tool[2, 3] + 119.5
        assert x < 120 - 0.9 * 500 * CUP.radius_m / 0.6


def test_no_grip_is_planned_on_depth_that_is_probably_wrong():
    """The right half of a plate is wrong with p 0.2, and its left half with p 0.05."""
    depth_m = plate_depth()
    mask = np.ones(depth_m.shape, bool)
    mask[:20], mask[-20:], mask[:, :20], mask[:, -20:] = False, False, False, False
    plain = search(depth_m, 0.5, SURE)
    p_wrong = np.full(depth_m.shape, 0.05)
    p_wrong[:, 120:] = 0.2
    doubted = replace(plain, view=replace(plain.view, p_wrong=p_wrong))
    columns = [
        np.array([500 * g.T_cam_tool[0, 3] / g.T_cam_tool[2, 3] + 119.5 for g in s.grips(mask)])
        for s in (plain, doubted)
    ]
    assert columns[0].max() > 120
    assert len(columns[1]) and columns[1].max() < 120 - 0.9 * 500 * CUP.radius_m / 0.6
    assert np.isfinite(doubted.view.depth_m).all()  # Obstacles remain.


@pytest.mark.slow
def test_the_same_seed_gives_the_same_grips():
    mask = np.zeros((200, 240), bool)
    mask[80:120, 100:140] = True
    first, second = (
        search(plate_depth(0.2), 0.5, DOUBT).grips(mask, seed=3, count=20) for _ in range(2)
    )
    assert [g.score for g in first] == [g.score for g in second]
    assert all((a.T_cam_tool == b.T_cam_tool).all() for a, b in zip(first, second, strict=True))


def test_objects_beyond_an_open_pad_are_not_between_the_pads():
    """A plate of 10 mm is between pads 20 mm apart, and another plate is 6 mm beyond a pad."""
    near = trimesh.creation.box((0.010, 0.04, 0.04))
    far = trimesh.creation.box((0.004, 0.04, 0.04), rigid(np.eye(3), np.array([0.018, 0.0, 0.0])))
    both = mesh_of(trimesh.util.concatenate([near, far]))
    jaws = Jaws(opening_m=0.06)
    T = rigid(np.eye(3), np.array([0.002, 0.0, 0.0]))  # 2 mm from the plate's centre
    aside_m, slope, _ = closing(both, jaws, T, opening_m=0.020)
    assert aside_m == pytest.approx(-0.002)
    assert slope == pytest.approx(0, abs=1e-6)
    aside_m, *_ = closing(both, jaws, T, opening_m=0.040)  # Both plates are between these pads.
    assert aside_m == pytest.approx(0.0075 - 0.002)
    beyond = rigid(np.eye(3), np.array([-0.020, 0.0, 0.0]))
    assert closing(both, jaws, beyond, opening_m=0.020) is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["suction", "jaws"])
def test_candidates_include_successful_and_unsuccessful_grips(kind):
    known = {"weight_n": 0.5, "center_m": np.zeros(3), "doubt": DOUBT, "count": 24}
    if kind == "suction":
        places = suction_places(box(), CUP, **known)
        assert len(places) == 24
    else:
        places = jaw_places(box(), JAWS, **known, chances=6)
        # All sides except the longest leave clearance; the fingers approach in 8 directions.
        assert len(places) % 8 == 0
    grips = best_first(places)
    assert 0 < len(grips) < len(places)
    expected = [place for place in places if place.score > 0]
    assert sorted((g.score for g in grips), reverse=True) == [g.score for g in grips]
    assert {g.T_part_tool.tobytes() for g in grips} == {g.T_part_tool.tobytes() for g in expected}


@pytest.mark.slow
@pytest.mark.parametrize(("hole_m", "inside"), [(0.020, True), (0.007, False)])
def test_a_wall_is_gripped_from_inside_if_the_hole_has_room_for_a_finger(hole_m, inside):
    """The walls of a square tube are 4 mm thick; a finger of 6 mm needs 2 mm clearance."""
    outer = trimesh.creation.box((hole_m + 0.008, hole_m + 0.008, 0.03))
    tube = mesh_of(outer.difference(trimesh.creation.box((hole_m, hole_m, 0.04))))
    places = jaw_places(tube, JAWS, weight_n=0.2, center_m=np.zeros(3), doubt=SURE, count=300)
    grips = best_first(places)
    walls = [grip for grip in grips if grip.opening_m == pytest.approx(0.004)]
    assert bool(walls) == inside
    for grip in walls:
        assert abs(grip.T_part_tool[2, 2]) > 0.7  # The finger enters the open end of the tube.
        aside_m, *_ = closing(tube, JAWS, grip.T_part_tool, opening_m=0.008)
        assert aside_m == pytest.approx(0, abs=1e-9)
    assert any(grip.opening_m == pytest.approx(hole_m + 0.008) for grip in grips)


def stepped(step_m, begins_m):
    """Return a block between pads 20 mm apart, with a step on one side that begins at a given y."""
    block = trimesh.creation.box((0.020, 0.06, 0.03))
    middle = np.array([0.010 + step_m / 2 - 0.5e-3, begins_m + 0.005, 0.0])
    step = trimesh.creation.box((step_m + 1e-3, 0.010, 0.03), rigid(np.eye(3), middle))
    return mesh_of(trimesh.boolean.union([block, step]))


@pytest.mark.parametrize(
    ("step_m", "begins_m", "ahead_m"),
    [
        (1.5e-3, 0.0042, 1.5e-3),  # The step is next to the pad (4 mm), under the finger (10 mm).
        (0.4e-3, 0.0042, 0.4e-3),
        (1.5e-3, 0.0052, 0.0),  # The step is next to the finger, too.
        (9.0e-3, 0.0042, 5.0e-3),  # The step extends behind the open finger, which is 5 mm away.
    ],
)
def test_a_step_next_to_the_pad_meets_the_finger_first(step_m, begins_m, ahead_m):
    contact = closing(stepped(step_m, begins_m), JAWS, np.eye(4), opening_m=0.030)
    assert contact.ahead_m == pytest.approx(ahead_m, abs=1e-9)
    assert contact.on_pads == (ahead_m < 0.5e-3)
    assert contact.slope == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("lean_rad", [0.0, 0.05, 0.2])
def test_a_finger_is_aligned_with_an_inclined_flat_face(lean_rad):
    """A finger is aligned with the flat face that its pad touches, at any tilt of the face."""
    T = rigid(axis_rotation("z", lean_rad), np.zeros(3))
    contact = closing(box((0.02, 0.08, 0.03)), JAWS, T, opening_m=0.048)
    assert contact.ahead_m == pytest.approx(0, abs=1e-9)
    assert contact.slope == pytest.approx(math.tan(lean_rad))


def test_a_flat_finger_touches_a_hollow_face_with_its_edges():
    """Oracle: heights of a circle. The outermost lines of a pad are at 0.95 of its radius."""
    radius_m, sides = 0.010, 720
    turn = 2 * np.pi * np.arange(sides) / sides
    circle = radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    outside = [[0.03, -0.02], [0.03, 0.02], [-0.03, 0.02], [-0.03, -0.02]]
    solid = CrossSection([1e3 * np.asarray(outside)]) - CrossSection([1e3 * circle])
    wall = solid.extrude(40.0).to_mesh64()
    mesh = Mesh(vertices_m=1e-3 * wall.vert_properties[:, :3], faces=wall.tri_verts)
    # One finger is in the bore, and the other is next to the block, 20 mm away.
    T = rigid(np.eye(3), np.array([0.020, 0.0, 0.020]))
    contact = closing(mesh, replace(JAWS, opening_m=0.03), T, opening_m=0.024)
    height = [math.sqrt(radius_m**2 - y**2) for y in (0.95 * JAWS.pad_radius_m, 0.005)]
    assert contact.ahead_m == pytest.approx(height[0] - height[1], abs=5e-6)
