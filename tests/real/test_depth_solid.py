"""A solid from noisy depth: shading normals, steps and highlights of the true surface."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.real.depth_solid import Rounds, smooth_slopes, solid_of, surfaces
from graycast.rig.optics import Optics, rays
from graycast.rig.pair import preset_rig
from graycast.world.parts import Material, Part
from graycast.world.scene import Layout, Scene

# A pixel is 0.5 mm wide at 0.5 m.
CAMERA = Optics(width_px=160, height_px=120, fx_px=1000.0, fy_px=1000.0, cx_px=79.5, cy_px=59.5)
NOISE_M = 1e-4
ROUNDS: Rounds = ((1, 3, 6e-4), (2, 3, 3e-4))  # as in a rescan
CENTRE_M, RADIUS_M = np.array([0.0, 0.0, 0.58]), 0.08
TILTED = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])


def pixel_rays(camera=CAMERA):
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    pixel = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    return rays(camera, pixel).reshape(*x.shape, 3)


def plane_m(normal=TILTED, off_m=0.5, camera=CAMERA):
    return off_m / (pixel_rays(camera) @ normal)


def sphere_m():
    ray = pixel_rays()
    along, length2 = ray @ CENTRE_M, (ray**2).sum(axis=-1)
    left = along**2 - length2 * (CENTRE_M @ CENTRE_M - RADIUS_M**2)
    return (along - np.sqrt(left)) / length2


def from_centre(point_m):
    return (point_m - CENTRE_M) / np.linalg.norm(point_m - CENTRE_M, axis=-1, keepdims=True)


def of_plane(point_m):
    return np.broadcast_to(-TILTED, point_m.shape)


def noisy(depth_m):
    return depth_m + np.random.default_rng(0).normal(0, NOISE_M, depth_m.shape)


def solid(depth_m, *, smooth=True, camera=CAMERA):
    everywhere = np.ones(depth_m.shape, dtype=bool)
    planes = surfaces(depth_m, everywhere, ROUNDS)
    shading = smooth_slopes(depth_m, planes, ROUNDS[-1][2]) if smooth else None
    return solid_of(planes, depth_m, camera, shading=shading)


def is_top(mesh):
    """Return a mask of the faces of the top; the sides are parallel to the camera's rays."""
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    return (mesh.face_normal * middle).sum(axis=1) < -0.1 * np.linalg.norm(middle, axis=1)


def off_deg(one, other):
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=-1), -1, 1)))


BENT = replace(CAMERA, distortion=(-2.0, 0.0, 1e-2, -2e-2, 0.0))


@pytest.mark.parametrize("camera", [CAMERA, BENT])
def test_shading_normals_of_an_exact_plane_equal_the_normal_of_the_plane(camera):
    """Distortion moves the corner of the picture by 3 pixels."""
    mesh = solid(plane_m(camera=camera), camera=camera)
    assert off_deg(mesh.corner_normals[is_top(mesh)], -TILTED).max() < 0.3


@pytest.mark.parametrize(
    ("depth_m", "normal_at"),
    [
        (plane_m(), lambda point_m: np.broadcast_to(-TILTED, point_m.shape)),
        (sphere_m(), from_centre),
    ],
)
def test_noise_tilts_shading_normals_much_less_than_facets(depth_m, normal_at):
    """Independent noise s in a Gaussian window of width w causes an error of a slope of about
    s / (5 w^2): 0.2 degrees for 13 x 13 pixels. The cut at 1.7 widths and the weights for edges
    double this error. At the rim, where half of the window is empty, it doubles again.
    """
    mesh = solid(noisy(depth_m))
    top = is_top(mesh)
    corner = mesh.vertices_m[mesh.faces][top]
    facets = off_deg(mesh.face_normal[top], normal_at(corner.mean(axis=1)))
    smooth = off_deg(mesh.corner_normals[top], normal_at(corner))
    assert np.sqrt((facets**2).mean()) > 2.0
    assert np.sqrt((smooth**2).mean()) < 1.2


def test_shading_normals_do_not_move_the_surface():
    flat, smooth = (solid(noisy(sphere_m()), smooth=one) for one in (False, True))
    assert flat.corner_normals is None and smooth.corner_normals is not None
    np.testing.assert_array_equal(flat.vertices_m, smooth.vertices_m)
    np.testing.assert_array_equal(flat.faces, smooth.faces)
    np.testing.assert_allclose(np.linalg.norm(smooth.corner_normals, axis=-1), 1.0)


