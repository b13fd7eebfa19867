"""Radiance under the projector's direct light, and positions of shadows."""

import numpy as np
import pytest
from backends import direct_light
from scipy import ndimage
from stage import (
    askew_rig,
    centre_rays,
    centred,
    in_camera,
    lambert,
    leaning_wall,
    make_rig,
    optics,
    plain_pattern,
    wall,
)

from graycast.base.frames import inverse, transform_points
from graycast.rendering import Quality
from graycast.world.scene import EMPTY_LAYOUT, Quad, Sphere


def test_a_lambertian_plane_has_radiance_albedo_over_pi_times_irradiance(renderer):
    """L = albedo / pi * I cos(theta) / d^2, and white, half and black patterns in proportion.

    L is linear over a pixel to 1e-4, so its mean is the value at the centre; the mean of 64 evenly
    spread positions is within a twentieth of a pixel of the centre.
    """
    albedo, weights = np.array([0.8, 0.5, 0.2]), np.array([0.5, 0.3, 0.2])
    rig = askew_rig(intensity_w_sr=7.0, band_weights=tuple(weights.tolist()))
    normal = np.array([0.3, 0.4, 1.0]) / np.linalg.norm([0.3, 0.4, 1.0])
    scene = in_camera(rig, leaning_wall(normal, 0.8, lambert(*albedo.tolist())))
    pattern = plain_pattern(rig, 255, 128, 0)
    image = renderer.render(
        scene, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=1
    ).radiance

    ray = centre_rays(rig.camera)
    point = ray * (0.8 / (ray @ normal))[..., None]
    to_lens = rig.T_cam_proj[:3, 3] - point
    distance = np.linalg.norm(to_lens, axis=-1)
    irradiance = 7.0 * (to_lens @ -normal) / distance**3
    in_proj = transform_points(inverse(rig.T_cam_proj), point)
    u = rig.projector.fx_px * in_proj[..., 0] / in_proj[..., 2] + rig.projector.cx_px
    v = rig.projector.fy_px * in_proj[..., 1] / in_proj[..., 2] + rig.projector.cy_px
    lit = (u > 1) & (u < 62) & (v > 1) & (v < 46)
    assert lit.sum() > 4000

    slope = np.abs(np.gradient(irradiance)).sum(axis=0) / irradiance
    tolerance = (1e-4 + 0.05 * slope)[lit]
    assert tolerance.max() < 3e-3

    mono = (albedo @ weights) / np.pi * irradiance
    assert (np.abs(image.pattern[0] / mono - 1)[lit] < tolerance).all()
    assert (np.abs(image.pattern[1] / mono * 255 / 128 - 1)[lit] < tolerance).all()
    assert not image.pattern[2].any()
    rgb = irradiance[..., None] / np.pi * albedo * weights
    assert (np.abs(image.white_rgb / rgb - 1)[lit] < tolerance[:, None]).all()
    assert np.abs(image.albedo - albedo).max() < 1e-5
    assert not image.ambient_rgb.any()


def test_a_surface_that_faces_away_from_the_projector_is_dark(renderer):
    """The camera sees its front, while the projector is behind its plane."""
    rig = make_rig(optics(96, 72, 110), optics(64, 48, 40), baseline_m=(0.4, 0.0, 0.0))
    normal = np.array([0.9, 0.0, 0.3])  # the plane passes between the two lenses
    scene = in_camera(rig, leaning_wall(normal, 0.2, lambert(0.9)))
    pattern = plain_pattern(rig, 255)
    rendering = renderer.render(
        scene, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=0
    )
    assert np.isfinite(rendering.truth.depth_m).mean() > 0.8
    assert not rendering.radiance.white_rgb.any()


def test_the_back_of_a_quad_is_dark(renderer):
    rig = askew_rig()
    front = wall(0.8, lambert(0.9))
    back = Quad(
        center_m=front.center_m,
        half_u_m=front.half_v_m,
        half_v_m=front.half_u_m,
        material=front.material,
    )
    pattern = plain_pattern(rig, 255)
    scene = in_camera(rig, back)
    rendering = renderer.render(
        scene, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=0
    )
    assert np.isfinite(rendering.truth.depth_m).all()
    assert not rendering.radiance.pattern.any()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [1, -1])
