"""The pose of a bin with a mesh, from closed-form depth of its inside."""

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, rigid
from graycast.real.fit_bin import fit_pose, shape_of
from graycast.real.fit_bin.pose_fit import settle
from graycast.real.fit_bin.registration import register
from graycast.real.fit_bin.shape import NO_FACE, height_over
from graycast.world.scene import Bin, bin_mesh
from studies.crates import Crate
from studies.simulated_bins import wrong_by

from .empty_bins import BOX, CAMERA, noisy, perfect_depth, pose, view

CRATE = Crate(lean=0.09)  # 5 degrees


@pytest.fixture(scope="module")
def shape(tmp_path_factory):
    return shape_of(CRATE.bin(tmp_path_factory.mktemp("crate")))


def inside_depth(T_world_cam, crate=CRATE, camera=CAMERA):
    """Return z-depth of floor and walls: where each ray leaves the space between their planes.

    It is NaN if the ray does not enter this space through the opening and leave it below.
    """
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    ray = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px], -1)
    ray = np.concatenate([ray, np.ones_like(ray[..., :1])], -1) @ T_world_cam[:3, :3].T
    eye, half = T_world_cam[:3, 3], crate.half_m(0)
    planes = [((0, 0, -1), 0.0)]  # Inside, n . p <= d.
    for k in (0, 1):
        for sign in (1, -1):
            normal = np.zeros(3)
            normal[k], normal[2] = sign, -crate.lean
            planes.append((normal, half[k]))
    depth, entered = np.full(ray.shape[:2], np.inf), np.zeros(ray.shape[:2])
    for normal, offset in planes:
        leaves = ray @ np.array(normal, dtype=float)
        with np.errstate(divide="ignore"):
            t = (offset - eye @ normal) / leaves
        depth = np.where(leaves > 0, np.minimum(depth, t), depth)
        entered = np.where(leaves < 0, np.maximum(entered, t), entered)
    enters_at, leaves_at = (eye[2] + t * ray[..., 2] for t in (entered, depth))
    visible = (leaves_at < crate.inner_m[2]) & (enters_at > crate.inner_m[2]) & (entered < depth)
    return np.where(visible, depth, np.nan)


def test_pixels_are_assigned_to_the_faces_that_their_rays_meet(shape):
    T = pose(tilt_deg=20.0)
    grid = view(inside_depth(T)).grid(160)
    face, z = shape.cast(T, grid)
    known = np.isfinite(grid.depth_m)
    assert known.mean() > 0.1
    assert np.abs(z - grid.depth_m)[known].max() < 1e-5  # STL has single precision.
    names = np.array(shape.names)[shape.surface[face[known]]]
    # The camera does not see the inside of the wall -y.
    assert set(names) == {"floor", "wall +x", "wall -x", "wall +y"}
    outside = np.array(shape.names)[shape.surface[face[~known & (face != NO_FACE)]]]
    assert "rim and ledges" in outside


def test_surfaces_of_a_mesh_are_named_by_their_direction(shape):
    middle = shape.mesh.vertices_m[shape.mesh.faces].mean(axis=1)
    named = np.array(shape.names)[shape.surface]
    assert set(named) == set(shape.names)
    assert (shape.normal[named == "underside"][:, 2] < -0.9).all()
    assert (shape.normal[named == "rim and ledges"][:, 2] > 0.9).all()
    assert (middle[named == "rim and ledges"][:, 2] > 0.13).all()
    for name, inward in (("wall", -1), ("outside", 1)):
        for axis, letter in enumerate("xy"):
            for sign, side in ((1, f"+{letter}"), (-1, f"-{letter}")):
                mine = named == f"{name} {side}"
                assert (inward * sign * shape.normal[mine][:, axis] > 0.9).all()
                assert (sign * middle[mine][:, axis] > 0).all()


def test_a_point_is_assigned_to_its_nearest_face_with_the_distance(shape):
    slope = np.hypot(1.0, CRATE.lean)
    wall = np.array([-1.0, 0.0, CRATE.lean]) / slope  # inward normal of the wall +x
    on_wall = np.array([CRATE.half_m(0.07)[0], 0.02, 0.07])
    point = np.array([[0.1, 0.0, 0.002], on_wall + 0.003 * wall, on_wall - 0.001 * wall])
    normal = np.array([[0.0, 0.6, 0.8], wall, wall])
    face, distance_m = shape.nearest(point, normal, np.array([0.0, 0.0, 1.0]))
    assert [shape.names[s] for s in shape.surface[face]] == ["floor", "wall +x", "wall +x"]
    assert height_over(shape, point, face) == pytest.approx([0.002, 0.003, -0.001], abs=2e-6)
    assert distance_m == pytest.approx([0.002, 0.003, 0.001], abs=2e-6)
    face, _ = shape.nearest(point, -normal, np.array([0.0, 0.0, 1.0]))
    # Points with the opposite normal would be on the outside of a wall, which is invisible.
    assert (face == NO_FACE).all()


