"""Lamps and environment, compared with closed forms."""

import numpy as np
import pytest
from backends import slow
from scipy.ndimage import binary_erosion
from stage import centre_rays, centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, look_at, rigid
from graycast.rendering import Quality
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Lamp, Quad, Scene


def ambient(renderer, scene, *, samples=256, depth=1, seed=0):
    pattern = plain_pattern(scene.rig, 255)
    quality = Quality(samples=samples, depth=depth)
    rendering = renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)
    return rendering.radiance.ambient_rgb.astype(float)


def corner_form_factor(a, b, h):
    """Return the form factor of a parallel rectangle a x b at height h, a corner above the point.

    Source: J. R. Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-3.
    """
    x, y = a / h, b / h
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return (x / p * np.arctan(y / p) + y / q * np.arctan(x / q)) / (2 * np.pi)


@pytest.mark.slow
@pytest.mark.parametrize(("depth", "sky"), [slow(1, 0.0), slow(1, 0.7), slow(3, 0.0), (3, 0.7)])
def test_a_lamp_and_the_sky_light_a_floor_according_to_their_form_factors(path_tracer, sky, depth):
    """albedo * (L_lamp F + L_sky (1 - F)): the black lamp hides the sky behind it. A floor alone
    has no second bounce, so deeper paths change only the noise.
    """
    rig = make_rig(centred(32, 24, 40), centred(8, 8, 8))
    lamp_rgb, albedo = np.array([5.0, 3.0, 1.0]), np.array([0.8, 0.6, 0.4])
    side, height = 0.4, 0.5
    T_world_cam = rigid(axis_rotation("x", -2.6), np.array([0.1, -0.3, 0.4]))
    floor = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=(5.0, 0.0, 0.0),
        half_v_m=(0.0, 5.0, 0.0),
        material=lambert(*albedo.tolist()),
    )
    scene = Scene(
        rig=rig,
        T_world_cam=T_world_cam,
        surfaces=(floor,),
        environment=Environment(radiance=(sky, sky, sky)),
        lamps=(Lamp(center_m=(0.0, 0.0, height), size_m=side, radiance=tuple(lamp_rgb.tolist())),),
    )
    samples = 4096 if path_tracer.name == "mitsuba" else 1024  # 0.2 and 0.3 % noise per block
    image = ambient(path_tracer, scene, samples=samples, depth=depth)
    ray = centre_rays(rig.camera) @ T_world_cam[:3, :3].T
    t = -T_world_cam[2, 3] / ray[..., 2]
    x, y = np.moveaxis(T_world_cam[:2, 3] + t[..., None] * ray[..., :2], -1, 0)
    lo_x, hi_x, lo_y, hi_y = -side / 2 - x, side / 2 - x, -side / 2 - y, side / 2 - y
    factor = (
        corner_form_factor(hi_x, hi_y, height)
        - corner_form_factor(lo_x, hi_y, height)
        - corner_form_factor(hi_x, lo_y, height)
        + corner_form_factor(lo_x, lo_y, height)
    )
    assert 0.02 < factor.min() and 0.1 < factor.max()
    expected = albedo * (lamp_rgb * factor[..., None] + sky * (1 - factor[..., None]))
    blocks = (image / expected).reshape(4, 6, 4, 8, 3).mean(axis=(1, 3))
    assert np.abs(blocks - 1).max() < 0.02
    assert abs(blocks.mean() - 1) < 0.004


