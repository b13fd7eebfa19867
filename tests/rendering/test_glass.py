"""Glass: panes, slabs and balls, compared with closed forms of Snell, Fresnel and Beer."""

from dataclasses import replace

import numpy as np
import pytest
from stage import (
    box_part,
    centre_rays,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    leaning_wall,
    make_rig,
    plain_pattern,
    turned,
    wall,
)

from graycast.base.frames import rigid
from graycast.rendering import Quality, open_renderer
from graycast.rig.optics import project
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Quad, Sphere

INDEX, ALBEDO, DEPTH_M = 1.5, 0.5, 0.02
PAPER = ALBEDO / np.pi


def glass(kind, color=(1.0, 1.0, 1.0)):
    return Material(base_color=color, transparent=kind, color_depth_m=DEPTH_M)


def fresnel(cosine, index=INDEX):
    """Return the reflectance by the tangents and sines of both angles."""
    a = np.arccos(np.clip(cosine, 0, 1))
    b = np.arcsin(np.sin(a) / index)
    with np.errstate(invalid="ignore"):
        mirrored = (np.sin(a - b) / np.sin(a + b)) ** 2 + (np.tan(a - b) / np.tan(a + b)) ** 2
    return np.where(a < 1e-6, ((index - 1) / (index + 1)) ** 2, mirrored / 2)


def slab(cosine):
    r = fresnel(cosine)
    return (1 - r) / (1 + r)


def ramp(rig):
    """Return levels that grow with the projector's columns."""
    level = np.arange(rig.projector.width_px, dtype=np.uint8)
    return np.broadcast_to(level, (1, rig.projector.height_px, rig.projector.width_px)).copy()


def radiance(renderer, scene, *, layout=EMPTY_LAYOUT, seed=1, samples=256, depth=1, pattern=None):
    pattern = plain_pattern(scene.rig, 255) if pattern is None else pattern
    quality = Quality(samples=samples, depth=depth)
    return renderer.render(scene, layout, pattern, quality=quality, seed=seed).radiance


def cosines(points, origin, normal):
    way = points - origin
    return np.abs(way @ normal) / np.linalg.norm(way, axis=-1)


NARROW = make_rig(centred(24, 18, 60), centred(96, 72, 140), baseline_m=(0.1, 0.0, 0.0))


