"""Scenes reconstructed from a scan have the surfaces, edges and shadows of the original."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.real.depth_solid import surfaces
from graycast.real.realism import DepthScan
from graycast.real.twin.restaging import _ROUNDS, _covered, layout_of, restage, standing_before
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig
from graycast.world.parts import Material, Mesh
from graycast.world.scene import Bin, Scene, bin_mesh

WIDTH_PX, HEIGHT_PX, F_PX = 240, 180, 250.0
SIGMA_M = 2e-4
T_WORLD_CAM = rigid(axis_rotation("x", np.pi), np.array([0.01, -0.02, 0.75]))
PROJECTOR_M = np.array([-0.2, 0.0, 0.0])  # in the camera frame


def camera(finer=1):
    """Return the camera, with `finer` times as many pixels along each axis."""
    return Optics(
        width_px=finer * WIDTH_PX,
        height_px=finer * HEIGHT_PX,
        fx_px=finer * F_PX,
        fy_px=finer * F_PX,
        cx_px=(finer * WIDTH_PX - 1) / 2,
        cy_px=(finer * HEIGHT_PX - 1) / 2,
    )


def bin_scene():
    rig = Rig(
        name="small",
        camera=camera(),
        projector=camera(),
        T_cam_proj=rigid(np.eye(3), PROJECTOR_M),
        near_m=0.4,
        far_m=1.0,
    )
    box = Bin(inner_m=(0.6, 0.45, 0.1), material=Material(base_color=(0.05,) * 3))
    return Scene(rig=rig, T_world_cam=T_WORLD_CAM, bin=box)


def things():
    """Return an inclined box, a sphere and a narrow tower in the world frame."""
    block = trimesh.creation.box((0.12, 0.08, 0.04))
    block.apply_transform(rigid(axis_rotation("y", 0.4), np.array([-0.1, 0.05, 0.06])))
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.035)
    ball.apply_translation((0.08, 0.07, 0.035))
    tower = trimesh.creation.box((0.012, 0.1, 0.09))
    tower.apply_translation((0.06, -0.08, 0.045))
    return trimesh.util.concatenate([block, ball, tower])


def depth_of(vertices_m, faces, optics, T_cam_world):
    """Return z-depth; NaN without a surface."""
    return rasterize(transform_points(T_cam_world, vertices_m), faces, optics).over(optics)[1]


def of_thing(optics, thing=None):
    thing = things() if thing is None else thing
    return depth_of(np.array(thing.vertices), np.array(thing.faces), optics, inverse(T_WORLD_CAM))


def of_bin(optics):
    mesh = bin_mesh(bin_scene().bin)
    return depth_of(mesh.vertices_m, mesh.faces, optics, inverse(T_WORLD_CAM))


def of_part(staged, optics, T_cam_world=None):
    mesh = staged.parts[0].mesh
    T = inverse(T_WORLD_CAM) if T_cam_world is None else T_cam_world
    return depth_of(mesh.vertices_m, mesh.faces, optics, T)


def scan_of(depth_m, name="scan"):
    K = np.array([[F_PX, 0, (WIDTH_PX - 1) / 2], [0, F_PX, (HEIGHT_PX - 1) / 2], [0, 0, 1]])
    return DepthScan(name=name, depth_m=depth_m, K=K)


def noisy_scan(seed=0, thing=None):
    """Return a scan with noise and holes, in which pixels that see two surfaces have no depth."""
    rng = np.random.default_rng(seed)
    depth_m = np.fmin(of_thing(camera(), thing), of_bin(camera()))
    fine = np.isfinite(of_thing(camera(4), thing)).reshape(HEIGHT_PX, 4, WIDTH_PX, 4)
    covered = fine.mean(axis=(1, 3))
    depth_m = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
    depth_m[(covered > 0) & (covered < 1)] = np.nan
    depth_m[rng.random(depth_m.shape) < 0.01] = np.nan
    return scan_of(depth_m)


@pytest.fixture(scope="module")
def staged():
    (scene,) = restage([noisy_scan()], bin_scene())
    return scene


def test_the_surface_covers_every_pixel_and_has_little_noise(staged):
    """Paraboloids leave a fifth of the noise, and edges are hardly rounded."""
    truth_m, part_m = of_thing(camera()), of_part(staged, camera())
    inner = np.isfinite(truth_m) & np.isfinite(noisy_scan().depth_m)
    assert np.isfinite(part_m[inner]).all()  # There are no gaps or cracks.
    off_m = np.abs(part_m - truth_m)[inner]
    assert np.median(off_m) < 0.3 * SIGMA_M
    assert np.quantile(off_m, 0.95) < 2 * SIGMA_M
    assert np.quantile(off_m, 0.99) < 2e-3
    elsewhere = np.isfinite(part_m) & ~np.isfinite(truth_m) & np.isfinite(noisy_scan().depth_m)
    assert elsewhere.sum() < 0.003 * inner.sum()


def test_edges_divide_pixels_that_see_two_surfaces(staged):
    """At four times the resolution, the objects cover the same area up to 2 %."""
    truth, part = (np.isfinite(one) for one in (of_thing(camera(4)), of_part(staged, camera(4))))
    assert part.sum() / truth.sum() == pytest.approx(1, abs=0.02)
    assert (part != truth).sum() < 0.06 * truth.sum()


def test_a_pixel_without_depth_keeps_its_shares_of_two_surfaces():
    """A pixel between white and dark is divided so that both send equal light to it."""
    known = np.array([[True, True, False, True, True, False, False, False, True]])
    light = np.array([[0.8, 0.8, 0.5, 0.05, 0.05, 0.5, 0.5, 0.5, 0.8]])
    left, right, up, down = np.moveaxis(_covered(known, light), -1, 0)
    assert right[0, 1] == pytest.approx(0.05 / 0.85)
    assert left[0, 3] == pytest.approx(0.8 / 0.85)
    assert right[0, 1] + left[0, 3] == pytest.approx(1)  # Both have the edge at one position.
    assert right[0, 4] == left[0, 8] == 0.5  # These pixels are next to a shadow.
    assert not right[0, 0] and not left[0, 1] and not up[known].any() and not down[known].any()


@pytest.mark.slow
def test_flat_surfaces_have_few_triangles_and_no_cracks(staged):
    """If a large square meets small squares, their corners must be on its side."""
    mesh = staged.parts[0].mesh
    covered = np.isfinite(of_part(staged, camera())).sum()
    assert len(mesh.faces) < 0.8 * 2 * covered  # Most pixels of small objects are next to a rim.
    board = trimesh.creation.box((0.3, 0.2, 0.03))
    board.apply_translation((0, 0, 0.015))
    (scene,) = restage([scan_of(np.fmin(of_thing(camera(), board), of_bin(camera())))], bin_scene())
    flat_px = np.isfinite(of_part(scene, camera())).sum()
    assert len(scene.parts[0].mesh.faces) < 0.35 * 2 * flat_px
    for one, thing in ((staged, things()), (scene, board)):
        inside = ndimage.binary_erosion(np.isfinite(of_thing(camera(5), thing)), iterations=8)
        assert np.isfinite(of_part(one, camera(5))[inside]).mean() > 0.9999


@pytest.mark.slow
def test_shadows_equal_those_of_the_true_objects(staged):
    """Oracle: the shadows of the true objects in the view of the projector's pinhole.

    A surface without sides would let light pass below the tower and the inclined box.
    """
    T_proj_world = rigid(np.eye(3), -PROJECTOR_M) @ inverse(T_WORLD_CAM)
    true, solid = things(), staged.parts[0].mesh

    def lit(vertices_m, faces):
        behind_m = np.fmin(
            depth_of(vertices_m, faces, camera(2), T_proj_world), of_floor(T_proj_world)
        )
        floor_m = of_bin(camera())
        y, x = np.nonzero(np.isfinite(floor_m) & ~np.isfinite(of_thing(camera())))
        z_m = floor_m[y, x]
        own = camera()
        point = (
            np.column_stack([(x - own.cx_px) / F_PX * z_m, (y - own.cy_px) / F_PX * z_m, z_m])
            - PROJECTOR_M
        )
        pixel = np.round(
            2 * F_PX * point[:, :2] / point[:, 2:] + [camera(2).cx_px, camera(2).cy_px]
        )
        column, row = pixel.astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < 2 * WIDTH_PX) & (row < 2 * HEIGHT_PX)
        shadow = np.zeros(len(x), dtype=bool)
        shadow[inside] = behind_m[row[inside], column[inside]] < point[inside, 2] - 3e-3
        return ~shadow

    def of_floor(T_cam_world):
        mesh = bin_mesh(bin_scene().bin)
        return depth_of(mesh.vertices_m, mesh.faces, camera(2), T_cam_world)

    truly = lit(np.array(true.vertices), np.array(true.faces))
    by_solid = lit(solid.vertices_m, solid.faces)
    assert (~truly).sum() > 500
    assert (truly != by_solid).sum() < 0.08 * (~truly).sum()
    flat = trimesh.Trimesh(solid.vertices_m, solid.faces, process=False)
    to_camera = flat.triangles_center - T_WORLD_CAM[:3, 3]
    along = np.abs((flat.face_normals * to_camera).sum(axis=1)) / np.linalg.norm(to_camera, axis=1)
    top = solid.faces[along > 0.02]  # Sides are parallel to the camera's rays.
    sheet = lit(solid.vertices_m, top)
    assert (sheet & ~truly).sum() > 2 * (by_solid & ~truly).sum()


def test_only_small_gaps_in_a_surface_are_closed():
    board = trimesh.creation.box((0.2, 0.2, 0.03))
    board.apply_translation((0, 0, 0.015))
    depth_m = noisy_scan(thing=board).depth_m.copy()
    middle_y, middle_x = (
        np.argwhere(np.isfinite(of_thing(camera(), board))).mean(axis=0).astype(int)
    )
    small = np.s_[middle_y - 18 : middle_y - 12, middle_x : middle_x + 8]
    large = np.s_[middle_y : middle_y + 12, middle_x : middle_x + 12]
    depth_m[small] = depth_m[large] = np.nan
    (scene,) = restage([scan_of(depth_m)], bin_scene())
    part_m, truth_m = of_part(scene, camera()), of_thing(camera(), board)
    assert np.abs(part_m - truth_m)[small].max() < 1e-3
    assert np.isnan(part_m[large][1:-1, 1:-1]).all()


def test_noise_on_the_bin_is_not_taken_for_an_object():
    scan = scan_of(noisy_scan().depth_m)
    solid = standing_before(scan.depth_m, of_bin(camera()))
    assert not (solid & ~np.isfinite(of_thing(camera()))).sum() > 0.002 * solid.sum()
    rng = np.random.default_rng(3)
    empty = of_bin(camera()) + SIGMA_M * rng.standard_normal((HEIGHT_PX, WIDTH_PX))
    (scene,) = restage([scan_of(empty)], bin_scene())
    assert scene.parts == () and len(layout_of(scene).part_index) == 0


def test_smoothing_keeps_a_plane_and_a_sharp_edge():
    """Two planes meet at a ridge, which a mean over the window would lower by 0.6 mm."""
    x = np.mgrid[:60, :80][1].astype(float)
    inverse_m = 1.4 + 2e-3 * np.abs(x - 39.5)
    planes = surfaces(1 / inverse_m, np.ones(x.shape, dtype=bool), _ROUNDS)
    off_m = np.abs(1 / planes[..., 0] - 1 / inverse_m)
    assert off_m[:, 10:30].max() < 1e-5
    assert off_m.max() < 3e-4
    assert planes[30, 20, 1] == pytest.approx(-2e-3, abs=1e-5)
    assert planes[30, 60, 1] == pytest.approx(2e-3, abs=1e-5)


def painted(height_px, width_px, color=(200, 100, 50)):
    return np.full((height_px, width_px, 3), color, dtype=np.uint8)


@pytest.mark.slow
def test_pictures_are_converted_to_reflectances_with_white_as_the_brightest():
    """All pictures have one factor; the second is half as bright in linear light."""
    first, second = (
        painted(2 * HEIGHT_PX, 2 * WIDTH_PX),
        painted(HEIGHT_PX, WIDTH_PX, (146, 71, 33)),
    )
    first[: HEIGHT_PX // 2] = 0  # A picture that is mapped onto depth is black without colour.
    staged = restage([noisy_scan(0), noisy_scan(1)], bin_scene(), [first, second])
    a, b = (one.parts[0].material.texture for one in staged)
    assert a.shape == first.shape
    assert (a == a[-1, -1]).all()  # The nearest colour replaces missing colours.

    def light(value):
        share = value / 255
        return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)

    assert light(a[0, 0])[0] == pytest.approx(0.8, abs=0.01)
    assert light(a[0, 0])[1] / light(a[0, 0])[0] == pytest.approx(light(100) / light(200), rel=0.03)
    assert light(b[0, 0])[0] == pytest.approx(0.4, abs=0.01)
    assert light(b[0, 0])[2] == pytest.approx(0.03, abs=0.002)  # the smallest reflectance


def test_a_texture_is_placed_on_the_surface_in_its_picture(staged):
    """The uv coordinates of a vertex are its position in the picture."""
    part = staged.parts[0]
    mesh: Mesh = part.mesh
    corner = transform_points(inverse(T_WORLD_CAM), mesh.vertices_m[mesh.faces].reshape(-1, 3))
    pixel = F_PX * corner[:, :2] / corner[:, 2:] + [(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2]
    uv = mesh.corner_uv.reshape(-1, 2)
    np.testing.assert_allclose(uv[:, 0], (pixel[:, 0] + 0.5) / WIDTH_PX, atol=1e-9)
    np.testing.assert_allclose(uv[:, 1], 1 - (pixel[:, 1] + 0.5) / HEIGHT_PX, atol=1e-9)


def test_a_bin_at_another_place_is_refused():
    """The bin is 10 mm too low and shifted, so the whole scan would be one object."""
    scene, off_m = bin_scene(), np.array([0.02, 0.02, 0.01])
    lower = replace(scene, T_world_cam=rigid(np.eye(3), off_m) @ T_WORLD_CAM)
    with pytest.raises(GraycastError, match=r"within 1\.5 mm of the bin: check the bin"):
        restage([noisy_scan()], lower)


def test_pictures_that_do_not_fit_the_scans_are_refused():
    scans = [noisy_scan()]
    with pytest.raises(GraycastError, match="2 colour pictures are given for 1 scans"):
        restage(scans, bin_scene(), [painted(HEIGHT_PX, WIDTH_PX)] * 2)
    with pytest.raises(GraycastError, match="has 240 x 240 pixels and the depth map 240 x 180"):
        restage(scans, bin_scene(), [painted(240, 240)])
    with pytest.raises(GraycastError, match="has 120 x 90 pixels"):
        restage(scans, bin_scene(), [painted(90, 120)])
