"""Geometry: pixels, depth, normals, handedness, distortion of both lenses."""

import cv2
import numpy as np
import pytest
from stage import (
    askew_rig,
    centre_rays,
    in_camera,
    lambert,
    leaning_wall,
    make_rig,
    optics,
    plain_pattern,
    wall,
)

from graycast.rendering import Quality
from graycast.rig.pattern import gray
from graycast.world.scene import EMPTY_LAYOUT, Quad, Sphere

GRAY = lambert(0.5)
FLOAT32 = 2e-6  # share of a depth: some roundings of 6e-8 each
LENS = (-0.21, 0.11, 0.004, -0.003, -0.02)


def render(renderer, scene, pattern=None, *, samples=4):
    pattern = plain_pattern(scene.rig, 255) if pattern is None else pattern
    quality = Quality(samples=samples, depth=1)
    return renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=0)


def test_depth_of_a_plane_is_z_where_the_ray_of_the_pixel_centre_meets_it(renderer):
    """Oracle: z = d / (n . ray). Half a pixel would change z by over 1e-3 of its value here."""
    rig = askew_rig()
    normal, offset_m = np.array([0.6, -0.3, 1.0]), 0.8
    truth = render(renderer, in_camera(rig, leaning_wall(normal, offset_m, GRAY))).truth
    expected = offset_m / (centre_rays(rig.camera) @ (normal / np.linalg.norm(normal)))
    assert np.abs(truth.depth_m / expected - 1).max() < FLOAT32
    assert (truth.instance == -1).all() and truth.amodal == ()


def test_depth_and_normal_of_a_sphere_solve_its_quadratic_equation(renderer):
    """Oracle: |z ray - centre| = radius; the normal is the radius vector."""
    rig = askew_rig()
    centre, radius = np.array([0.05, -0.04, 0.9]), 0.2
    sphere = Sphere(center_m=tuple(centre.tolist()), radius_m=radius, material=GRAY)
    truth = render(renderer, in_camera(rig, sphere)).truth
    ray = centre_rays(rig.camera)
    a, b, c = (ray * ray).sum(-1), ray @ centre, centre @ centre - radius**2
    discriminant = b * b - a * c
    sure_hit, sure_miss = discriminant > 1e-4, discriminant < -1e-4
    assert sure_hit.sum() > 1000 and sure_miss.sum() > 1000
    assert np.isnan(truth.depth_m[sure_miss]).all()
    assert np.isnan(truth.normal[sure_miss]).all()
    z = ((b - np.sqrt(np.maximum(discriminant, 0))) / a)[sure_hit]
    assert np.abs(truth.depth_m[sure_hit] / z - 1).max() < 20 * FLOAT32  # including grazing rays
    normal = (ray[sure_hit] * z[:, None] - centre) / radius
    assert np.abs(truth.normal[sure_hit] - normal).max() < 1e-4


@pytest.mark.parametrize("front", [1.0, -1.0])
def test_the_normal_of_a_plane_is_a_unit_vector_towards_the_camera(renderer, front):
    normal = np.array([0.5, 0.2, 1.0]) / np.linalg.norm([0.5, 0.2, 1.0])
    quad = leaning_wall(normal, 0.8, GRAY)
    flipped = tuple((front * np.array(quad.half_v_m)).tolist())
    quad = Quad(center_m=quad.center_m, half_u_m=quad.half_u_m, half_v_m=flipped, material=GRAY)
    truth = render(renderer, in_camera(askew_rig(), quad)).truth
    assert np.abs(truth.normal + normal).max() < 1e-5


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1, 1])
def test_an_edge_divides_the_pixels_at_its_true_position(renderer, axis, side):
    """A quad ends at pixel position e. Pixel centres before e see it, those after e do not, and the
    pixel at e receives the share of light that it covers: 3/4 for e = k + 1/4.
    """
    rig = askew_rig(camera=optics(96, 9, 110) if axis == 0 else optics(9, 96, 110))
    k, z = 40, 0.8
    focal, centre = (rig.camera.fx_px, rig.camera.fy_px), (rig.camera.cx_px, rig.camera.cy_px)
    ray = (k + 0.25 * side - centre[axis]) / focal[axis]
    half = np.full(2, 2.0)
    middle = np.zeros(2)
    middle[axis] = ray * z - side * half[axis]  # the quad is on the `-side` of its edge
    quad = Quad(
        center_m=(*middle.tolist(), z),
        half_u_m=(half[0], 0.0, 0.0),
        half_v_m=(0.0, -half[1], 0.0),
        material=GRAY,
    )
    rendering = render(renderer, in_camera(rig, quad), samples=64)
    visible = np.isfinite(rendering.truth.depth_m)
    visible = visible[4] if axis == 0 else visible[:, 4]
    assert np.array_equal(np.flatnonzero(visible != visible[k]), np.flatnonzero(~visible))
    assert visible[k] and visible[k - side] and not visible[k + side]

    light = rendering.radiance.pattern[0]
    light = light[4] if axis == 0 else light[:, 4]
    full = light[k - side] + (light[k - side] - light[k - 2 * side])
    assert abs(light[k] / full - 0.75) < 0.06  # half of the error of 8 x 8 positions
    assert light[k + side] == 0


