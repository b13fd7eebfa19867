"""Seals on meshes and on depth, and loads, against closed forms."""

import math

import numpy as np
import pytest
import trimesh
from scipy.optimize import brentq

from graycast.base.frames import axis_rotation, rigid
from graycast.rig.optics import Optics, rays
from graycast.robot.grasp import Cup, Patch, load_factor, patch_of_depth, patch_of_mesh, seal
from graycast.robot.grasp.suction import seals
from graycast.world.parts import Mesh

CUP = Cup(radius_m=0.010, height_m=0.012, vacuum_pa=50e3, friction=0.4)
STEP_M = 0.2e-3
CAMERA = Optics(width_px=200, height_px=160, fx_px=600.0, fy_px=600.0, cx_px=99.5, cy_px=79.5)


def under(mesh, T_mesh_tool):
    shape = Mesh(vertices_m=np.array(mesh.vertices), faces=np.array(mesh.faces))
    return patch_of_mesh(shape, T_mesh_tool, radius_m=0.011, step_m=STEP_M)


def at(x=0.0, y=0.0, z=0.0):
    return rigid(np.eye(3), np.array([x, y, z]))


def plate(hole_at=None, hole_m=0.003):
    """Return a plate, 100 mm square and 2 mm thick, with its top at z = 0."""
    body = trimesh.creation.box((0.1, 0.1, 0.002))
    body.apply_translation([0, 0, -0.001])
    if hole_at is not None:
        drill = trimesh.creation.cylinder(hole_m, 0.01, sections=64)
        drill.apply_translation([*hole_at, 0])
        body = body.difference(drill)
    return body


def test_a_cup_seals_on_a_flat_plate_without_strain():
    lies = seal(CUP, under(plate(), at()))
    assert lies.holds
    assert lies.strain == pytest.approx(0, abs=1e-12)
    assert seal(CUP, under(plate(), at(0.03, -0.02))).holds


@pytest.mark.parametrize("angle", np.radians([0, 40, 200]))
def test_a_hole_opens_a_seal_if_it_extends_below_the_cup(angle):
    """The hole has a radius of 3 mm, so its rim is below the cup up to 13 mm from the axis."""
    for away_m, holds in ((0.0, False), (0.008, False), (0.0125, False), (0.0135, True)):
        hole = away_m * np.array([math.cos(angle), math.sin(angle)])
        lies = seal(CUP, under(plate(hole), at()))
        assert lies.holds == holds, away_m
        if away_m == 0:
            assert lies.open_share == pytest.approx(0.3**2, rel=0.03)  # ratio of the areas


def test_a_blind_hole_under_the_cup_does_not_open_the_seal():
    blind = trimesh.util.concatenate(
        [plate((0, 0)), trimesh.creation.box((0.01, 0.01, 1e-4), at(z=-0.0021))]
    )
    assert seal(CUP, under(blind, at())).holds


@pytest.mark.parametrize(("away_m", "holds"), [(0.0102, True), (0.0098, False), (0.0, False)])
def test_an_edge_inside_the_lip_opens_the_seal(away_m, holds):
    lies = seal(CUP, under(plate(), at(x=0.05 - away_m)))
    assert lies.holds == holds
    if away_m == 0:
        assert lies.open_share == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("gap", "open_share"),
    [
        ((3, -2), 1 / 1257),  # number of nodes within 20 steps (Gauss's circle problem)
        ((0, 20), 1 / 32),  # One of the lip's 32 points is at the gap.
        ((21, 0), 1 / 32),  # The gap is next to one of these points, whose height is then unknown.
        ((22, 0), 0),
    ],
)
def test_an_unmeasured_point_below_a_cup_opens_its_seal(gap, open_share):
    height_m = np.zeros((51, 51))
    height_m[25 + gap[1], 25 + gap[0]] = np.nan
    lies = seal(CUP, Patch(height_m=height_m, step_m=0.5e-3))
    assert lies.open_share == open_share
    assert lies.strain == 0 and lies.holds == (open_share == 0)