@pytest.mark.parametrize("step_m", [0.02, 0.003])
def test_surfaces_at_a_step_keep_their_own_normals(step_m):
    """Planes of opposite tilt meet at a step, which the mesh joins only if it is below 5 mm."""
    left, right = (np.array([side, 0.0, 1.0]) / np.hypot(side, 1.0) for side in (0.3, -0.3))
    on_left = np.arange(CAMERA.width_px) < 80
    depth_m = np.where(on_left, plane_m(left, 0.5), plane_m(right, 0.5 + step_m))
    mesh = solid(noisy(depth_m))
    top = is_top(mesh)
    corner = mesh.vertices_m[mesh.faces][top]
    column = CAMERA.fx_px * corner[..., 0] / corner[..., 2] + CAMERA.cx_px
    for normal, own in ((left, column < 78.9), (right, column > 80.1)):
        near_step = own & (np.abs(column - 79.5) < 3)
        assert near_step.sum() > 50
        off = off_deg(mesh.corner_normals[top], -normal)[near_step]
        assert np.median(off) < 1.5
        assert off.max() < 13  # The mean of both normals would be off by 16.7 degrees.
    if step_m > 0.005:  # Each surface extends to the step.
        at_step = np.abs(column - 79.5) < 0.3
        tilt = mesh.corner_normals[top][at_step][:, 0]
        assert (np.abs(np.abs(tilt) - 0.287) < 0.12).all()
        assert (tilt > 0).sum() > 20 and (tilt < 0).sum() > 20


def test_the_sides_of_a_solid_are_flat():
    mesh = solid(noisy(plane_m()))
    sides = ~is_top(mesh)
    assert sides.sum() >= 2 * 2 * (160 + 120)
    across = off_deg(mesh.corner_normals[sides], mesh.face_normal[sides][:, None])
    assert across.max() < 1e-4


def highlight(renderer, mesh, roughness=0.15):
    """Render a metal solid under a projector 40 mm to the right of the camera; return its light."""
    from graycast.rendering import Quality

    rig = preset_rig("paper", "small")
    T_cam_proj = np.eye(4)
    T_cam_proj[0, 3] = 0.04
    part = Part(
        name="solid",
        mesh=mesh,
        material=Material(base_color=(0.7, 0.7, 0.7), metallic=1.0, roughness=roughness),
        density_kg_m3=1000.0,
        friction=0.5,
    )
    scene = Scene(
        rig=replace(rig, camera=CAMERA, T_cam_proj=T_cam_proj, near_m=0.3, far_m=0.8),
        T_world_cam=np.eye(4),
        parts=(part,),
        lamps=(),
    )
    layout = Layout(T_world_part=np.eye(4)[None], part_index=np.zeros(1, dtype=np.int64))
    white = np.full((1, rig.projector.height_px, rig.projector.width_px), 255, dtype=np.uint8)
    rendering = renderer.render(scene, layout, white, quality=Quality(samples=16, depth=2), seed=0)
    return rendering.radiance.pattern[0]


def width_px(light):
    """Return the radius [px] around the mirror direction that contains half of the light."""
    y, x = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    radius = np.hypot(x - CAMERA.cx_px - 40, y - CAMERA.cy_px)
    order = np.argsort(radius[radius < 38])
    total = np.cumsum(light[radius < 38][order])
    return float(np.interp(0.5 * total[-1], total, radius[radius < 38][order]))


@pytest.mark.slow
def test_a_highlight_on_noisy_depth_is_as_wide_as_on_the_true_plane(mitsuba_renderer):
    """The mirror direction is at 20 mm (40 pixels) to the right of the camera's axis. Normals with
    an error of 0.5 degrees RMS widen a lobe of 1.3 degrees by 4 %: squares add along each axis.
    """
    facing = plane_m(np.array([0.0, 0.0, 1.0]))
    exact, smooth, facets = (
        highlight(mitsuba_renderer, mesh)
        for mesh in (solid(facing), solid(noisy(facing)), solid(noisy(facing), smooth=False))
    )
    assert width_px(smooth) == pytest.approx(width_px(exact), rel=0.08)
    assert width_px(facets) > 1.15 * width_px(exact)