def test_a_directly_visible_lamp_or_sky_has_its_stated_radiance(path_tracer):
    """This holds at any depth of path; the back of a lamp is black."""
    rig = make_rig(centred(32, 24, 40), centred(8, 8, 8))
    sky = (0.4, 0.2, 0.1)
    for front in (True, False):
        target = (0.0, 0.0, 0.0) if front else (0.0, 0.0, 9.0)
        scene = Scene(
            rig=rig,
            T_world_cam=np.eye(4),
            environment=Environment(radiance=sky),
            lamps=(
                Lamp(
                    center_m=(0.0, 0.0, 1.0), target_m=target, size_m=0.3, radiance=(7.0, 6.0, 5.0)
                ),
            ),
        )
        for depth in (1, 4):
            image = ambient(path_tracer, scene, samples=4, depth=depth)
            inside = (7.0, 6.0, 5.0) if front else (0.0, 0.0, 0.0)
            assert np.allclose(image[9:15, 13:19], inside, atol=1e-5)
            assert np.allclose(image[:3, :3], sky, atol=1e-5)


def test_a_lamp_in_the_projector_s_light_casts_a_shadow_and_looks_black(path_tracer):
    """Oracle: the shadow of its square on a wall, by rays from the wall to the lens."""
    rig = make_rig(centred(48, 36, 50), centred(32, 32, 16), baseline_m=(0.2, 0.0, 0.0))
    half_m, lamp_m, wall_m = 0.06, 0.5, 1.0
    lamp = Lamp(center_m=(0.0, 0.0, lamp_m), target_m=(0.0, 0.0, 9.0), size_m=2 * half_m)
    scene = in_camera(rig, wall(wall_m, lambert(0.5)), T_world_cam=np.eye(4), lamps=(lamp,))
    quality = Quality(samples=16, depth=1)
    pattern = plain_pattern(rig, 255)
    rendering = path_tracer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=0)
    point = centre_rays(rig.camera) * wall_m
    lens = np.array([0.2, 0.0, 0.0])
    crossing = lens + (point - lens) * lamp_m / wall_m
    farthest = np.abs(crossing[..., :2]).max(axis=-1)
    on_wall = binary_erosion(rendering.truth.depth_m > 0.9 * wall_m, np.ones((3, 3)))
    white = rendering.radiance.white
    assert not white[on_wall & (farthest < half_m - 0.012)].any()
    assert (white[on_wall & (farthest > half_m + 0.012)] > 0).all()
    assert (on_wall & (farthest < half_m - 0.012)).sum() > 20
    on_lamp = binary_erosion(np.abs(rendering.truth.depth_m - lamp_m) < 1e-3, np.ones((3, 3)))
    assert on_lamp.sum() > 50 and not white[on_lamp].any()


def test_a_wall_in_uniform_light_has_the_radiance_albedo_times_light(path_tracer):
    rig = make_rig(centred(32, 24, 40), centred(8, 8, 8))
    sky, albedo = (0.9, 0.5, 0.2), (0.3, 0.6, 0.9)
    scene = in_camera(
        rig, wall(1.0, lambert(*albedo), half_m=50.0), environment=Environment(radiance=sky)
    )
    for depth in (1, 4):
        image = ambient(path_tracer, scene, samples=64, depth=depth)
        expected = np.multiply(sky, albedo)
        assert np.abs(image.mean(axis=(0, 1)) / expected - 1).max() < 0.01


def hemisphere_map(path):
    """Return a map whose upper half is bright and whose lower half is black."""
    import mitsuba as mi

    pixels = np.zeros((64, 128, 3), dtype=np.float32)
    pixels[:32] = 1.0
    mi.Bitmap(pixels).write(str(path))
    return path


@pytest.mark.parametrize(
    ("normal", "share"), [((0, 0, 1), 1.0), ((0, 0, -1), 0.0), ((1, 0, 0), 0.5), ((0, 1, 0), 0.5)]
)
def test_the_top_row_of_an_environment_map_is_at_the_zenith(path_tracer, tmp_path, normal, share):
    """A white wall under the bright half of the sky receives all, none or half of it."""
    file = hemisphere_map(tmp_path / "sky.exr")
    normal = np.array(normal, dtype=float)
    u = np.roll(normal, 1)
    v = np.cross(normal, u)
    quad = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=tuple((9 * u).tolist()),
        half_v_m=tuple((9 * v).tolist()),
        material=lambert(1.0),
    )
    rig = make_rig(centred(16, 12, 40), centred(8, 8, 8))
    scene = Scene(
        rig=rig,
        T_world_cam=look_at(normal + 0.2 * u, np.zeros(3), v),
        surfaces=(quad,),
        environment=Environment(radiance=(2.0, 1.0, 0.5), map_file=file),
    )
    image = ambient(path_tracer, scene).mean(axis=(0, 1))
    # Half a texel is interpolated at the horizon: sin(1.4 deg) of the light at grazing angles.
    assert np.abs(image - share * np.array([2.0, 1.0, 0.5])).max() < 0.03