@pytest.mark.parametrize("slope", [(0.1, 0.0), (0.0, -0.08), (0.06, 0.06)])
def test_a_cup_tilted_with_the_surface_has_no_strain(slope):
    """A cup that is tilted the other way has the strain of twice the slope, at its lowest point."""
    y, x = np.mgrid[-25:26, -25:26] * 0.5e-3
    patch = Patch(height_m=slope[0] * x + slope[1] * y, step_m=0.5e-3)
    lean = np.array([slope, (0.0, 0.0), (-slope[0], -slope[1])])
    strain, _ = seals(CUP, patch, aside_m=np.zeros((3, 2)), lean=lean)
    low_m = CUP.radius_m * math.hypot(*slope) * np.array([0, 1, 2])
    side_m = np.hypot(CUP.radius_m, CUP.height_m + low_m)
    np.testing.assert_allclose(strain, side_m / side_m[0] - 1, atol=1e-9)


def sphere_strain(radius_m):
    """Return the strain on a sphere: the lip sinks evenly, so only the cone's springs stretch."""
    r, h = CUP.radius_m, CUP.height_m
    sag = radius_m - math.sqrt(radius_m**2 - r**2)
    return math.hypot(r, h + sag) / math.hypot(r, h) - 1


def cylinder_strain(radius_m):
    """Return the strain of the lip's springs on a cylinder, from points of known height."""
    around = 2 * np.pi * np.arange(32) / 32
    x, y = CUP.radius_m * np.cos(around), CUP.radius_m * np.sin(around)
    z = np.sqrt(radius_m**2 - y**2) - radius_m
    worst = np.abs(np.sqrt(x**2 + y**2 + (z - CUP.height_m) ** 2) / math.hypot(0.010, 0.012) - 1)
    for apart in (1, 2):
        flat = 2 * CUP.radius_m * math.sin(np.pi * apart / 32)
        worst = np.append(worst, np.hypot(flat, z - np.roll(z, apart)) / flat - 1)
    return worst.max()


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_a_seal_opens_at_the_curvature_radius_of_the_closed_form(shape):
    law = sphere_strain if shape == "sphere" else cylinder_strain
    limit_m = brentq(lambda radius_m: law(radius_m) - 0.10, 0.0101, 0.2)
    for radius_m in (0.97 * limit_m, 1.03 * limit_m, 0.04):
        if shape == "sphere":
            mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius_m)
        else:
            mesh = trimesh.creation.cylinder(radius_m, 0.1, sections=720)
            mesh.apply_transform(rigid(axis_rotation("y", np.pi / 2), np.zeros(3)))
        lies = seal(CUP, under(mesh, at(z=radius_m)))
        assert lies.strain == pytest.approx(law(radius_m), rel=0.02)
        assert lies.holds == (radius_m > limit_m)


def test_measured_depth_and_the_true_surface_give_the_same_seal():
    """A camera sees a sphere of 40 mm, with depth in closed form; the tool is tilted."""
    center_m, radius_m = np.array([0.0, 0.0, 0.5]), 0.04
    y, x = np.mgrid[:160, :200].astype(float)
    ray = rays(CAMERA, np.stack([x, y], axis=-1))
    b, c = ray @ center_m, center_m @ center_m - radius_m**2
    a = (ray**2).sum(axis=-1)
    under_root = b**2 - a * c
    depth_m = (b - np.sqrt(np.where(under_root < 0, np.nan, under_root))) / a
    R = axis_rotation("x", np.pi) @ axis_rotation("y", 0.2)  # faces the camera, tilted by 0.2 rad
    T_cam_tool = rigid(R, center_m + radius_m * R[:, 2])
    patch = patch_of_depth(depth_m, CAMERA, T_cam_tool, radius_m=0.011, step_m=STEP_M)
    lies = seal(CUP, patch)
    assert lies.holds
    assert lies.strain == pytest.approx(sphere_strain(radius_m), abs=0.002)
    holed = depth_m.copy()
    u, v = np.round(CAMERA.fx_px * T_cam_tool[:2, 3] / T_cam_tool[2, 3] + [99.5, 79.5]).astype(int)
    holed[v, u] = np.nan
    open_share = seal(
        CUP, patch_of_depth(holed, CAMERA, T_cam_tool, radius_m=0.011, step_m=STEP_M)
    ).open_share
    # The six triangles at a pixel cover three pixels' area; a pixel's side is 0.46 m / 600.
    pixel_m = T_cam_tool[2, 3] / CAMERA.fx_px
    assert open_share == pytest.approx(3 * pixel_m**2 / (math.pi * CUP.radius_m**2), rel=0.15)


