"""The pose of a bin from depth with noise, missing walls and objects in the bin."""

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, rigid
from graycast.real.fit_bin import fit_pose
from graycast.real.fit_bin.box import open_box
from graycast.real.fit_bin.pose_fit import find_pose, hold_by_edges, judge, settle
from graycast.real.fit_bin.registration import register
from graycast.real.fit_bin.residual_picture import residual_map
from graycast.real.fit_bin.shape import NO_FACE, height_over
from graycast.real.fit_bin.start import planes
from graycast.world.scene import Bin
from studies.simulated_bins import wrong_by

from .empty_bins import BOX, noisy, perfect_depth, pose, view, without

CLUTTER = (
    ((-0.10, -0.12, 0.0), (-0.02, -0.04, 0.05)),
    ((0.06, 0.02, 0.0), (0.17, 0.08, 0.03)),
    ((-0.19, 0.05, 0.0), (-0.13, 0.14, 0.09)),
)


def faulty(T, seed, box=BOX):
    """Return a view with 0.4 mm of noise and three blocks on the floor, without the wall +x."""
    depth_m = noisy(perfect_depth(T, box, blocks=CLUTTER), 0.4e-3, seed)
    half, height = box.inner_m[0] / 2, box.inner_m[2]
    lost = lambda p: (np.abs(p[..., 0] - half) < 0.006) & (p[..., 2] < height - 0.004)  # noqa: E731
    return view(without(depth_m, T, lost))


def test_ray_casting_and_rasterising_give_the_same_depth_of_the_box():
    """Oracle: `rig.meshdepth`, which rasterises the triangles of `scene.bin_mesh`."""
    T = pose(tilt_deg=35.0)
    box = open_box(BOX.inner_m, BOX.wall_m)
    scan = view(perfect_depth(T))
    grid = scan.grid(160)
    face, z = box.cast(T, grid)
    hit = face != NO_FACE
    assert hit.mean() > 0.2
    off_m = np.abs(z[hit] - grid.depth_m[hit])
    assert np.mean(off_m < 1e-9) > 0.995  # A pixel centre on an edge may belong to either side.
    names = {box.names[f] for f in np.unique(face[hit])}
    assert {"floor", "wall +y", "wall +x", "wall -x", "rim -x", "outside -y"} <= names


