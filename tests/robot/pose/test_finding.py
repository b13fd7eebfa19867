"""Poses from depth maps of the checking rasteriser, which the search does not use."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.camera.crop import crop
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics, rays
from graycast.robot.pose import find_pose, find_pose_in_box, find_poses, pose_model
from graycast.robot.pose.drawing import Canvas, Window, draw, lens
from graycast.score.evaluate import rotation_translation
from graycast.world.parts import Mesh, Symmetry, builtin_part
from graycast.world.parts.symmetry import motions

CAMERA = Optics(width_px=200, height_px=160, fx_px=560.0, fy_px=560.0, cx_px=99.5, cy_px=79.5)
FLOOR_M = 0.92


@pytest.fixture(scope="module")
def bracket():
    return builtin_part("metal_workpiece_1")


@pytest.fixture(scope="module")
def model(bracket):
    return pose_model(bracket.mesh, bracket.symmetry)


def depth_of(mesh, T, camera=CAMERA):
    vertices = transform_points(T, mesh.vertices_m.astype(np.float64))
    return rasterize(vertices, mesh.faces, camera).over(camera)[1]


def scan(mesh, T, *, noise_m=0.0005, lost=0.2, seed=0):
    """Return a scan of a part in front of a floor, with noise along z and holes, and its mask."""
    rng = np.random.default_rng(seed)
    z = depth_of(mesh, T)
    mask = np.isfinite(z)
    depth = np.where(mask, z, FLOOR_M) + noise_m * rng.standard_normal(z.shape)
    depth[rng.random(z.shape) < lost] = np.nan
    return depth, mask


def heap(mesh, seed):
    """Return depth of six parts (five around the first), each pixel's part, poses and shares."""
    rng = np.random.default_rng(seed)
    around = 2 * np.pi * np.arange(5) / 5 + rng.uniform(0, 2 * np.pi)
    aside = [(0.0, 0.0), *(0.038 * np.stack([np.cos(around), np.sin(around)], axis=1))]
    places = [
        rigid(Rotation.random(rng=rng).as_matrix(), np.array([x, y, rng.uniform(0.84, 0.88)]))
        for x, y in aside
    ]
    z = np.nan_to_num([depth_of(mesh, T) for T in places], nan=FLOOR_M)
    owner = np.where(z.min(axis=0) < FLOOR_M, z.argmin(axis=0), -1)
    depth = z.min(axis=0) + 0.0005 * rng.standard_normal(owner.shape)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    share = [(owner == k).sum() / (one < FLOOR_M).sum() for k, one in enumerate(z)]
    return depth, owner, places, share


def box_of(mask):
    y, x = np.nonzero(mask)
    return np.array([x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1], float)


def pose(seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix()
    return rigid(R, np.array([*rng.uniform(-0.03, 0.03, 2), 0.85]))


def off(estimate, true, symmetry):
    angle, shift = rotation_translation(estimate.T_cam_part, true, motions(symmetry))
    return np.degrees(angle), 1000 * shift


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(0,), pytest.param(range(1, 12), marks=pytest.mark.slow)])
def test_the_pose_of_a_bracket_is_found_from_any_side(bracket, model, seeds):
    for seed in seeds:
        depth, mask = scan(bracket.mesh, pose(seed), seed=seed)
        estimate = find_pose(model, depth, CAMERA, mask)
        angle, shift = off(estimate, pose(seed), bracket.symmetry)
        assert angle < 2 and shift < 1, (seed, angle, shift)
        assert estimate.score > 0.6


@pytest.mark.slow
def test_missing_depth_counts_neither_for_nor_against_a_pose(bracket, model):
    """Removing depth at a known pose turns visible pixels into unknown pixels only."""
    T = pose(1)
    depth, mask = scan(bracket.mesh, T, noise_m=0.0, lost=0.0)
    estimate = find_pose(model, depth, CAMERA, mask)
    few = depth.copy()
    few[::3] = np.nan
    again = find_pose(model, few, CAMERA, mask)
    assert again.unknown > 0.25 * estimate.visible and estimate.unknown == 0
    assert again.contradicted <= estimate.contradicted + 5
    assert abs(again.visible / estimate.visible - 2 / 3) < 0.05