def test_a_camera_that_looks_up_sees_a_bright_spot_at_the_zenith(path_tracer, tmp_path):
    import mitsuba as mi

    pixels = np.zeros((32, 64, 3), dtype=np.float32)
    pixels[:2] = 5.0
    mi.Bitmap(pixels).write(str(tmp_path / "spot.exr"))
    rig = make_rig(centred(16, 16, 40), centred(8, 8, 8))
    environment = Environment(radiance=(1.0, 1.0, 1.0), map_file=tmp_path / "spot.exr")
    for angle, bright in [(0.0, True), (np.pi, False), (np.pi / 2, False)]:
        pose = rigid(axis_rotation("x", angle), np.zeros(3))  # At 0, the camera's z is up.
        scene = Scene(rig=rig, T_world_cam=pose, environment=environment)
        image = ambient(path_tracer, scene, samples=4)
        assert (image[8, 8] > 4.9).all() == bright


FROM_NORTH_DEG, HEIGHT_DEG = 115.3125, 29.53125  # direction of the spot of `spot_map`


def spot_map(path):
    """Return a dark sky with one spot of radiance 300, 8 of 256 x 512 texels high and wide."""
    import mitsuba as mi

    pixels = np.zeros((256, 512, 3), dtype=np.float32)
    pixels[82:90, 160:168] = 300.0
    mi.Bitmap(pixels).write(str(path))
    return path


def spot_direction():
    """Return the spot's direction; columns go from +y to +x, -y and -x, rows from +z to -z."""
    north, height = np.radians([FROM_NORTH_DEG, HEIGHT_DEG])
    assert FROM_NORTH_DEG / 360 * 512 == 164 and (90 - HEIGHT_DEG) / 180 * 256 == 86
    aside = np.cos(height)
    return np.array([aside * np.sin(north), aside * np.cos(north), np.sin(height)])


def test_a_bright_spot_of_a_map_is_visible_in_its_direction(path_tracer, tmp_path):
    """A camera that looks there sees the spot in the centre: eight texels are 5.6 degrees."""
    direction = spot_direction()
    rig = make_rig(centred(33, 33, 80), centred(8, 8, 8))
    scene = Scene(
        rig=rig,
        T_world_cam=look_at(np.zeros(3), direction, -np.eye(3)[2]),
        environment=Environment(radiance=(1.0, 0.5, 0.2), map_file=spot_map(tmp_path / "s.exr")),
    )
    image = ambient(path_tracer, scene, samples=16)
    assert np.abs(image[14:19, 14:19] / [300.0, 150.0, 60.0] - 1).max() < 1e-3
    weight = image[..., 0] / image[..., 0].sum()
    y, x = np.mgrid[0:33, 0:33]
    height_px = 80 * np.radians(180 / 256 * 8)
    assert abs((weight * x).sum() - 16) < 0.1 and abs((weight * y).sum() - 16) < 0.2
    assert (image[..., 0] / 300.0).sum() == pytest.approx(
        height_px**2 * np.cos(np.radians(HEIGHT_DEG)), rel=0.01
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bright_spot_lights_a_wall_by_cosine_and_solid_angle(path_tracer, tmp_path, axis):
    """albedo / pi * L * solid angle * cosine, on walls along each axis of the world."""
    direction = spot_direction()
    normal = np.eye(3)[axis] * np.sign(direction[axis])
    u = np.roll(np.abs(normal), 1)
    quad = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=tuple((9 * u).tolist()),
        half_v_m=tuple((9 * np.cross(normal, u)).tolist()),
        material=lambert(0.7),
    )
    scene = Scene(
        rig=make_rig(centred(16, 12, 40), centred(8, 8, 8)),
        T_world_cam=look_at(normal + 0.2 * u, np.zeros(3), u),
        surfaces=(quad,),
        environment=Environment(radiance=(1.0, 1.0, 1.0), map_file=spot_map(tmp_path / "s.exr")),
    )
    image = ambient(path_tracer, scene)
    solid_angle = (8 * np.pi / 256) ** 2 * np.cos(np.radians(HEIGHT_DEG))
    expected = 0.7 / np.pi * 300.0 * solid_angle * abs(direction[axis])
    error = image[..., 0].std() / np.sqrt(16 * 12)
    assert error < 0.005 * expected
    # The two renderers place the middle of the sky half a texel apart, which is 0.3 %.
    assert abs(image[..., 0].mean() - expected) < 4 * error + 0.005 * expected


