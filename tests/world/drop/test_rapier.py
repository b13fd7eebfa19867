import numpy as np
import pytest
import trimesh

from graycast.base.frames import axis_rotation, rigid
from graycast.world.drop import rapier, rest
from graycast.world.drop.body import body_of, motion_m, parts_outside
from graycast.world.drop.decomposition import hull_of
from graycast.world.drop.rest import simulate
from graycast.world.scene import Bin

from .conftest import RING_INNER_M, RING_OUTER_M, as_part, box_part

BIN = Bin(inner_m=(0.4, 0.3, 0.1))


def body_of_box(size_m, friction=0.4):
    part = box_part(size_m, friction)
    return body_of(part, (hull_of(part.mesh.vertices_m),))


def at(*xyz_m, turn=None):
    return rigid(np.eye(3) if turn is None else turn, np.array(xyz_m, dtype=float))[None]


def test_mass_and_inertia_of_a_box_and_a_ring_agree_with_textbooks(ring_part):
    shape = trimesh.creation.box((0.02, 0.04, 0.06))
    shape.apply_translation((0.1, -0.2, 0.3))
    body = body_of(as_part(shape, "box"), ())
    mass = 2700 * 0.02 * 0.04 * 0.06
    assert body.mass_kg == pytest.approx(mass)
    assert body.center_m == pytest.approx([0.1, -0.2, 0.3])
    squares = np.array([0.04**2 + 0.06**2, 0.02**2 + 0.06**2, 0.02**2 + 0.04**2])
    assert body.inertia_kg_m2 == pytest.approx(np.diag(mass / 12 * squares), abs=1e-12)
    ring = body_of(ring_part, ())
    about_axis = ring.mass_kg / 2 * (RING_INNER_M**2 + RING_OUTER_M**2)
    assert ring.inertia_kg_m2[2, 2] == pytest.approx(about_axis, rel=4e-3)  # 64 sides


def test_the_engine_uses_the_given_mass_centre_and_principal_moments():
    shape = trimesh.creation.box((0.02, 0.04, 0.06))
    shape.apply_transform(rigid(axis_rotation("x", 0.5), np.array([0.01, 0.02, 0.03])))
    part = as_part(shape, "box")
    body = body_of(part, (hull_of(part.mesh.vertices_m),))
    kinds = [rapier.RapierPart.of(body)]
    heap = rapier.open_heap(rest._FALL, BIN, kinds, at(0, 0, 1), np.zeros(1, int))
    heap.run(rapier.STEP_S)
    inside = heap.world.rigid_bodies[heap.parts[0]].mass_properties
    assert inside.mass == pytest.approx(body.mass_kg, rel=1e-5)
    assert inside.local_com.to_tuple() == pytest.approx([0.2, 0.4, 0.6], rel=1e-5)
    frame = inside.principal_inertia_local_frame
    axes = np.array([frame.transform_point(axis).to_tuple() for axis in np.eye(3).tolist()]).T
    moments = axes @ np.diag(inside.principal_inertia.to_tuple()) @ axes.T
    largest = np.abs(body.inertia_kg_m2).max() * 400
    assert moments == pytest.approx(body.inertia_kg_m2 * 400, abs=1e-4 * largest)


def test_a_dropped_box_rests_flat_at_half_its_side():
    turn = axis_rotation("x", 0.1) @ axis_rotation("y", 0.2)
    layout = simulate(
        BIN, (body_of_box((0.04,) * 3),), at(0.02, 0.0, 0.15, turn=turn), np.zeros(1, int),
        simulated_s=5.0,
    )  # fmt: skip
    (T,) = layout.T_world_part
    assert layout.at_rest and layout.outside == 0
    assert layout.last_motion_m <= rest.STILL_MOTION_M
    assert T[2, 3] == pytest.approx(0.02, abs=0.3e-3)
    assert np.abs(T[2, :3]).max() == pytest.approx(1, abs=1e-5)  # one of its axes is vertical
    assert layout.deepest_penetration_m < 0.1e-3


@pytest.mark.parametrize("angle_deg, holds", [(12.5, True), (19.5, False)])
def test_a_slab_slides_only_above_the_friction_angle(monkeypatch, angle_deg, holds):
    """Oracle: Coulomb, atan 0.3 = 16.7 deg; 13.1 deg with the reduced friction after the release.

    The floor is tilted by tilting gravity.
    """
    upright = rapier._world

    def tilted(stage):
        world, angle = upright(stage), np.deg2rad(angle_deg)
        world.gravity = tuple(196.2 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        return world

    monkeypatch.setattr(rapier, "_world", tilted)
    box = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.2)
    body = body_of_box((0.06, 0.06, 0.01), friction=0.4)
    layout = simulate(box, (body,), at(-0.1, 0, 0.0053), np.zeros(1, int), simulated_s=3.0)
    moved = layout.T_world_part[0, 0, 3] + 0.1
    assert moved < 1e-3 if holds else moved == pytest.approx(0.27, abs=2e-3)  # at the far wall


