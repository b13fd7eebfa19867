"""The validator's rasteriser, compared with ray tracing in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from prisms import HEIGHT, WIDTH, build_sample, hit_depth

from graycast.base.frames import inverse, pixel_grid, rigid, transform_points
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import rays


def on_image(raster, shape):
    image = np.full(shape, np.nan)
    for (i, j), z in np.ndenumerate(raster.z):
        v, u = i + raster.top_px, j + raster.left_px
        if 0 <= v < shape[0] and 0 <= u < shape[1]:
            image[v, u] = z
    return image


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.25, 0.08, 0.002, -0.003, 0.0)])
def test_raster_depth_of_a_convex_body_equals_the_depth_of_its_half_spaces(parts, rig, distortion):
    """A distorted lens is included: rays are bent, the part is not."""
    camera = replace(rig.camera, distortion=distortion)
    ray = rays(camera, pixel_grid(HEIGHT, WIDTH))
    sample = build_sample(11, parts=parts, rig=rig)
    T_cam_part = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part
    covered = 0
    for T, p in zip(T_cam_part, sample.layout.part_index, strict=True):
        mesh = parts[p].mesh
        z = on_image(
            rasterize(transform_points(T, mesh.vertices_m), mesh.faces, camera), (HEIGHT, WIDTH)
        )
        exact = hit_depth(mesh, T, ray[..., 0], ray[..., 1])
        assert np.array_equal(np.isnan(z), np.isnan(exact))
        assert np.nanmax(np.abs(z - exact), initial=0.0) < 1e-9
        covered += int((~np.isnan(z)).sum())
    assert covered > 3000


def test_edges_that_the_lens_bends_outwards_lose_no_pixel(parts, rig):
    """The part fills the image: its straight edges extend beyond their end points."""
    camera = replace(rig.camera, distortion=(-0.25, 0.08, 0.002, -0.003, 0.0))
    ray = rays(camera, pixel_grid(HEIGHT, WIDTH))
    mesh = parts[0].mesh
    for x_m in (-0.02, 0.0, 0.02):
        T = rigid(np.eye(3)[[1, 2, 0]], np.array([x_m, 0.0, 0.1]))
        raster = rasterize(transform_points(T, mesh.vertices_m), mesh.faces, camera)
        exact = hit_depth(mesh, T, ray[..., 0], ray[..., 1])
        assert np.array_equal(np.isnan(on_image(raster, (HEIGHT, WIDTH))), np.isnan(exact))


def test_silhouettes_extend_beyond_the_borders_by_one_image(parts, rig):
    """Oracle: the ray-traced canvas of three by three images."""
    sample = build_sample(12, parts=parts, rig=rig)
    T_cam_part = inverse(sample.scene.T_world_cam) @ sample.layout.T_world_part
    for T, p, crop in zip(T_cam_part, sample.layout.part_index, sample.truth.amodal, strict=True):
        mesh = parts[p].mesh
        raster = rasterize(transform_points(T, mesh.vertices_m), mesh.faces, rig.camera)
        assert int((~np.isnan(raster.z)).sum()) == int(crop.mask.sum())


def test_surfaces_behind_the_camera_are_not_drawn(parts, rig):
    mesh = parts[0].mesh
    behind = mesh.vertices_m - np.array([0.0, 0.0, 0.5])
    assert rasterize(behind, mesh.faces, rig.camera).z.size == 0
    aside = transform_points(rigid(np.eye(3), np.array([9.0, 0.0, 0.5])), mesh.vertices_m)
    assert rasterize(aside, mesh.faces, rig.camera).z.size == 0