@pytest.mark.slow
def test_hidden_pixels_do_not_contradict_a_pose(bracket, model):
    """A plate 60 mm in front of the part hides a third of it."""
    T = pose(2)
    depth, mask = scan(bracket.mesh, T, noise_m=0.0003, lost=0.0)
    columns = np.flatnonzero(mask.any(axis=0))
    cut = columns[len(columns) * 2 // 3]
    covered = int(mask[:, cut:].sum())
    depth[:, cut:], mask[:, cut:] = 0.75, False
    estimate = find_pose(model, depth, CAMERA, mask)
    angle, shift = off(estimate, T, bracket.symmetry)
    assert angle < 3 and shift < 2
    assert abs(estimate.hidden - covered) < 0.15 * covered
    assert estimate.contradicted < 0.02 * estimate.visible + 5


@pytest.mark.slow
def test_a_wrong_part_has_a_lower_score(bracket, model):
    box = builtin_part("yellow_salt_cube")
    depth, mask = scan(bracket.mesh, pose(0))
    mine = find_pose(model, depth, CAMERA, mask)
    other = find_pose(pose_model(box.mesh, box.symmetry), depth, CAMERA, mask)
    assert other.score < 0.6 * mine.score


@pytest.mark.slow
def test_the_pose_of_a_part_is_found_in_a_box_without_a_mask(bracket, model):
    for seed in (0, 3):
        T = pose(seed)
        depth, mask = scan(bracket.mesh, T, seed=seed)
        estimate = find_pose_in_box(model, depth, CAMERA, box_of(mask))
        angle, shift = off(estimate, T, bracket.symmetry)
        assert angle < 3 and shift < 2


@pytest.mark.parametrize("seeds", [(0,), pytest.param(range(1, 4), marks=pytest.mark.slow)])
def test_the_pose_of_a_part_is_found_among_equal_parts(bracket, model, seeds):
    """The part is found in its mask, and in a box that also contains other parts."""
    for seed in seeds:
        depth, owner, places, share = heap(bracket.mesh, seed)
        free = [k for k in range(6) if share[k] >= 0.7]
        for k in free[-1:] if len(seeds) == 1 else free:
            mask = owner == k
            for estimate in (
                find_pose(model, depth, CAMERA, mask),
                find_pose_in_box(model, depth, CAMERA, box_of(mask)),
            ):
                angle, shift = off(estimate, places[k], bracket.symmetry)
                assert angle < 2 and shift < 1, (seed, k, angle, shift)


@pytest.mark.slow
def test_a_rotationally_symmetric_part_is_found_with_the_nearest_rotation(bracket, monkeypatch):
    """A truncated cone has its axis off the origin: the result has the rotation of `near`."""
    monkeypatch.setattr("graycast.robot.pose.closest.CELLS", 30)  # The preparation is faster.
    shape = trimesh.creation.revolve([[0, 0], [0.025, 0], [0.015, 0.03], [0, 0.03]], sections=48)
    shape.apply_translation([0.01, -0.02, 0.0])
    mesh = Mesh(vertices_m=np.array(shape.vertices), faces=np.array(shape.faces))
    symmetry = Symmetry(continuous=(((0.0, 0.0, 1.0), (0.01, -0.02, 0.0)),))
    T = pose(3)
    depth, mask = scan(mesh, T)
    estimate = find_pose(pose_model(mesh, symmetry), depth, CAMERA, mask, near=T)
    angle, shift = off(estimate, T, Symmetry())
    assert angle < 2 and shift < 1


def test_no_pose_is_found_from_too_little_depth(bracket, model):
    depth, mask = scan(bracket.mesh, pose(0))
    assert find_pose(model, np.full_like(depth, np.nan), CAMERA, mask).T_cam_part is None
    assert find_pose(model, depth, CAMERA, np.zeros_like(mask)).T_cam_part is None
    assert find_pose_in_box(model, depth, CAMERA, np.array([900.0, 0, 5, 5])).score == 0
    column = np.array([100.0, 0, 1, 160])  # A box of one column is searched nevertheless.
    assert find_pose_in_box(model, depth, CAMERA, column).T_cam_part is not None


@pytest.mark.slow
def test_a_symmetric_part_does_not_flip_between_noise_samples(bracket, model):
    """The bracket looks the same after half a turn; the pose nearest to `near` is returned."""
    T = pose(6)
    scans = [scan(bracket.mesh, T, seed=seed) for seed in (0, 1)]
    first, second = (find_pose(model, *_of(one)).T_cam_part for one in scans)
    assert np.trace(first[:3, :3].T @ second[:3, :3]) > 2.99  # The angle is below 6 degrees.
    for near in (T, T @ bracket.symmetry.discrete[0]):
        T_cam_part = find_pose(model, *_of(scans[0]), near=near).T_cam_part
        assert np.trace(T_cam_part[:3, :3].T @ near[:3, :3]) > 2.99


def _of(one):
    depth, mask = one
    return depth, CAMERA, mask


def test_a_picture_from_another_camera_is_refused(bracket, model):
    depth, mask = scan(bracket.mesh, pose(0))
    with pytest.raises(ValueError, match="give depth, mask and camera of one picture"):
        find_pose(model, depth[:-1], CAMERA, mask[:-1])


@pytest.mark.slow
def test_the_number_of_threads_does_not_change_the_pose(bracket, model):
    depth, mask = scan(bracket.mesh, pose(4))
    one, two = find_poses(model, depth, CAMERA, [mask, mask], threads=2)
    np.testing.assert_array_equal(one.T_cam_part, two.T_cam_part)
    np.testing.assert_array_equal(one.T_cam_part, find_pose(model, depth, CAMERA, mask).T_cam_part)


def plate(x=0.08, y=0.05, z=0.0005):
    corner = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)]) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Mesh(vertices_m=corner, faces=np.array(faces))


