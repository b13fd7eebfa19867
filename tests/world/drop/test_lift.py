"""A tool carries the weight of a gripped part, and loses the part as its law states."""

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from graycast.base.frames import rigid
from graycast.robot.grasp import Cup, Jaws, jaw_load_factor, load_factor
from graycast.world.drop import Hold, lift
from graycast.world.drop.body import body_of
from graycast.world.drop.lift import STEP_S, _turn
from graycast.world.drop.rapier import GRAVITY_M_S2, SKIN_M
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import Bin

BIN = Bin(inner_m=(0.4, 0.3, 0.15))
PLATE_M = (0.08, 0.06, 0.01)
CUP = Cup(radius_m=0.01, height_m=0.01, vacuum_pa=30e3, friction=0.5)


def plate(mass_kg, friction=0.5):
    box = trimesh.creation.box(PLATE_M)
    mesh = Mesh(vertices_m=np.array(box.vertices), faces=np.array(box.faces))
    part = Part(
        name="plate", mesh=mesh, material=Material(), friction=friction,
        density_kg_m3=mass_kg / math.prod(PLATE_M),
    )  # fmt: skip
    return body_of(part, ((np.array(box.vertices), np.array(box.faces)),))


def lying(x=0.0, y=0.0, z=0.0):
    return rigid(np.eye(3), np.array([x, y, z + PLATE_M[2] / 2 + SKIN_M]))


def upwards(start, *, metres=0.1, seconds=1.0, acceleration=None):
    """Return a smooth rise, or one of constant acceleration."""
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    s = t / seconds
    rise = metres * (3 * s**2 - 2 * s**3) if acceleration is None else acceleration * t**2 / 2
    path = np.tile(start, (len(t), 1, 1))
    path[:, 2, 3] += rise
    return path


def on_top(x=0.0):
    return rigid(np.eye(3), np.array([x, 0.0, PLATE_M[2] / 2]))


def hold_of(cup, T_part_tool):
    return Hold(
        T_part_tool=T_part_tool,
        factor=lambda force, moment: float(load_factor(cup, force[None], moment[None])[0]),
    )


def lifted(body, hold, path, starts=None, number=0):
    starts = np.stack([lying()]) if starts is None else starts
    index = np.zeros(len(starts), int)
    return lift(BIN, (body,), starts, index, number, hold, path)


@pytest.mark.slow
def test_the_tool_carries_the_weight_of_the_lifted_part():
    """At rest, the force is the part's weight; with 3 m/s2 upwards, it is larger by this much."""
    body = plate(0.2)
    for acceleration in (None, 3.0):
        loads = []

        def felt(force, moment, loads=loads):
            loads.append(force)
            return math.inf

        path = upwards(lying() @ on_top(), seconds=0.5, acceleration=acceleration)
        if acceleration is None:
            path = np.concatenate([path, np.tile(path[-1], (250, 1, 1))])
        lifted(body, Hold(T_part_tool=on_top(), factor=felt), path)
        weight_n = 0.2 * (GRAVITY_M_S2 + (acceleration or 0.0))
        np.testing.assert_allclose(loads[-1], [0, 0, -weight_n], atol=2e-3 * weight_n)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.1, False)])
def test_a_cup_lifts_only_the_weight_that_its_vacuum_can_hold(share, holds):
    body = plate(share * CUP.pull_n / GRAVITY_M_S2)
    path = upwards(lying() @ on_top(), metres=0.1, seconds=3.0)
    end = lifted(body, hold_of(CUP, on_top()), path)
    assert (end.lost_s is None) == holds
    sag_m = body.mass_kg * GRAVITY_M_S2 / 2000.0  # sag of the bellows
    risen_m = end.T_world_part[0, 2, 3] - lying()[2, 3]
    assert risen_m == pytest.approx(0.1 - sag_m if holds else 0.0, abs=0.3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.1, False)])