@pytest.mark.parametrize("turn_deg", [90.0, -35.0])
def test_an_environment_map_rotates_about_z_by_the_right_hand_rule(path_tracer, tmp_path, turn_deg):
    """The spot is visible in the rotated direction, and lights a wall by the cosine law."""
    turn = axis_rotation("z", np.radians(turn_deg))
    direction = turn @ spot_direction()
    environment = Environment(
        radiance=(1.0, 1.0, 1.0),
        map_file=spot_map(tmp_path / "s.exr"),
        rotation_rad=float(np.radians(turn_deg)),
    )
    sky_scene = Scene(
        rig=make_rig(centred(33, 33, 80), centred(8, 8, 8)),
        T_world_cam=look_at(np.zeros(3), direction, -np.eye(3)[2]),
        environment=environment,
    )
    image = ambient(path_tracer, sky_scene, samples=16)[..., 0]
    y, x = np.mgrid[0:33, 0:33]
    assert abs((image * x).sum() / image.sum() - 16) < 0.1
    assert abs((image * y).sum() / image.sum() - 16) < 0.2
    u, v = np.eye(3)[1] * np.sign(direction[0]), np.eye(3)[2]
    wall_along_x = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=tuple((9 * u).tolist()),
        half_v_m=tuple((9 * v).tolist()),
        material=lambert(0.7),
    )
    lit = Scene(
        rig=make_rig(centred(16, 12, 40), centred(8, 8, 8)),
        T_world_cam=look_at(np.cross(u, v) + 0.2 * u, np.zeros(3), u),
        surfaces=(wall_along_x,),
        environment=environment,
    )
    image = ambient(path_tracer, lit)[..., 0]
    solid_angle = (8 * np.pi / 256) ** 2 * np.cos(np.radians(HEIGHT_DEG))
    expected = 0.7 / np.pi * 300.0 * solid_angle * abs(direction[0])
    error = image.std() / np.sqrt(16 * 12)
    assert abs(image.mean() - expected) < 4 * error + 0.005 * expected


def test_the_stated_level_of_a_map_is_its_mean_over_all_directions(path_tracer, tmp_path):
    """A cap of 45 degrees is (1 - cos 45) / 2 of the sphere, but a quarter of the pixels."""
    import mitsuba as mi

    pixels = np.zeros((64, 128, 3), dtype=np.float32)
    pixels[:16] = (4000.0, 2000.0, 0.0)  # in any unit; the mean of the bands is 2000
    mi.Bitmap(pixels).write(str(tmp_path / "cap.exr"))
    scene = Scene(
        rig=make_rig(centred(16, 16, 80), centred(8, 8, 8)),
        T_world_cam=np.eye(4),  # looks up
        environment=Environment(
            radiance=(0.3, 0.3, 0.6), map_file=tmp_path / "cap.exr", levelled=True
        ),
    )
    image = ambient(path_tracer, scene, samples=4)[8, 8]
    share = (1 - np.cos(np.pi / 4)) / 2
    assert image == pytest.approx(np.array([0.6, 0.3, 0.0]) / share, rel=1e-3)