@pytest.mark.slow
def test_the_pose_of_a_flat_plate_is_found_with_a_limited_number_of_pairs():
    """All pairs of its points differ only in length; only its outline determines its position."""
    mesh = plate()
    turns = [np.diag([-1.0, -1, 1, 1]), np.diag([1.0, -1, -1, 1]), np.diag([-1.0, 1, -1, 1])]
    symmetry = Symmetry(discrete=tuple(turns))
    flat = pose_model(mesh, symmetry)
    assert len(flat.pairs.first) < 700**2
    T = rigid(axis_rotation("z", 0.6) @ axis_rotation("x", 0.3), np.array([0.01, 0, 0.85]))
    depth, mask = scan(mesh, T)
    angle, shift = off(find_pose(flat, depth, CAMERA, mask), T, symmetry)
    assert angle < 3 and shift < 1.5


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.12, 0.05, 0.002, -0.001, 0.0)])
def test_the_fast_rasteriser_agrees_with_the_exact_rasteriser(bracket, model, distortion):
    """Two programs render a closed mesh, whose faces that point away are invisible."""
    camera = Optics(width_px=200, height_px=160, fx_px=560.0, fy_px=560.0, cx_px=99.5,
                    cy_px=79.5, distortion=distortion)  # fmt: skip
    y, x = np.mgrid[:160, :200].astype(float)
    ray = np.ascontiguousarray(rays(camera, np.stack([x, y], axis=-1))[..., :2])
    z, face = np.empty((160, 200)), np.empty((160, 200), np.int64)
    measured, inside = np.zeros(z.shape), np.zeros(z.shape, bool)
    for array in (ray, measured, inside):  # read-only, as in a search
        array.flags.writeable = False
    window = Window(lens(camera), ray, 0, 0, measured, inside, True)
    for seed in range(3):
        draw(pose(seed), model.facets, window, Canvas(z, face))
        expected = depth_of(bracket.mesh, pose(seed), camera)
        assert (np.isfinite(z) != np.isfinite(expected)).sum() <= 2  # Rounding differs on an edge.
        both = np.isfinite(z) & np.isfinite(expected)
        assert (np.abs(z[both] - expected[both]) > 1e-12).sum() <= 2


def test_normals_and_noise_of_a_plane_are_measured_correctly():
    """A slanted plane is measured without noise, and then with noise of a known sigma."""
    normal = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
    y, x = np.mgrid[:160, :200].astype(float)
    ray = rays(CAMERA, np.stack([x, y], axis=-1))
    z = (normal @ [0, 0, 0.85]) / (ray @ normal)
    inside = np.zeros(z.shape, bool)
    inside[60:100, 80:120] = True
    view = crop(z, CAMERA, inside, tight=True, reach_m=0.01, window_m=0.005)
    known = np.isfinite(view.smooth)
    assert known.sum() >= known.size - 4  # The windows in the corners have too few pixels.
    np.testing.assert_allclose(view.smooth[known], view.z[known], rtol=1e-9)
    np.testing.assert_allclose(view.normal[known] - normal, 0, atol=1e-7)
    noisy = z + 0.0008 * np.random.default_rng(0).standard_normal(z.shape)
    view = crop(noisy, CAMERA, inside, tight=True, reach_m=0.01, window_m=0.005)
    assert view.noise_m == pytest.approx(0.0008, rel=0.15)