def test_a_single_sample_is_uniform_over_its_pixel(path_tracer):
    """If a surface covers 3/4 of each pixel of a column, 3/4 of the pixels' samples hit it; samples
    at the pixels' centres would all hit it.
    """
    rig = askew_rig(camera=optics(9, 192, 110))
    k, z = 4, 0.8
    edge_m = (k + 0.25 - rig.camera.cx_px) / rig.camera.fx_px * z
    quad = Quad(
        center_m=(edge_m - 2.0, 0.0, z),
        half_u_m=(2.0, 0.0, 0.0),
        half_v_m=(0.0, -2.0, 0.0),
        material=GRAY,
    )
    scene, pattern = in_camera(rig, quad), plain_pattern(rig, 255)
    quality = Quality(samples=1, depth=1)
    hit = np.concatenate(
        [
            path_tracer.render(
                scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed
            ).radiance.albedo[:, k, 0]
            > 0
            for seed in range(2)
        ]
    )
    assert abs(hit.mean() - 0.75) < 4 * np.sqrt(0.75 * 0.25 / len(hit))


def test_the_axes_of_the_camera_frame_have_their_directions_in_the_picture(renderer):
    sphere = Sphere(center_m=(0.1, -0.08, 0.8), radius_m=0.05, material=GRAY)
    visible = np.isfinite(render(renderer, in_camera(askew_rig(), sphere)).truth.depth_m)
    rows, columns = np.nonzero(visible)
    assert len(rows) > 50
    assert columns.min() > 48 and rows.max() < 36


def test_the_projector_draws_columns_to_the_right_and_rows_down(renderer):
    """Grey ramps on a wall: the level relative to white must grow with x, or with y."""
    rig = askew_rig()
    h, w = rig.projector.height_px, rig.projector.width_px
    across = np.broadcast_to(np.arange(w, dtype=np.uint8) * 3, (h, w))
    down = np.broadcast_to(np.arange(h, dtype=np.uint8)[:, None] * 5, (h, w))
    pattern = np.stack([across, down, np.full((h, w), 255, dtype=np.uint8)])
    light = render(renderer, in_camera(rig, wall(0.8, GRAY)), pattern).radiance.pattern
    for image, left_or_top, right_or_bottom in (
        (light[0], np.s_[:, 5], np.s_[:, 90]),
        (light[1], np.s_[5], np.s_[66]),
    ):
        one, other = (image[line] / light[2][line] for line in (left_or_top, right_or_bottom))
        assert (other > one + 0.2).all()


def test_camera_rays_are_distorted_as_opencv_distorts_them(renderer):
    """The ray of every pixel is measured: on the plane a x + z = d, a depth gives x / z = (d / z -
    1) / a; a second plane gives y. OpenCV must project the ray to its pixel.
    """
    camera = optics(96, 72, 80, distortion=LENS)
    rig = askew_rig(camera=camera)
    ray = np.empty((72, 96, 3))
    ray[..., 2] = 1
    for axis in (0, 1):
        normal = np.array([0.7 * (axis == 0), 0.7 * (axis == 1), 1.0])
        offset_m = 0.8 / np.linalg.norm(normal)
        scene = in_camera(rig, leaning_wall(normal, offset_m, GRAY))
        ray[..., axis] = (0.8 / render(renderer, scene).truth.depth_m - 1) / 0.7
    pixel = cv2.projectPoints(
        ray.reshape(-1, 3), np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )[0].reshape(72, 96, 2)
    y, x = np.mgrid[0:72, 0:96]
    assert np.abs(pixel[..., 0] - x).max() < 1e-3
    assert np.abs(pixel[..., 1] - y).max() < 1e-3