def test_points_on_a_face_and_points_behind_the_face_are_counted_as_votes(shape):
    T = pose(tilt_deg=20.0)
    grid = view(inside_depth(T)).grid(80)
    known = np.isfinite(grid.depth_m)
    aside = rigid(np.eye(3), np.array([0.05, 0.0, 0.0])) @ T
    same, moved = shape.votes(np.stack([T, aside]), grid, 0.01)
    assert same == pytest.approx(known.sum(), rel=1e-3)
    behind_m = (grid.depth_m - shape.cast(aside, grid)[1])[known]
    agrees = np.maximum(1 - np.abs(behind_m) / 0.01, 0).sum()
    assert moved == pytest.approx(agrees - (behind_m > 0.01).sum())
    assert moved < 0.8 * same


@pytest.mark.slow
def test_a_box_given_as_a_mesh_is_fitted_like_the_box():
    box = Bin(inner_m=BOX.inner_m, wall_m=BOX.wall_m)
    as_mesh = Bin(inner_m=BOX.inner_m, mesh=bin_mesh(BOX))
    crate = Crate(inner_m=BOX.inner_m, lean=0.0)
    T = pose()
    views = [view(noisy(inside_depth(T, crate), 0.3e-3, 0))]
    fits = [settle(views, shape_of(one), T).T_world_cam for one in (box, as_mesh)]
    off_m, off_deg = wrong_by(*fits)
    assert off_m < 0.03e-3
    assert off_deg < 0.01


@pytest.mark.slow
def test_the_pose_of_a_crate_with_inclined_walls_is_found_without_a_hint(shape):
    """The residuals are the noise, whereas a box would leave 6 mm at floor and rim."""
    T = pose(tilt_deg=25.0, azimuth_deg=20.0)
    views = [view(noisy(inside_depth(T), 0.4e-3, 1))]
    azimuth = np.arctan2(T[1, 0], T[0, 0])
    fit = fit_pose(views, shape, azimuth_rad=azimuth + 0.3, seed=0).pose
    off_m, off_deg = wrong_by(fit.T_world_cam, T)
    assert off_m < 0.15e-3
    assert off_deg < 0.03
    assert fit.loose == fit.by_edges == ()
    assert fit.rms_m < 0.45e-3
    face = {one.name: one for one in fit.faces}
    assert face["wall +y"].inliers > 0.95
    assert face["underside"].seen_px == 0


def test_a_direction_without_walls_is_determined_by_the_rim_of_a_mesh(shape):
    """Both walls across x have no depth, so only the ends of the floor and the rim determine x."""
    T = pose(tilt_deg=0.0, azimuth_deg=0.0, roll_deg=0.0, aside_m=(0.0, 0.0))
    depth_m = inside_depth(T)
    x = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px][1]
    ray_x = (x - CAMERA.cx_px) / CAMERA.fx_px
    on_floor = np.abs(T[0, 3] + depth_m * ray_x) < CRATE.half_m(0)[0]
    table = np.where(np.isnan(depth_m), T[2, 3] + 0.010, np.nan)  # outside the crate
    outside = np.abs(T[0, 3] + table * ray_x) > CRATE.half_m(CRATE.inner_m[2])[0] + 0.05
    depth_m = np.where(on_floor, depth_m, np.where(outside, table, np.nan))
    shifted = rigid(np.eye(3), np.array([0.004, 0.0, 0.0])) @ T
    fit = settle([view(noisy(depth_m, 0.3e-3, 2))], shape, shifted)
    assert "x" in fit.by_edges
    assert wrong_by(fit.T_world_cam, T)[0] < 1.5e-3


@pytest.mark.slow
def test_the_depth_of_another_crate_is_refused(shape):
    other = Bin(inner_m=(0.20, 0.15, 0.05), wall_m=0.012)
    views = [view(perfect_depth(pose(), other))]
    with pytest.raises(GraycastError, match="no bin of 373 x 273 x 140 mm inside is in the depth"):
        fit_pose(views, shape, azimuth_rad=0.0, seed=0)


def test_a_distant_initial_pose_converges(shape):
    T = pose(tilt_deg=15.0)
    away = rigid(axis_rotation("z", np.radians(4.0)), np.array([0.02, -0.015, 0.004])) @ T
    T_world_cam = register(view(inside_depth(T)).cloud(), away, shape)
    off_m, off_deg = wrong_by(T_world_cam, T)
    assert off_m < 0.05e-3
    assert off_deg < 0.01
