"""Scenes from images of a dataset: surfaces, objects, materials and shadows."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.camera.scanner import preset
from graycast.real.rescan.source import SourceImage
from graycast.real.rescan.staging import BACKGROUND, _membrane, reflectance_of, stage, with_camera
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics
from graycast.world.parts import Material, Mesh, Part

from .scene_files import FACES, corners

CAMERA = Optics(width_px=160, height_px=120, fx_px=200.0, fy_px=201.0, cx_px=80.5, cy_px=58.0)
BENT = replace(CAMERA, distortion=(-0.1, 0.02, 1e-3, 0.0, 0.0))
T_CAM_CUBE = rigid(axis_rotation("x", 0.5) @ axis_rotation("z", 0.7), np.array([0.03, -0.02, 0.6]))
# The floor is oblique to the camera; a step of 60 mm on it belongs to no model.
FLOOR = np.array([0.05, -0.25, -1.0, 0.75])  # a x + b y + c z + d = 0
STEP_M = 1e-4


def part(side_m=0.06, material=None):
    mesh = Mesh(vertices_m=corners(side_m), faces=FACES)
    look = material or Material()
    return Part(name="cube", mesh=mesh, material=look, density_kg_m3=1000.0, friction=0.5)


def rays():
    x, y = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    of = [(x - CAMERA.cx_px) / CAMERA.fx_px, (y - CAMERA.cy_px) / CAMERA.fy_px, np.ones(x.shape)]
    return np.stack(of, axis=-1)


def plane_m(raised_m=0.0):
    """Return the depth of the floor, or of a plane above it."""
    return -(FLOOR[3] - raised_m) / (rays() @ FLOOR[:3])


def without_cube():
    x = np.arange(CAMERA.width_px)
    return np.where(x < 30, plane_m(0.06), plane_m())


def cube_m(T=T_CAM_CUBE, side_m=0.06):
    return rasterize(transform_points(T, corners(side_m)), FACES, CAMERA).over(CAMERA)[1]


def image(depth_m=None, rgb=None, T=T_CAM_CUBE, step_m=STEP_M):
    depth_m = np.fmin(without_cube(), cube_m()) if depth_m is None else depth_m
    steps = np.rint(depth_m / step_m) * step_m
    return SourceImage(
        camera=CAMERA,
        depth_m=steps,
        rgb=rgb,
        obj_id=np.array([7]),
        T_cam_part=T[None],
        step_m=step_m,
    )


def staged(source=None, parts=None, **words):
    scanner = with_camera(preset("like-phoxi-m"), CAMERA)
    parts = {7: part()} if parts is None else parts
    return stage(source or image(), parts, scanner, **words)


def depth_of(result, camera=CAMERA, T_cam_world=None, kinds=("cube", BACKGROUND)):
    """Return z of the staged scene in another camera."""
    T_cam_world = np.eye(4) if T_cam_world is None else T_cam_world
    z_m = np.full((camera.height_px, camera.width_px), np.nan)
    for T, k in zip(result.layout.T_world_part, result.layout.part_index, strict=True):
        mesh = result.scene.parts[k].mesh
        if result.scene.parts[k].name in kinds:
            vertices = transform_points(T_cam_world @ T, mesh.vertices_m)
            z_m = np.fmin(z_m, rasterize(vertices, mesh.faces, camera).over(camera)[1])
    return z_m


def test_every_pixel_of_a_staged_scene_keeps_its_depth():
    result = staged()
    assert [p.name for p in result.scene.parts] == ["cube", BACKGROUND]
    assert [p.labelled for p in result.scene.parts] == [True, False]
    assert result.obj_id == (7,)
    off_m = np.abs(depth_of(result) - image().depth_m)
    assert np.isfinite(off_m).all()
    assert np.quantile(off_m, 0.97) < STEP_M  # The other pixels are at rims.
    own = np.isfinite(cube_m()) & (cube_m() < without_cube())
    np.testing.assert_allclose(depth_of(result, kinds=("cube",))[own], cube_m()[own], atol=1e-9)


def test_the_floor_has_the_shading_normals_of_its_plane():
    """Steps of 0.1 mm in depth tilt the facets more than the shading normals."""
    mesh = staged(parts={}, source=image(plane_m())).scene.parts[-1].mesh
    normal = FLOOR[:3] / np.linalg.norm(FLOOR[:3])
    top = mesh.face_normal @ normal > 0.9
    tilt_deg = np.degrees(np.arccos(np.clip(mesh.corner_normals[top] @ normal, -1, 1)))
    facet_deg = np.degrees(np.arccos(np.clip(mesh.face_normal[top] @ normal, -1, 1)))
    assert np.sqrt((tilt_deg**2).mean()) < 0.5 * np.sqrt((facet_deg**2).mean())


def test_a_stated_background_replaces_the_background_of_the_picture():
    source = image(rgb=np.full((*plane_m().shape, 3), 90, np.uint8))
    assert staged(source).scene.parts[-1].material.texture is not None
    stated = Material(base_color=(0.2, 0.3, 0.4), roughness=0.7)
    assert staged(source, background=stated).scene.parts[-1].material == stated


def test_the_floor_continues_behind_an_object():
    """A membrane whose border is in a plane is this plane, also behind the cube."""
    behind_m = depth_of(staged(), kinds=(BACKGROUND,))
    own = np.isfinite(cube_m()) & (cube_m() < without_cube())
    assert own.sum() > 300
    assert np.abs(behind_m - plane_m())[own].max() < 4e-3
    assert np.median(np.abs(behind_m - plane_m())[own]) < 5e-4


def test_filled_depth_is_within_the_range_of_the_surrounding_depth():
    rng = np.random.default_rng(0)
    depth_m = 0.6 + 0.1 * rng.random((40, 50))
    depth_m[10:30, 5:45] = np.nan
    filled = _membrane(depth_m)
    hole = np.isnan(depth_m)
    assert np.isfinite(filled).all()
    assert np.nanmin(depth_m) <= filled[hole].min() and filled[hole].max() <= np.nanmax(depth_m)
    np.testing.assert_array_equal(filled[~hole], depth_m[~hole])


def test_shadows_equal_those_of_the_whole_scene():
    """Oracle: the view of a projector at the side on the true cube, compared with the staged scene.

    The step is left out: the camera does not see its far side, which is assumed to be solid.
    """
    projector = replace(CAMERA, width_px=320, height_px=240, cx_px=160.0, cy_px=120.0)
    T_proj_cam = inverse(rigid(axis_rotation("y", -0.35), np.array([0.25, 0.0, 0.0])))
    stage_m = depth_of(staged(), projector, T_proj_cam)
    cube_alone = rasterize(
        transform_points(T_proj_cam @ T_CAM_CUBE, corners(0.06)), FACES, projector
    ).over(projector)[1]
    point = transform_points(T_proj_cam, (rays() * plane_m()[..., None]).reshape(-1, 3))
    floor_alone = np.isfinite(plane_m()).ravel() & np.isnan(cube_m()).ravel()
    floor_alone &= np.tile(np.arange(CAMERA.width_px) > 40, CAMERA.height_px)
    pixel = np.rint(point[:, :2] / point[:, 2:] * [200, 201] + [160, 120]).astype(int)
    inside = ((pixel >= 0) & (pixel < [320, 240])).all(axis=1) & floor_alone
    column, row = pixel[inside].T

    def shadow(z_m):
        with np.errstate(invalid="ignore"):
            return z_m[row, column] < point[inside, 2] - 4e-3

    true, of_stage = shadow(cube_alone), shadow(stage_m)
    assert true.sum() > 100
    assert (true & of_stage).sum() / (true | of_stage).sum() > 0.93


def test_an_unknown_object_hides_a_known_object_behind():
    """Depth shows a rod without a model in front of the cube."""
    depth_m = np.fmin(without_cube(), cube_m())
    rod = np.zeros(depth_m.shape, dtype=bool)
    rod[:, 85:93] = True
    depth_m[rod] = 0.45
    stage_m = depth_of(staged(image(depth_m)))
    assert np.abs(stage_m[:, 86:92] - 0.45).max() < 1e-3


@pytest.mark.parametrize(
    ("part_side_m", "moved_m", "words"), [(0.3, 0.0, "farther"), (0.06, 0.12, "unit of the models")]
)
def test_objects_that_contradict_the_depth_are_refused(part_side_m, moved_m, words):
    T = rigid(np.eye(3), np.array([0.0, 0.0, -moved_m])) @ T_CAM_CUBE
    with pytest.raises(DatasetError, match=words):
        staged(image(T=T), {7: part(part_side_m)})


def test_depth_without_models_becomes_one_solid():
    result = staged(parts={})
    assert [p.name for p in result.scene.parts] == [BACKGROUND] and result.obj_id == ()
    off_m = np.abs(depth_of(result) - image().depth_m)
    assert np.quantile(off_m, 0.95) < 2 * STEP_M


def test_an_object_that_fills_the_picture_has_a_background():
    T = rigid(np.eye(3), np.array([0.0, 0.0, 0.6]))
    result = staged(image(cube_m(T, side_m=0.9), T=T), {7: part(0.9)})
    assert np.isfinite(depth_of(result, kinds=(BACKGROUND,))).all()
    with pytest.raises(DatasetError, match="no depth at all"):
        staged(image(np.full(without_cube().shape, np.nan)))


def test_materials_come_from_the_picture_if_none_are_stated():
    rgb = np.full((*without_cube().shape, 3), 188, dtype=np.uint8)  # half as much light as 255
    rgb[:4] = 255
    own = np.isfinite(cube_m()) & (cube_m() < without_cube())
    rgb[own] = [137, 0, 255]
    reflectance = reflectance_of(rgb)
    assert reflectance[0, 0] == pytest.approx([0.8, 0.8, 0.8])
    assert reflectance[-1, 0] == pytest.approx([0.4, 0.4, 0.4], rel=0.02)
    result = staged(image(rgb=rgb), unknown_look={7})
    assert result.scene.parts[0].material.base_color == pytest.approx((0.2, 0.03, 0.8), rel=0.03)
    steel = Material(base_color=(0.6, 0.6, 0.6), metallic=1.0, roughness=0.3)
    with_material = staged(image(rgb=rgb), {7: part(material=steel)})
    assert with_material.scene.parts[0].material == steel
    texture = with_material.scene.parts[1].material.texture
    # The floor's texture must not show the cube.
    assert texture is not None and (texture[own] == texture[-1, 0]).all()


def test_another_camera_keeps_the_lens_of_the_scanner():
    """Focal length in metres, aperture and angular blur do not change."""
    scanner = preset("like-phoxi-m")
    own = with_camera(scanner, BENT)
    assert own.rig.camera.K == pytest.approx(CAMERA.K)
    assert own.rig.camera.distortion == BENT.distortion != scanner.rig.camera.distortion
    for one in (scanner, own):
        focal_m = one.rig.camera.fx_px * one.sensor.pixel_pitch_m
        assert focal_m == pytest.approx(scanner.rig.camera.fx_px * scanner.sensor.pixel_pitch_m)
    assert own.rig.camera.aperture_m == scanner.rig.camera.aperture_m
    np.testing.assert_array_equal(own.rig.T_cam_proj, scanner.rig.T_cam_proj)
    blurred = replace(
        scanner, rig=replace(scanner.rig, camera=replace(scanner.rig.camera, psf_px=2.0))
    )
    narrow = with_camera(blurred, CAMERA).rig.camera
    assert narrow.psf_px / narrow.fx_px == pytest.approx(2.0 / scanner.rig.camera.fx_px)