def projector_pixel(code, light, axis):
    """Return each pixel's projector pixel, from bits that the majority of its light decides."""
    use = [k for k, frame in enumerate(code.frames) if frame.axis == axis]
    pictures = code.render()[use] > 127
    words = pictures[:, 0, :] if axis == "column" else pictures[:, :, 0]
    weight = 2 ** np.arange(len(use))
    place = np.full(2 ** len(use), -1000)
    place[weight @ words] = np.arange(words.shape[1])
    bits = light[use] > 0.5 * light[0]
    return place[np.tensordot(weight, bits, axes=1)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "distortion", [(0.0, 0.0, 0.0, 0.0, 0.0), (-0.15, 0.08, 0.01, -0.008, 0.02)]
)
def test_patterns_light_each_point_with_the_projector_pixel_that_opencv_gives(renderer, distortion):
    """Oracle: OpenCV projects the true point. Most of a pixel's light is that of its centre, so the
    decoded position is within half a projector pixel; 25 positions per pixel blur that by a quarter
    of the pixel's width. The renderer's own position is a mean over projector pixels with the same
    bound; its mean error is 0, so that half a pixel would be noticed.
    """
    projector = optics(31, 26, 44, distortion=distortion)
    rig = askew_rig(camera=optics(150, 110, 110), projector=projector)
    code = gray(31, 26)
    scene = in_camera(rig, wall(0.8, GRAY))
    radiance = render(renderer, scene, code.render(), samples=25).radiance
    light = radiance.pattern
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)
    uv = cv2.projectPoints(
        (0.8 * centre_rays(rig.camera)).reshape(-1, 3),
        cv2.Rodrigues(T_proj_cam[:3, :3])[0],
        T_proj_cam[:3, 3],
        projector.K,
        np.array(distortion),
    )[0].reshape(110, 150, 2)
    reach = 0.5 * np.abs(np.gradient(uv, axis=(0, 1))).sum(axis=0).max()  # from a pixel's centre
    assert reach < 0.3
    inside = ((uv > -0.5 + reach) & (uv < [30.5 - reach, 25.5 - reach])).all(axis=-1)
    beyond = [uv < -0.5 - reach, uv > [30.5 + reach, 25.5 + reach]]
    assert inside.sum() > 3500
    assert np.any(beyond, axis=(1, 2)).all()  # all four borders of the field are in the picture
    assert not light[:, np.any(beyond, axis=(0, 3))].any()
    assert (light[0][inside] > 0).all()
    for axis, where in (("column", uv[..., 0]), ("row", uv[..., 1])):
        error = np.abs(projector_pixel(code, light, axis) - where)[inside]
        assert error.max() < 0.5 + 0.5 * reach
    place_px = np.moveaxis(radiance.place_px, 0, -1)
    off_px = (place_px - uv)[inside]
    assert np.abs(off_px).max() < 0.5 + 0.5 * reach
    np.testing.assert_allclose(off_px.mean(axis=0), 0, atol=0.02)
    assert np.isnan(place_px[np.any(beyond, axis=(0, 3))]).all()


def test_a_point_far_outside_a_barrel_distorted_projector_s_field_is_dark(renderer):
    """Far off the axis r (1 + k1 r^2) decreases, so the formula alone gives a ghost image."""
    projector = optics(32, 24, 40, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0))
    rig = make_rig(optics(96, 72, 16), projector)  # the camera sees 71 degrees off its axis
    light = render(renderer, in_camera(rig, wall(0.5, GRAY, half_m=9.0))).radiance.pattern[0]
    ray = centre_rays(rig.camera) * 0.5 - rig.T_cam_proj[:3, 3]
    off_axis = np.hypot(ray[..., 0], ray[..., 1]) / ray[..., 2]
    assert (light[off_axis < 0.2] > 0).all() and (off_axis < 0.2).any()
    assert not light[off_axis > 1.0].any()
    assert (np.abs(off_axis - np.sqrt(1 / 0.3)) < 0.05).any()  # position of the ghost


def test_patterns_that_differ_in_size_from_the_projector_are_refused(renderer):
    scene = in_camera(askew_rig(), wall(0.8, GRAY))
    for shape in [(1, 48, 65), (1, 47, 64), (1, 64, 48)]:
        with pytest.raises(ValueError, match="the projector has 64 x 48 px"):
            render(renderer, scene, np.zeros(shape, dtype=np.uint8))