def test_a_level_for_a_map_with_no_light_or_infinite_light_is_refused(path_tracer, tmp_path):
    import mitsuba as mi

    rig = make_rig(centred(16, 16, 40), centred(8, 8, 8))
    for level in (0.0, np.inf):
        file = tmp_path / "odd.exr"
        mi.Bitmap(np.full((8, 16, 3), level, dtype=np.float32)).write(str(file))
        sky = Environment(map_file=file, levelled=True)
        with pytest.raises(GraycastError, match=r"odd\.exr has the mean radiance"):
            ambient(path_tracer, in_camera(rig, wall(1.0, lambert(0.5)), environment=sky))


def test_a_quad_repeats_its_texture_upright_from_its_corner(path_tracer):
    """Red above green in the texture is red above green on the wall, every 0.2 m."""
    picture = np.zeros((256, 8, 3), dtype=np.uint8)  # fine enough to be sharp
    picture[:128, :, 0], picture[128:, :, 1] = 255, 255
    rig = make_rig(centred(40, 40, 40), centred(8, 8, 8))
    quad = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=(0.5, 0.0, 0.0),
        half_v_m=(0.0, 0.5, 0.0),
        material=Material(texture=picture, specular=0.0),
        texture_size_m=0.2,
    )
    pose = look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    scene = Scene(
        rig=rig, T_world_cam=pose, surfaces=(quad,), environment=Environment(radiance=(1.0,) * 3)
    )
    image = ambient(path_tracer, scene, samples=64)
    # At 40 px per metre, each period of eight has four rows of red and then four of green.
    height = image[:, 20]
    for row in range(40):
        red = row % 8 < 4
        assert (height[row, 0] > 0.5) == red and (height[row, 1] > 0.5) != red, (row, height)


def test_the_error_for_an_unreadable_map_names_the_file(path_tracer, tmp_path):
    rig = make_rig(centred(16, 16, 40), centred(8, 8, 8))
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"not a picture")
    for file in (broken, tmp_path / "missing.exr"):
        scene = in_camera(rig, wall(1.0, lambert(0.5)), environment=Environment(map_file=file))
        with pytest.raises(GraycastError, match=file.name):
            ambient(path_tracer, scene, samples=1)


def test_a_real_sky_map_lights_a_floor_with_its_weighted_mean(path_tracer, shared):
    """Oracle: the mean of a real sky over all directions, by cosine weights and by rendering."""
    import mitsuba as mi

    file = shared / "data" / "hdri" / "forest.exr"
    pixels = np.array(mi.Bitmap(str(file)).convert(mi.Bitmap.PixelFormat.RGB))[..., :3]
    upper = pixels[: len(pixels) // 2]
    theta = (np.arange(len(upper)) + 0.5) / len(pixels) * np.pi
    weight = np.cos(theta) * np.sin(theta)
    expected = (upper.mean(axis=1) * weight[:, None]).sum(axis=0) / weight.sum()
    rig = make_rig(centred(32, 24, 400), centred(8, 8, 8))
    pose = rigid(axis_rotation("x", np.pi), np.array([0.0, 0.0, 1.0]))
    floor = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=(9.0, 0.0, 0.0),
        half_v_m=(0.0, 9.0, 0.0),
        material=lambert(1.0),
    )
    scene = Scene(
        rig=rig,
        T_world_cam=pose,
        surfaces=(floor,),
        environment=Environment(radiance=(1.0, 1.0, 1.0), map_file=file),
    )
    image = ambient(path_tracer, scene).mean(axis=(0, 1))
    assert np.abs(image / expected - 1).max() < 0.02