def test_a_cup_does_not_seal_on_a_step_in_depth():
    depth_m = np.full((160, 200), 0.5)
    depth_m[:, 100:] = 0.55
    T_cam_tool = rigid(axis_rotation("x", np.pi), np.array([-0.002, 0.0, 0.5]))
    lies = seal(CUP, patch_of_depth(depth_m, CAMERA, T_cam_tool, radius_m=0.011, step_m=STEP_M))
    assert lies.open_share > 0
    nothing = patch_of_depth(depth_m, CAMERA, at(z=5.0, x=9), radius_m=0.011, step_m=STEP_M)
    assert math.isnan(seal(CUP, nothing).strain)
    assert not seal(CUP, nothing).holds


PULL_N = 50e3 * math.pi * 1e-4  # 15.7 N


@pytest.mark.parametrize(
    ("force_n", "point_m", "limit"),
    [
        ((0, 0, -1), (0, 0, -0.05), PULL_N),  # The part hangs straight below.
        ((0, 0, 1), (0, 0, -0.05), math.inf),  # The load presses the part on.
        ((0, 0, -1), (0.01, 0, 0), 1 / (1 / PULL_N + 0.01 / (PULL_N * 0.005))),  # off the axis
        ((1, 0, 0), (0, 0, 0), 0.4 * PULL_N),  # across the axis
        ((1, 0, 0), (0, 0, -0.05), PULL_N * 0.005 / 0.05),  # Held sideways, the part tilts first.
        ((1, 0, 0), (0, 0.01, 0), 0.4 * PULL_N / math.sqrt(2)),  # across and about the axis
    ],
)
def test_the_limit_of_a_load_agrees_with_a_hand_calculation(force_n, point_m, limit):
    factor = load_factor(CUP, np.array([force_n], float), np.cross([point_m], [force_n]) * 1.0)[0]
    assert factor == pytest.approx(limit)


def test_the_load_of_a_tilted_cup_agrees_with_forces_at_points_of_a_ring():
    """Oracle: the largest factor, by bisection, for which forces exist at 720 points of a ring.

    The ring's pressure is N / (2 pi r) + M cos / (pi r^2). The ring slides as a whole.
    """
    rng = np.random.default_rng(3)
    around = 2 * np.pi * np.arange(720) / 720
    for _ in range(20):
        force = rng.normal(size=3)
        point = rng.normal(size=3) * 0.01

        def stays(factor, force=force, point=point):
            N = PULL_N + factor * force[2]
            mx, my, mz = factor * np.cross(point, force)
            pressure = N / (2 * np.pi) + (mx * np.sin(around) - my * np.cos(around)) / np.pi / 0.01
            slide = np.hypot(np.hypot(*(factor * force[:2])), mz / 0.01)
            return pressure.min() >= 0 and slide <= 0.4 * N

        factor = load_factor(CUP, force[None], np.cross(point, force)[None])[0]
        if factor < 1e3:
            assert stays(0.999 * factor)
            assert not stays(1.001 * factor)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"radius_m": 10.0}, "give metres"),
        ({"vacuum_pa": 2e5}, "101325"),
        ({"height_m": 0.0}, "greater than 0"),
    ],
)
def test_an_impossible_suction_cup_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        Cup(**changed)