def test_a_part_that_needs_more_than_nine_tenths_of_its_friction_is_not_at_rest(monkeypatch):
    """At 13.8 degrees, the engine's 6/7 of 0.3 holds the slab (up to 14.4), but nine tenths of that
    does not (up to 13.0), so the slab creeps on.
    """
    upright, angle = rapier._world, np.deg2rad(13.8)

    def tilted(terms):
        world = upright(terms)
        world.gravity = tuple(196.2 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        return world

    monkeypatch.setattr(rapier, "_world", tilted)
    box = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.2)
    body = body_of_box((0.06, 0.06, 0.01), friction=0.4)
    layout = simulate(box, (body,), at(-0.1, 0, 0.0053), np.zeros(1, int), simulated_s=3.0)
    assert not layout.at_rest


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_sliding_friction_is_between_six_sevenths_and_all_of_the_stated_value(
    monkeypatch, turn_deg
):
    """Oracle: x = (sin a - mu cos a) g t^2 / 2 down a floor at 22 degrees without an obstacle."""
    upright, angle, seconds = rapier._world, np.deg2rad(22), 0.4

    def tilted(stage):
        world = upright(stage)
        world.gravity = tuple(196.2 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        return world

    monkeypatch.setattr(rapier, "_world", tilted)
    body = body_of_box((0.06, 0.06, 0.01), friction=0.4)
    box = Bin(inner_m=(0.9, 0.9, 0.1), friction=0.2)
    start = at(0, 0, 0.0052, turn=axis_rotation("z", np.deg2rad(turn_deg)))
    stage = rapier.Terms()
    heap = rapier.open_heap(stage, box, [rapier.RapierPart.of(body)], start, np.zeros(1, int))
    heap.run(seconds)
    slid_m = heap.poses()[0, 0, 3]
    mu = np.tan(angle) - 2 * slid_m / (9.81 * np.cos(angle) * seconds**2)
    assert 0.3 * 6 / 7 < mu < 0.3 * 1.005


@pytest.fixture(scope="session")
def bolt():
    """Return an M8x25 hex bolt: a hexagonal head of 13 x 5.3 mm, a shank of 8 mm."""
    head = trimesh.creation.cylinder(radius=0.013 / 3**0.5, height=0.0053, sections=6)
    shank = trimesh.creation.cylinder(radius=0.004, height=0.025, sections=48)
    shank.apply_translation((0, 0, 0.0053 / 2 + 0.0125))
    part = as_part(trimesh.boolean.union([head, shank], engine="manifold"), "bolt")
    return body_of(part, tuple(hull_of(np.array(piece.vertices)) for piece in (head, shank)))


@pytest.mark.parametrize("tilt_rad", [0.6, 1.2, 1.9, 2.8])
def test_a_bolt_comes_to_rest_on_its_head_and_shank(bolt, tilt_rad):
    """Oracle: the head's lowest corners and the end of the shank touch the floor.

    Its centre of mass is 12 mm above its head's face, so it stands up to a tilt of atan(6.5 / 12).
    """
    start = at(0.02, 0.01, 0.06, turn=axis_rotation("x", tilt_rad))
    layout = simulate(BIN, (bolt,), start, np.zeros(1, int), simulated_s=6.0)
    assert layout.at_rest and layout.simulated_s < 4
    (T,) = layout.T_world_part
    lowest_m = [(vertices @ T[2, :3]).min() + T[2, 3] for vertices, _ in bolt.hulls]
    assert lowest_m == pytest.approx([rapier.SKIN_M] * 2, abs=0.05e-3)


@pytest.mark.slow
def test_a_part_held_only_by_damping_is_not_taken_for_a_part_at_rest(monkeypatch):
    """At 15.5 degrees a slab slides 75 mm in 0.6 s; damped by 1e5 it creeps 0.06 mm in 0.6 s."""
    monkeypatch.setattr(rapier, "LINEAR_DAMPING", 1e5)
    upright, angle = rapier._world, np.deg2rad(15.5)

    def tilted(stage):
        world = upright(stage)
        world.gravity = tuple(196.2 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        return world

    monkeypatch.setattr(rapier, "_world", tilted)
    box, body = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.2), body_of_box((0.06, 0.06, 0.01), 0.4)
    layout = simulate(box, (body,), at(-0.1, 0, 0.0052), np.zeros(1, int), simulated_s=2.0)
    assert not layout.at_rest
    monkeypatch.setattr(rest, "REST_MOTION_M", 1.0)  # This switches the checks off.
    layout = simulate(box, (body,), at(-0.1, 0, 0.0052), np.zeros(1, int), simulated_s=2.0)
    assert layout.at_rest


def test_a_part_that_moves_away_slowly_is_not_at_rest(monkeypatch):
    """A tenth of a degree beyond the angle that nine tenths of the friction hold, a slab slides 0.2
    mm in the first 0.2 s, in which a part at rest moves at most 0.01 mm, and 0.54 mm in 0.6 s.
    """
    upright, angle = rapier._world, np.deg2rad(13.2)

    def tilted(terms):
        world = upright(terms)
        world.gravity = tuple(196.2 * np.array([np.sin(angle), 0.0, -np.cos(angle)]))
        return world

    monkeypatch.setattr(rapier, "_world", tilted)
    box, body = Bin(inner_m=(0.4, 0.3, 0.1), friction=0.2), body_of_box((0.06, 0.06, 0.01), 0.4)
    layout = simulate(box, (body,), at(-0.1, 0, 0.0052), np.zeros(1, int), simulated_s=1.0)
    assert not layout.at_rest


class Scripted(rapier.RapierHeap):
    """A heap whose parts have these heights [m] at each check; it records their damping."""

    def __init__(self, height_m):
        object.__setattr__(self, "world", None)
        script = {"height_m": np.array(height_m), "look": 0, "factors": []}
        object.__setattr__(self, "parts", script)

    def damp(self, factor):
        self.parts["factors"].append(factor.tolist())

    def run(self, seconds):
        self.parts["look"] += 1

    def poses(self):
        look = min(self.parts["look"], len(self.parts["height_m"]) - 1)
        return np.concatenate([at(0, 0, z) for z in self.parts["height_m"][look]])


def test_only_moving_parts_are_damped_and_rest_is_judged_without_damping():
    """One of two parts sinks by 1 mm per check for ten checks. Oracle, by hand: it has moved at
    check 1, and has come to rest at check 15, after five checks without motion; five checks without
    damping end at check 19. It is damped from check 2 to check 15, the other part never.
    """
    sinking = [(0.1 - 1e-3 * min(look, 10), 0.1) for look in range(30)]
    heap = Scripted(sinking)
    box_m = np.stack([body_of_box((0.04,) * 3).box_m] * 2)
    end, last_m, seconds, rests = rest._rest(heap, box_m, 5.0)
    assert last_m == 0  # This is the motion in the 0.2 s that showed rest, not in the fall.
    assert rests and seconds == pytest.approx(19 * rest.LOOK_S)
    assert end[:, 2, 3] == pytest.approx([0.09, 0.1])
    factors = np.array(heap.parts["factors"])
    assert np.flatnonzero(factors[:, 0]).tolist() == list(range(1, 15))
    assert not factors[:, 1].any()
    assert factors[1:6, 0].tolist() == [1.0] * 5 and (np.diff(factors[10:15, 0]) > 0).all()


def test_the_motion_of_a_part_is_the_largest_motion_of_its_corners():
    """Oracle: a rotation by a about a corner moves the end of a diagonal by 2 L sin(a / 2)."""
    body = body_of_box((0.06, 0.02, 0.02))
    corner = np.array([-0.03, -0.01, -0.01])
    turns = [axis_rotation("z", a) for a in (0.0, 0.4, 0.1)]
    T = np.stack([rigid(turn, corner - turn @ corner)[None] for turn in turns])
    far_m = 2 * np.hypot(0.06, 0.02) * np.sin(np.array([[0.1], [0.3], [0.0]]) / 2)  # to 0.1 rad
    assert motion_m(T, body.box_m[None]) == pytest.approx(far_m)


@pytest.mark.slow
def test_a_ring_dropped_onto_a_peg_comes_to_rest_around_the_peg(ring_part, ring_hulls):
    base = trimesh.creation.box((0.06, 0.06, 0.006))
    pin = trimesh.creation.cylinder(radius=0.010, height=0.05, sections=48)
    pin.apply_translation((0, 0, 0.025))
    peg = as_part(trimesh.boolean.union([base, pin], engine="manifold"), "peg")
    pieces = tuple(hull_of(np.array(piece.vertices)) for piece in (base, pin))
    bodies = (body_of(peg, pieces), body_of(ring_part, ring_hulls))
    tilt = axis_rotation("x", 0.15)
    start = np.concatenate([at(0, 0, 0.0032), at(0.003, 0.002, 0.08, turn=tilt)])
    layout = simulate(BIN, bodies, start, np.arange(2), simulated_s=6.0)
    peg_end, ring_end = layout.T_world_part
    assert layout.at_rest
    assert ring_end[2, 3] == pytest.approx(0.006 + 0.005, abs=1e-3)  # flat on the base
    assert np.linalg.norm((ring_end - peg_end)[:2, 3]) < RING_INNER_M - 0.010 + 0.5e-3


def test_parts_that_fall_off_a_heap_above_the_rim_are_counted():
    """Four cubes fit side by side into the bin; of twelve, at least four end elsewhere."""
    box = Bin(inner_m=(0.1, 0.1, 0.04))
    start = np.concatenate(
        [
            at(x, y, 0.08 + 0.06 * k)
            for k in range(3)
            for x in (-0.024, 0.024)
            for y in (-0.024, 0.024)
        ]
    )
    kind = np.zeros(12, int)
    body = body_of_box((0.042,) * 3)
    layout = simulate(box, (body,), start, kind, simulated_s=8.0)
    assert layout.at_rest
    assert 4 <= layout.outside <= 8
    assert parts_outside(box, (body,), layout.T_world_part, kind).sum() == layout.outside


def test_walls_that_guide_the_fall_do_not_support_a_rod_at_rest():
    """A 260 mm rod leans on a guide in a bin 100 mm wide and 40 mm deep, its centre inside.

    Without the guide it lies across the rim: its centre is 21 mm beyond the opposite corner.
    """
    box = Bin(inner_m=(0.1, 0.1, 0.04))
    lean = axis_rotation("y", -np.deg2rad(70))
    start, body = at(0.0, 0.0, 0.15, turn=lean), body_of_box((0.26, 0.02, 0.02))
    layout = simulate(box, (body,), start, np.zeros(1, int), simulated_s=8.0)
    assert layout.at_rest and layout.outside == 1


def test_the_centre_of_mass_and_the_lowest_point_decide_if_a_part_is_inside():
    body = body_of_box((0.1, 0.02, 0.02))
    upright, diagonal = axis_rotation("y", np.pi / 2), axis_rotation("y", 0.6)
    poses = {
        "on the floor": (at(0, 0, 0.01), False),
        "upright, sticks out over the rim": (at(0, 0, 0.06, turn=upright), False),
        "leans out of the bin, weight inside": (at(0.17, 0, 0.11, turn=diagonal), False),
        "hangs over the wall, weight beyond it": (at(0.21, 0, 0.11, turn=diagonal), True),
        "lies on top of the heap, above the rim": (at(0, 0, 0.12), True),
        "on the table": (at(0.3, 0, 0.01), True),
        "fell through the floor": (at(0, 0, -0.05), True),
    }
    for name, (pose, expected) in poses.items():
        assert parts_outside(BIN, (body,), pose, np.zeros(1, int))[0] == expected, name


def test_the_overlap_of_two_jammed_parts_is_measured():
    """Two cubes start 16 mm inside each other, and the drop ends at once."""
    body = body_of_box((0.04,) * 3)
    start = np.concatenate([at(-0.012, 0, 0.5), at(0.012, 0, 0.5)])
    layout = simulate(BIN, (body,), start, np.zeros(2, int), simulated_s=0.03)
    gap = np.diff(layout.T_world_part[:, 0, 3])[0]
    assert gap < 0.0395  # still jammed
    # The parts have rotated slightly, so their extents along x overlap by the upper bound; without
    # rotation, by the lower bound.
    extent_m = 0.02 * np.abs(layout.T_world_part[:, 0, :3]).sum()
    assert 0.04 - gap <= layout.deepest_penetration_m <= extent_m - gap + 1e-6
    assert layout.deepest_penetration_m > 0.5e-3
    assert not layout.at_rest


def test_an_inside_out_mesh_is_refused_for_lack_of_mass():
    shape = trimesh.creation.box((0.04, 0.04, 0.04))
    shape.invert()
    part = as_part(shape, "inverted")
    with pytest.raises(ValueError, match="inverted encloses"):
        body_of(part, (hull_of(np.array(shape.vertices)),))