def test_a_shadow_falls_away_from_the_projector_at_the_expected_width(renderer, axis, side):
    """A black square in front of a wall: a line has f s / z1 dark pixels of the square itself and f
    b (1 / z1 - 1 / z2) of its shadow, on the side away from the projector.
    """
    f_px, z1, z2, half_m, baseline_m = 110.0, 0.7, 1.0, 0.11, 0.25
    baseline = np.zeros(3)
    baseline[axis] = side * baseline_m
    camera = centred(96, 9, f_px) if axis == 0 else centred(9, 96, f_px)
    rig = make_rig(camera, centred(64, 64, 24), baseline_m=tuple(baseline.tolist()))
    pattern = plain_pattern(rig, 255)
    square, back = wall(z1, lambert(0.0), half_m=half_m), wall(z2, lambert(0.5))
    with_square, without = (
        renderer.render(
            scene, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=0
        ).radiance.pattern[0]
        for scene in (in_camera(rig, back, square), in_camera(rig, back))
    )
    assert (without > 0).all()
    dark = 1 - with_square / without
    line = dark[4] if axis == 0 else dark[:, 4]
    width_px = f_px * baseline_m * (1 / z1 - 1 / z2)
    square_px = 2 * half_m * f_px / z1
    edge = 47.5 + side * 0.5 * square_px  # towards the projector, which lights all beyond it
    beyond = (np.arange(96) - edge) * side > 0.6
    assert np.abs(line[beyond]).max() < 0.02
    assert abs(line.sum() - square_px - width_px) < 0.2  # two border pixels, 1/16 each at worst
    far_end = edge - side * (square_px + width_px)
    assert np.abs(line[(far_end - np.arange(96)) * side > 0.6]).max() < 0.02


def test_the_shadow_of_a_sphere_falls_away_from_the_projector(renderer):
    """Oracle: the cone from the lens around the sphere, cut with the wall."""
    rig = make_rig(centred(96, 72, 80.0), centred(64, 48, 22), baseline_m=(0.2, 0.0, 0.0))
    centre, radius, wall_m = np.array([0.0, 0.0, 0.7]), 0.06, 1.0
    sphere = Sphere(center_m=tuple(centre.tolist()), radius_m=radius, material=lambert(0.5))
    scene = in_camera(rig, wall(wall_m, lambert(0.5)), sphere)
    pattern = plain_pattern(rig, 255)
    rendering = renderer.render(
        scene, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=0
    )
    on_wall = ndimage.binary_erosion(rendering.truth.depth_m > 0.99, np.ones((3, 3)))
    dark = on_wall & (rendering.radiance.pattern[0] < 1e-6)
    point = centre_rays(rig.camera) * wall_m
    to_point = point - rig.T_cam_proj[:3, 3]
    to_centre = centre - rig.T_cam_proj[:3, 3]
    length = np.linalg.norm(to_centre)
    cosine = (to_point @ to_centre) / np.linalg.norm(to_point, axis=-1) / length
    angle, half_angle = np.arccos(cosine), np.arcsin(radius / length)
    slack = 1.0 / 80.0  # one pixel
    assert dark[on_wall & (angle < half_angle - slack)].all()
    assert not dark[angle > half_angle + slack].any()
    assert dark.sum() > 50 and (np.nonzero(dark)[1] < 48).all()


def test_rendering_twice_with_one_seed_gives_equal_bits(renderer):
    rig = askew_rig(camera=optics(40, 30, 50))
    scene = in_camera(rig, wall(0.9, lambert(0.5)))
    pattern = np.random.default_rng(1).integers(0, 2, (3, 48, 64)).astype(np.uint8) * 255
    quality = Quality(samples=4, depth=1)
    one, again = (
        renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=0) for _ in range(2)
    )
    assert np.array_equal(one.radiance.pattern, again.radiance.pattern)
    assert np.array_equal(one.radiance.white_rgb, again.radiance.white_rgb)
    assert np.array_equal(one.truth.depth_m, again.truth.depth_m)