@pytest.mark.parametrize("lean_rad", [0.0, 0.5, 1.0, 1.15])
def test_a_thin_pane_dims_light_to_and_from_the_wall_behind_it(mitsuba_renderer, lean_rad):
    """Each way has the closed form of all reflections between two surfaces, times the colour."""
    color = 0.9, 0.6, 0.3
    normal = np.array([np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    behind = wall(1.0, lambert(ALBEDO), half_m=0.25)
    pane = leaning_wall(normal, 0.4 * np.cos(lean_rad), glass("thin", color), half_m=3.0)
    bare = radiance(mitsuba_renderer, in_camera(NARROW, behind)).white_rgb
    with_pane = radiance(mitsuba_renderer, in_camera(NARROW, behind, pane)).white_rgb
    point = centre_rays(NARROW.camera)
    share = slab(cosines(point, 0, normal)) * slab(cosines(point, [0.1, 0, 0], normal))
    expected = bare * share[..., None] * np.square(color)
    noise = np.sqrt((1 / slab(cosines(point, 0, normal)).mean() - 1) / (256 * 24 * 18))
    ratio = with_pane.sum(axis=(0, 1)) / expected.sum(axis=(0, 1))
    assert np.abs(ratio - 1).max() < max(5 * noise, 1e-5), ratio


@pytest.mark.slow
def test_a_thin_pane_reflects_the_projector_onto_a_wall(mitsuba_renderer):
    """Oracle: the projector's mirror image with Fresnel's share of two surfaces; no other light
    arrives there, and without a third vertex none returns.
    """
    rig = make_rig(centred(40, 24, 50), centred(96, 72, 90), baseline_m=(0.1, 0.0, 0.0))
    pane = Quad(
        center_m=(0.3, 0.0, 0.7),
        half_u_m=(0.0, 0.0, 0.2),
        half_v_m=(0.0, 0.5, 0.0),
        material=glass("thin"),
    )
    behind = wall(1.0, lambert(ALBEDO), half_m=2.0)
    bare = radiance(mitsuba_renderer, in_camera(rig, behind), depth=2, samples=1024).white
    both = radiance(mitsuba_renderer, in_camera(rig, behind, pane), depth=2, samples=1024).white
    point = centre_rays(rig.camera)
    image = np.array([0.5, 0.0, 0.0])
    met_z = (0.3 - 0.5) / (point[..., 0] - 0.5)
    inner = (met_z > 0.55) & (met_z < 0.85) & (point[..., 0] < 0.2)
    way = np.linalg.norm(point - image, axis=-1)
    expected = PAPER * rig.intensity_w_sr / way**3
    expected = expected * (1 - slab(cosines(point, image, np.array([1.0, 0.0, 0.0]))))
    assert inner.sum() > 60
    assert abs((both - bare)[inner].sum() / expected[inner].sum() - 1) < 0.01


def orders(cosine, thickness_m, color):
    """Return per number k of pairs of reflections in a slab: power, and distance across."""
    r = fresnel(cosine)
    inner = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    left = color ** (thickness_m / inner / DEPTH_M)
    across = thickness_m * np.sqrt(1 - inner**2) / inner
    for k in range(4):
        yield (1 - r) ** 2 * left ** (2 * k + 1) * r ** (2 * k), (2 * k + 1) * across


@pytest.mark.slow
def test_a_glass_slab_in_front_of_the_camera_displaces_and_dims_the_scene(mitsuba_renderer):
    """Oracle: Snell's parallel shift, Fresnel's losses and Beer's law, in column and level."""
    thickness_m, color = 0.06, 0.7
    rig = make_rig(centred(24, 18, 60), centred(240, 120, 140), baseline_m=(0.35, 0.0, 0.0))
    half_m = np.array([0.12, 0.12, thickness_m / 2])
    R = turned(0.0, 0.6, 0.0)
    box = box_part(half_m, glass("solid", (color,) * 3))
    layout = layout_in_camera([0], [rigid(R, np.array([0.0, 0.0, 0.2]))])
    scene = in_camera(rig, wall(1.0, lambert(ALBEDO), half_m=2.0), parts=(box,))
    light = radiance(mitsuba_renderer, scene, layout=layout, pattern=ramp(rig), samples=1024)
    ray, normal = centre_rays(rig.camera), R[:, 2]
    unit = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    cosine = unit @ normal
    along = unit - cosine[..., None] * normal
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    white, ramped = 0.0, 0.0
    for power, across in orders(cosine, thickness_m, color):
        shift = normal * thickness_m - unit * (thickness_m / cosine)[..., None]
        start = shift + along * across[..., None]
        point = start + ray * (1 - start[..., 2:])
        lens = rig.T_cam_proj[:3, 3]
        arriving = power * PAPER * rig.intensity_w_sr / np.linalg.norm(point - lens, axis=-1) ** 3
        white = white + arriving
        ramped = ramped + arriving * project(rig.projector, point - lens)[..., 0] / 255
    assert abs(light.white.sum() / white.sum() - 1) < 0.002
    off_px = 255 * (light.pattern[0] / light.white - ramped / white)
    assert abs(off_px.mean()) < 0.05 and np.abs(off_px).max() < 0.5, off_px


@pytest.mark.slow
def test_a_glass_slab_in_the_projector_s_beam_displaces_and_dims_its_light(mitsuba_renderer):
    """A parallel wall has `I T sin(a) da / (r dr)`: rays of the angle a from the axis arrive at the
    distance r. The camera sees the wall beside the slab.
    """
    thickness_m, color = 0.1, 0.7
    rig = make_rig(centred(48, 24, 40), centred(200, 120, 400), baseline_m=(0.3, 0.0, 0.0))
    box = box_part(np.array([0.12, 0.12, thickness_m / 2]), glass("solid", (color,) * 3))
    layout = layout_in_camera([0], [rigid(np.eye(3), np.array([0.3, 0.0, 0.2]))])
    scene = in_camera(rig, wall(1.0, lambert(ALBEDO), half_m=2.0), parts=(box,))
    runs = [
        radiance(
            mitsuba_renderer, scene, layout=layout, pattern=ramp(rig), depth=2, seed=k, samples=128
        )
        for k in range(4)
    ]
    white = np.mean([run.white for run in runs], axis=0)
    ramped = np.mean([run.pattern[0] for run in runs], axis=0)
    beside = centre_rays(rig.camera)[..., :2] - [0.3, 0.0]
    r = np.linalg.norm(beside, axis=-1)
    angle = np.linspace(1e-5, 0.6, 20_001)
    expected, level = 0.0, 0.0
    for power, across in orders(np.cos(angle), thickness_m, color):
        reach = (1 - thickness_m) * np.tan(angle) + across
        density = power * np.sin(angle) / (reach * np.gradient(reach, angle))
        arriving = PAPER * rig.intensity_w_sr * np.interp(r, reach, density)
        tangent = np.tan(np.interp(r, reach, angle))
        expected = expected + arriving
        column = rig.projector.cx_px + rig.projector.fx_px * tangent * beside[..., 0] / r
        level = level + arriving * column / 255
    inner = (np.abs(beside[..., 0]) < 0.18) & (np.abs(beside[..., 1]) < 0.1)
    assert inner.sum() > 80
    assert abs(white[inner].sum() / expected[inner].sum() - 1) < 0.002
    off_px = 255 * (ramped[inner] / white[inner] - level[inner] / expected[inner])
    assert abs(off_px.mean()) < 0.3 and np.abs(off_px).max() < 3, off_px


@pytest.mark.parametrize("color", [1.0, 0.5])
def test_a_glass_ball_loses_only_the_light_that_its_colour_absorbs(mitsuba_renderer, color):
    """All chords of a ray are equal: `R + (1 - R)^2 a / (1 - R a)`, which is 1 if a is 1."""
    ball = Sphere(center_m=(0.0, 0.0, 0.5), radius_m=0.1, material=glass("solid", (color,) * 3))
    scene = in_camera(NARROW, ball, environment=Environment(radiance=(1 / 3,) * 3))
    light = radiance(mitsuba_renderer, scene, depth=4, samples=512).ambient
    at = (np.arange(8) + 0.5) / 8 - 0.5
    x = (np.arange(24)[:, None] + at).ravel() - 11.5
    y = (np.arange(18)[:, None] + at).ravel() - 8.5
    tangent2 = (x[None, :] ** 2 + y[:, None] ** 2) / 60**2
    miss = 0.5 * np.sqrt(tangent2 / (1 + tangent2)) / 0.1  # sine of incidence on the ball
    inside = miss < 1
    sine = np.where(inside, miss, 0)
    a = color ** (0.2 * np.sqrt(1 - (sine / INDEX) ** 2) / DEPTH_M)
    r = fresnel(np.sqrt(1 - sine**2))
    expected = np.where(inside, r + (1 - r) ** 2 * a / (1 - r * a), 1.0)
    expected = expected.reshape(18, 8, 24, 8).mean(axis=(1, 3))
    if color == 1:
        assert np.abs(light - 1).max() < 1e-5
    assert abs(light.sum() / expected.sum() - 1) < 0.003
    whole = inside.reshape(18, 8, 24, 8).all(axis=(1, 3))
    assert abs(light[whole].sum() / expected[whole].sum() - 1) < 0.02


def test_the_sky_lights_a_patch_inside_a_glass_ball(mitsuba_renderer):
    """All light passes the ball's surface along its normal, where R is reflected: `R + (1 - R)^2
    albedo` is seen. Inside, radiance is larger by the square of the index.
    """
    rig = make_rig(centred(8, 6, 400), centred(8, 6, 400), baseline_m=(0.1, 0.0, 0.0))
    ball = Sphere(center_m=(0.0, 0.0, 0.5), radius_m=0.1, material=glass("solid"))
    sky = Environment(radiance=(1 / 3,) * 3)
    scene = in_camera(rig, ball, wall(0.5, lambert(0.6), half_m=0.01), environment=sky)
    light = radiance(mitsuba_renderer, scene, depth=2, samples=1024).ambient
    r = ((INDEX - 1) / (INDEX + 1)) ** 2
    assert abs(light.mean() / (r + (1 - r) ** 2 * 0.6) - 1) < 0.005


def traced_ball(points, direction, center, radius, color):
    """Return ends and directions of rays through a ball by vectors, with the share of each."""
    b = ((center - points) * direction).sum(-1)
    c = np.square(center - points).sum(-1) - radius**2
    hit = b**2 > c
    d = direction[hit]
    p = points[hit] + d * (b[hit] - np.sqrt(b[hit] ** 2 - c[hit]))[:, None]
    n = (p - center) / radius
    cosine = -(n * d).sum(-1)
    r = fresnel(cosine)
    inner = np.sqrt(1 - (1 - cosine**2) / INDEX**2)
    inward = d / INDEX + (cosine / INDEX - inner)[:, None] * n
    left = color ** (2 * radius * inner / DEPTH_M)
    share = 1 - r
    for _ in range(6):
        p = p + 2 * radius * inner[:, None] * inward
        n = (p - center) / radius
        share = share * left
        outward = INDEX * inward + (cosine - INDEX * inner)[:, None] * n
        yield p, outward, share * (1 - r)
        share = share * r
        inward = inward - 2 * inner[:, None] * n


@pytest.mark.slow
def test_a_ball_lens_focuses_the_projector_s_light_onto_a_wall(mitsuba_renderer):
    """Oracle: rays by vectors in NumPy. All light enters the ball, and squares of the wall receive
    the light of these rays.
    """
    color, radius_m, x_m = 0.8, 0.05, 0.5
    camera = replace(centred(24, 24, 200), cx_px=11.5 - 200 * x_m)
    rig = make_rig(camera, centred(64, 64, 800), baseline_m=(x_m, 0.0, 0.0))
    center = np.array([x_m, 0.0, 0.8])
    ball = Sphere(center_m=tuple(center), radius_m=radius_m, material=glass("solid", (color,) * 3))
    scene = in_camera(rig, wall(1.0, lambert(ALBEDO), half_m=2.0), ball)
    white = radiance(mitsuba_renderer, scene, depth=2, samples=2048).white
    flux = white / PAPER / 200**2  # area of the wall in a pixel
    n = 400
    u = 0.04 * (2 * (np.arange(n) + 0.5) / n - 1)  # the projector's field at unit depth
    ray = np.stack([*(axis.ravel() for axis in np.meshgrid(u, u)), np.ones(n * n)], axis=-1)
    length = np.linalg.norm(ray, axis=-1, keepdims=True)
    origin = np.broadcast_to([x_m, 0.0, 0.0], ray.shape)
    power = rig.intensity_w_sr * (0.08 / n) ** 2 / length[:, 0] ** 3
    expected, edges = np.zeros((24, 24)), np.arange(25) - 0.5
    for p, d, share in traced_ball(origin, ray / length, center, radius_m, color):
        on = d[:, 2] > 0
        place = project(camera, p[on] + d[on] * ((1 - p[on, 2:]) / d[on, 2:]))
        arriving = (power * share)[on]
        expected += np.histogram2d(*place.T[::-1], bins=(edges, edges), weights=arriving)[0]
    clear = np.s_[:, 2:22]  # the ball hides the last columns from the camera
    flux, expected = flux[clear], expected[clear]
    assert expected.sum() > 0.2 * power.sum()
    assert abs(flux.sum() / expected.sum() - 1) < 0.002
    blocks = [one.reshape(6, 4, 5, 4).sum(axis=(1, 3)) for one in (flux, expected)]
    bright = blocks[1] > 0.1 * blocks[1].max()
    assert bright.sum() > 8
    assert np.abs(blocks[0] / blocks[1] - 1)[bright].max() < 0.03


@pytest.mark.slow
def test_light_that_passes_metal_and_glass_is_counted_only_once(mitsuba_renderer, monkeypatch):
    """Oracle: camera paths alone, which give all light if no path starts at glass. Metal lights the
    wall through a glass ball and a pane; its own reflections are visible through them.
    """
    rig = make_rig(centred(24, 16, 28), centred(96, 72, 70), baseline_m=(0.1, 0.02, 0.01))
    metal = Material(base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.4)
    scene = in_camera(
        rig,
        wall(1.0, lambert(0.6), half_m=1.0),
        Quad(
            center_m=(-0.25, 0.0, 0.75),
            half_u_m=(0.0, 0.0, -0.2),
            half_v_m=(0.0, 0.3, 0.0),
            material=metal,
        ),
        Sphere(center_m=(-0.05, 0.05, 0.85), radius_m=0.1, material=glass("solid")),
        Quad(
            center_m=(0.15, 0.0, 0.8),
            half_u_m=(0.0, 0.0, 0.15),
            half_v_m=(0.0, 0.3, 0.0),
            material=glass("thin"),
        ),
    )
    shiny = "graycast.rendering.mitsuba.scene._is_shiny"
    monkeypatch.setattr(shiny, lambda material: material.metallic > 0)
    pictures = {}
    for kind, samples, seed in (("both", 256, 0), ("camera", 1024, 100)):
        if kind == "camera":
            monkeypatch.setattr(
                "graycast.rendering.mitsuba.renderer._shiny_field", lambda *of: None
            )
        mitsuba_renderer.close()
        runs = [
            radiance(mitsuba_renderer, scene, depth=4, seed=seed + k, samples=samples).white
            for k in range(8)
        ]
        mitsuba_renderer.close()
        pictures[kind] = np.array(runs).reshape(8, 2, 8, 3, 8).sum(axis=(2, 4))
    a, b = pictures["both"], pictures["camera"]
    whole = [one.sum(axis=(1, 2)) for one in (a, b)]
    for x, y in ((a, b), whole):
        error = np.sqrt((x.var(axis=0, ddof=1) + y.var(axis=0, ddof=1)) / 8)
        assert np.abs((x.mean(axis=0) - y.mean(axis=0)) / error).max() < 4.5
    assert abs(whole[0].mean() / whole[1].mean() - 1) < 0.01


def test_only_mitsuba_renders_glass():
    """The error of the reference renderer names Mitsuba as the remedy."""
    scene = in_camera(NARROW, wall(1.0, replace(glass("thin"), specular=0.0)))
    with open_renderer("reference") as renderer, pytest.raises(ValueError, match="use mitsuba"):
        quality = Quality(samples=1, depth=1)
        renderer.render(scene, EMPTY_LAYOUT, plain_pattern(NARROW, 255), quality=quality, seed=1)