def test_a_point_is_assigned_to_its_nearest_face_with_the_distance():
    box = open_box((0.4, 0.3, 0.15), 0.01)
    point = np.array([[0.1, 0.0, 0.002], [0.198, 0.1, 0.07], [0.0, -0.149, 0.1], [0.0, 0.153, 0.1]])
    normal = np.array([[0.0, 0.6, 0.8], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    eye_m = np.array([0.0, 0.0, 1.0])
    face, distance_m = box.nearest(point, normal, eye_m)
    assert [box.names[f] for f in face] == ["floor", "wall +x", "wall -y", "wall +y"]
    assert height_over(box, point, face) == pytest.approx([0.002, 0.002, 0.001, -0.003])
    assert distance_m == pytest.approx([0.002, 0.002, 0.001, 0.003])
    # With vertical normals, the second point belongs to the floor, 70 mm below it.
    level = np.tile([0.0, 0.0, 1.0], (4, 1))
    face, distance_m = box.nearest(point, level, eye_m)
    assert [box.names[f] for f in face] == ["floor", "floor", "rim -y", "rim +y"]
    assert distance_m[1] == pytest.approx(0.07)
    away, _ = box.nearest(point, -level, eye_m)
    assert (away == NO_FACE).all()


@pytest.mark.slow
def test_normals_of_a_cloud_equal_the_normals_of_the_faces():
    """Oracle: all planes of the bin are normal to an axis, so one component is 1 or -1."""
    T = pose(tilt_deg=30.0)
    cloud = view(perfect_depth(T)).cloud()
    normal = cloud[:, 3:] @ T[:3, :3].T
    assert np.linalg.norm(normal, axis=1) == pytest.approx(np.ones(len(normal)))
    assert np.mean(np.abs(normal).max(axis=1) > 1 - 1e-6) > 0.9  # all except pixels at edges
    assert ((cloud[:, :3] * cloud[:, 3:]).sum(axis=1) < 0).all()  # towards the camera


def test_planes_are_sorted_by_size_and_their_normals_point_to_the_camera():
    T = pose(tilt_deg=0.0, roll_deg=0.0, azimuth_deg=0.0, aside_m=(0.0, 0.0))
    detections = planes(view(perfect_depth(T)).grid(80).point_m, seed=0)
    # The camera looks straight down: height z is the plane n = (0, 0, -1), d = z - camera_z.
    camera_z = T[2, 3]
    table, floor = detections[0], detections[1]
    for (normal, offset_m), level_m in ((table, -0.012), (floor, 0.0)):
        assert normal == pytest.approx([0, 0, -1], abs=1e-6)
        assert offset_m == pytest.approx(level_m - camera_z, abs=1e-6)


def test_depth_behind_a_wall_lowers_the_score_of_a_pose():
    T, box = pose(), open_box(BOX.inner_m)
    grid = view(perfect_depth(T)).grid(80)
    beside = rigid(np.eye(3), np.array([0.45, 0.0, 0.0])) @ T
    true, aside = box.votes(np.stack([T, beside]), grid, 0.01) / grid.depth_m.size
    for pose_of, score in ((T, true), (beside, aside)):  # The other ray caster agrees.
        behind_m = grid.depth_m - box.cast(pose_of, grid)[1]
        agrees = np.maximum(1 - np.abs(behind_m) / 0.01, 0)
        assert score == pytest.approx((agrees - (behind_m > 0.01)).mean(), abs=1e-12)
    assert true > 0.25
    assert aside < 0.0


HANGING = {"tilt_deg": 0.0, "azimuth_deg": 70.0, "aside_m": (-0.06, 0.05)}
LEANING = {"tilt_deg": 30.0, "azimuth_deg": -35.0, "roll_deg": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "view_words"),
    [(0, {}), (1, LEANING), (2, HANGING)],
)
def test_the_pose_is_found_without_a_hint_despite_noise_and_a_missing_wall(seed, view_words):
    T = pose(**view_words)
    box = open_box(BOX.inner_m, BOX.wall_m)
    azimuth = np.arctan2(T[1, 0], T[0, 0])
    T_world_cam = find_pose([faulty(T, seed)], box, azimuth_rad=azimuth + 0.3, seed=0).T_world_cam
    off_m, off_deg = wrong_by(T_world_cam, T)
    assert off_m < 0.5e-3
    assert off_deg < 0.1


def test_a_close_initial_pose_converges_despite_noise_objects_and_a_missing_wall():
    """The fit starts 25 mm and 4 degrees away from the true pose."""
    T, box = pose(), open_box(BOX.inner_m, BOX.wall_m)
    away = rigid(axis_rotation("z", np.radians(4.0)), np.array([0.02, -0.015, 0.004])) @ T
    views = [faulty(T, 0)]
    fit = settle(views, box, register(views[0].cloud(), away, box))
    off_m, off_deg = wrong_by(fit.T_world_cam, T)
    assert off_m < 0.2e-3
    assert off_deg < 0.05
    assert fit.loose == fit.by_edges == ()
    face = {face.name: face for face in fit.faces}
    assert face["floor"].rms_m == pytest.approx(0.4e-3, rel=0.2)  # seen from above
    assert face["wall +x"].inliers < 0.1 < 0.7 < face["wall -x"].inliers


def test_the_map_of_residuals_shows_the_distance_of_each_face():
    """The bin is 2 mm longer in x and its camera 1 mm higher than stated."""
    T = pose(tilt_deg=0.0)
    lower = T.copy()
    lower[2, 3] -= 1e-3
    scan = view(perfect_depth(T, Bin(inner_m=(0.402, 0.30, 0.15), wall_m=0.012)))
    box = open_box(BOX.inner_m)
    residual_m = residual_map(scan, box, lower)
    face, _ = box.cast(lower, scan.grid(640))
    for name, height_m in (("floor", -1e-3), ("wall +x", -1e-3), ("wall +y", 0.0)):
        on_face = residual_m[(face == box.names.index(name)) & np.isfinite(residual_m)]
        assert on_face.size > 50
        assert np.median(on_face) == pytest.approx(height_m, abs=1e-5)
    assert np.isnan(residual_m[face == NO_FACE]).all()


@pytest.mark.slow
def test_the_pose_is_found_without_the_thickness_of_the_walls():
    T = pose()
    T_world_cam = find_pose(
        [faulty(T, 4)], open_box(BOX.inner_m), azimuth_rad=0.0, seed=0
    ).T_world_cam
    off_m, off_deg = wrong_by(T_world_cam, T)
    assert off_m < 0.5e-3
    assert off_deg < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(("inner_m", "turns"), [((0.40, 0.30, 0.15), 2), ((0.35, 0.35, 0.15), 4)])
def test_the_pose_nearest_to_the_stated_azimuth_is_chosen_among_symmetric_poses(inner_m, turns):
    """Symmetric poses differ by rotations of the bin about its z axis."""
    box, T = Bin(inner_m=inner_m), pose(tilt_deg=5.0)
    views = [view(perfect_depth(T, box))]
    own = np.arctan2(T[1, 0], T[0, 0])
    first = find_pose(views, open_box(inner_m), azimuth_rad=own, seed=0).T_world_cam
    assert wrong_by(first, T)[1] < 0.01
    angle = 2 * np.pi / turns
    turned = find_pose(views, open_box(inner_m), azimuth_rad=own + angle, seed=0).T_world_cam
    expected = rigid(axis_rotation("z", angle), np.zeros(3)) @ T
    assert wrong_by(turned, expected)[1] < 0.01


def test_an_undetermined_direction_is_named():
    """If both walls across x have no depth, inside and outside, x is undetermined."""
    T = pose(tilt_deg=0.0, aside_m=(0.0, 0.0), azimuth_deg=0.0, roll_deg=0.0)
    lost = lambda p: (np.abs(p[..., 0]) > 0.18) | (p[..., 2] < -0.004)  # noqa: E731
    views = [view(without(noisy(perfect_depth(T), 0.3e-3, 5), T, lost))]
    fit = judge(views, open_box(BOX.inner_m), register(views[0].cloud(), T, open_box(BOX.inner_m)))
    assert fit.loose == ("x",)
    spot = lambda p: lost(p) & ~((p[..., 0] > 0.18) & (np.abs(p[..., 1]) < 0.016))  # noqa: E731
    views = [view(without(noisy(perfect_depth(T), 0.3e-3, 5), T, spot))]
    fit = judge(views, open_box(BOX.inner_m), register(views[0].cloud(), T, open_box(BOX.inner_m)))
    assert fit.sigma[0] < 0.2e-3  # The noise is small, but a small spot may be an object.
    assert fit.loose == ("x",)
    whole = [view(noisy(perfect_depth(T), 0.3e-3, 5))]
    box = open_box(BOX.inner_m)
    assert judge(whole, box, register(whole[0].cloud(), T, box)).loose == ()


@pytest.mark.slow
def test_stated_deviations_agree_with_the_scatter_over_many_noise_samples():
    """Oracle: the scatter of 24 fits, with a relative error of 1 / sqrt(2 (n - 1)) = 15 %."""
    T, box = pose(), open_box(BOX.inner_m, BOX.wall_m)
    clean = perfect_depth(T)
    fits = []
    for seed in range(24):
        views = [view(noisy(clean, 0.5e-3, seed))]
        fits.append(judge(views, box, register(views[0].cloud(), T, box)))
    place = np.array([fit.T_world_cam @ np.linalg.inv(T) for fit in fits])[:, :3, 3]
    ratio = place.std(axis=0, ddof=1) / np.mean([fit.sigma[:3] for fit in fits], axis=0)
    assert (ratio > 1 - 3 * 0.15).all()
    assert (ratio < 1.3 + 3 * 0.15).all()  # Pixels at edges that change faces add scatter.


def test_residuals_by_face_show_that_a_bin_is_longer_than_stated():
    """Two walls that are 2 mm farther apart than stated are each 1 mm behind their faces."""
    T = pose(tilt_deg=0.0)
    longer = Bin(inner_m=(0.402, 0.30, 0.15), wall_m=0.012)
    box = open_box(BOX.inner_m)
    views = [view(noisy(perfect_depth(T, longer), 0.2e-3, 6))]
    fit = judge(views, box, register(views[0].cloud(), T, box))
    median = {face.name: face.median_m for face in fit.faces}
    assert median["wall +x"] == pytest.approx(-1e-3, abs=0.15e-3)
    assert median["wall -x"] == pytest.approx(-1e-3, abs=0.15e-3)
    assert abs(median["floor"]) < 0.1e-3


@pytest.mark.slow
def test_a_picture_without_the_bin_is_refused():
    T = pose()
    other = Bin(inner_m=(0.15, 0.12, 0.3), wall_m=0.005)
    with pytest.raises(GraycastError, match="no bin of 400 x 300 x 150 mm"):
        fit_pose([view(perfect_depth(T, other))], open_box(BOX.inner_m), azimuth_rad=0.0, seed=0)


@pytest.mark.slow
def test_several_views_share_one_pose_and_their_disagreement_is_reported():
    T = pose()
    box = open_box(BOX.inner_m, BOX.wall_m)
    views = [faulty(T, seed) for seed in (7, 8, 9)]
    fit = fit_pose(views, box, azimuth_rad=0.0, seed=0)
    off_m, _ = wrong_by(fit.pose.T_world_cam, T)
    assert off_m < 0.4e-3
    assert len(fit.apart) == 3
    assert all(0 < m < 1e-3 for m, _ in fit.apart)


def test_edges_determine_a_position_that_no_wall_determines():
    """Both inner walls across x have no depth: only edges of rim and floor determine x.

    A pixel is 5 mm wide, and about 200 pixels are on edges across x.
    """
    T = pose(tilt_deg=0.0)
    lost = lambda p: (np.abs(np.abs(p[..., 0]) - 0.2) < 0.006) & (p[..., 2] < 0.146)  # noqa: E731
    views = [view(without(noisy(perfect_depth(T), 0.4e-3, 10), T, lost))]
    shifted = rigid(np.eye(3), np.array([0.004, 0.0, 0.0])) @ T
    T_world_cam, axes = hold_by_edges(
        views, open_box(BOX.inner_m, BOX.wall_m), shifted, ("x",), 0.4e-3
    )
    assert axes == ("x",)
    off_m = (T_world_cam @ np.linalg.inv(T))[:3, 3]
    assert abs(off_m[0]) < 1e-3
    assert off_m[1:] == pytest.approx([0, 0], abs=1e-12)


def test_edges_outside_the_picture_do_not_determine_a_position():
    """A floor whose ends are outside the picture determines no position."""
    T = pose(tilt_deg=0.0, aside_m=(0.0, 0.0), distance_m=0.9)
    flat = view(np.full((120, 160), T[2, 3]))
    huge = open_box((3.0, 2.0, 0.1))
    T_world_cam, axes = hold_by_edges([flat], huge, T, ("x", "y", "about z"), 0.4e-3)
    assert axes == ()
    assert np.array_equal(T_world_cam, T)


def test_a_face_with_little_depth_has_little_weight():
    """One of two walls is 2 mm off: the bin moves by 1 mm, or less if the wall has less weight."""
    T = pose(tilt_deg=0.0, azimuth_deg=0.0, roll_deg=0.0, aside_m=(0.0, 0.0))
    box = open_box(BOX.inner_m)
    cloud = view(perfect_depth(T)).cloud()
    x = (cloud[:, :3] @ T[:3, :3].T + T[:3, 3])[:, 0]
    wall = np.abs(np.abs(x) - 0.2) < 1e-4
    off_m = np.where(x > 0, -0.002, 0.0) + 0.8e-3 * np.random.default_rng(0).standard_normal(len(x))
    cloud[:, :3] += np.outer(np.where(wall, off_m, 0.0), T[0, :3])
    trust = np.array([0.1 if name == "wall +x" else 1.0 for name in box.names])
    even, uneven = (
        abs((register(cloud, T, box, trust=t) @ np.linalg.inv(T))[0, 3]) for t in (None, trust)
    )
    assert even == pytest.approx(1e-3, abs=0.3e-3)
    assert uneven < 0.35 * even