def test_a_cup_far_from_the_centre_of_mass_loses_the_part_by_tilt(share, holds):
    """The grip is 30 mm off the centre: m g (1 + 2 d / r) <= pull, by the ring's statics."""
    beside_m = 0.03
    limit_kg = CUP.pull_n / GRAVITY_M_S2 / (1 + 2 * beside_m / CUP.radius_m)
    body = plate(share * limit_kg)
    path = upwards(lying() @ on_top(-beside_m), metres=0.1, seconds=3.0)
    end = lifted(body, hold_of(CUP, on_top(-beside_m)), path)
    assert (end.lost_s is None) == holds


@pytest.mark.slow
@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.1, False)])
def test_jaws_hold_a_part_up_to_their_friction_limit_and_lose_it_beyond(share, holds):
    jaws = Jaws(opening_m=0.1, force_n=20.0, friction=0.3)
    body = plate(share * 2 * 0.3 * 20.0 / GRAVITY_M_S2)
    T = rigid(np.eye(3), np.zeros(3))  # pads on both ends, through the centre of mass
    hold = Hold(
        T_part_tool=T,
        factor=lambda force, moment: float(jaw_load_factor(jaws, force[None], moment[None])[0]),
    )
    end = lifted(body, hold, upwards(lying(), metres=0.1, seconds=3.0))
    assert (end.lost_s is None) == holds


@pytest.mark.slow
def test_lifting_the_lower_of_two_parts_lifts_the_upper_part_too():
    """The upper plate is on the lower one, beside the cup's position."""
    body = plate(0.1)
    starts = np.stack([lying(), lying(x=0.035, z=PLATE_M[2] + 2 * SKIN_M)])
    hold = Hold(T_part_tool=on_top(-0.03), factor=lambda force, moment: 10 + float(force[2]))
    end = lifted(body, hold, upwards(starts[0] @ on_top(-0.03), metres=0.05, seconds=2.0), starts)
    assert end.T_world_part[1, 2, 3] > starts[1, 2, 3] + 0.04
    assert 10 - end.least_factor == pytest.approx(0.2 * GRAVITY_M_S2, rel=0.1)


def test_lifting_is_stable_for_light_parts_and_strong_pulls():
    """A light part on a stiff tool is pulled sideways through a fixed wall."""
    body = plate(0.002)
    hold = Hold(
        T_part_tool=on_top(), factor=lambda force, moment: math.inf, stiffness_n_m=1e6,
        turning_nm=1e4,
    )  # fmt: skip
    path = upwards(lying() @ on_top(), metres=0.0, seconds=1.0)
    path[:, 0, 3] += np.linspace(0, 0.5, len(path))
    end = lifted(body, hold, path)
    assert np.isfinite(end.T_world_part).all()
    assert np.linalg.norm(end.T_world_part[0, :3, 3]) < 1.0


def test_rotation_vectors_agree_with_scipy_up_to_half_a_turn():
    """Oracle: SciPy's vector, and the vector that the rotation was made from."""
    rng = np.random.default_rng(3)
    axis = rng.normal(size=(200, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.concatenate([[0.0, 1e-12, 1e-7, np.pi - 1e-5], rng.uniform(0, np.pi - 1e-3, 196)])
    for vector in axis * angle[:, None]:
        result = _turn(Rotation.from_rotvec(vector).as_matrix())
        np.testing.assert_allclose(result, vector, rtol=1e-9, atol=1e-14)
    half = _turn(Rotation.from_rotvec([0, np.pi, 0]).as_matrix())
    np.testing.assert_allclose(np.abs(half), [0, np.pi, 0], atol=1e-12)


@pytest.mark.slow
def test_repeating_a_lift_gives_the_same_result_to_the_last_bit():
    body = plate(0.1)
    path = upwards(lying() @ on_top())
    first, second = (lifted(body, hold_of(CUP, on_top()), path) for _ in range(2))
    assert (first.T_world_part == second.T_world_part).all()
    assert first.least_factor == second.least_factor
