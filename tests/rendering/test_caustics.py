"""Light reflected by shiny surfaces: a mirror in closed form, and two kinds of paths that agree."""

from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from scipy.ndimage import binary_erosion
from stage import centred, in_camera, lambert, make_rig, optics, plain_pattern, turned, wall

from graycast.base.frames import transform_points
from graycast.rendering import Quality
from graycast.rig.optics import project
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Quad, Sphere

ALBEDO, MIRROR_X, NEAR, FAR, HALF_Y = 0.5, 0.3, 0.5, 0.9, 0.2


def metal(roughness, base=1.0):
    return Material(base_color=(base,) * 3, metallic=1.0, roughness=roughness)


def strip(material):
    """Return an upright strip beside the camera's axis, from z = NEAR to FAR, facing the axis."""
    half_z = (FAR - NEAR) / 2
    return Quad(
        center_m=(MIRROR_X, 0.0, (NEAR + FAR) / 2),
        half_u_m=(0.0, 0.0, half_z),
        half_v_m=(0.0, HALF_Y, 0.0),
        material=material,
    )


def ramp(rig):
    """Return levels that grow with the projector's columns."""
    level = np.arange(rig.projector.width_px, dtype=np.uint8)
    return np.broadcast_to(level, (1, rig.projector.height_px, rig.projector.width_px)).copy()


def expected_on_the_wall(rig, width, height):
    """Return per pixel the radiance directly from the projector and from its mirror image, and the
    latter times the level of `ramp`; each pixel is 8 x 8 points of the wall at z = 1.
    """
    at = (np.arange(8) + 0.5) / 8 - 0.5
    u = (np.arange(width)[:, None] + at).ravel()
    v = (np.arange(height)[:, None] + at).ravel()
    camera = rig.camera
    x = (u[None, :] - camera.cx_px) / camera.fx_px
    y = (v[:, None] - camera.cy_px) / camera.fy_px
    point = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1)
    lens = rig.T_cam_proj[:3, 3]
    image = lens * [-1, 1, 1] + [2 * MIRROR_X, 0, 0]
    met = image + (point - image) * ((MIRROR_X - image[0]) / (point - image)[..., :1])
    by_mirror = (
        (np.abs(met[..., 1]) < HALF_Y)
        & (met[..., 2] > NEAR)
        & (met[..., 2] < FAR)
        & (point[..., 0] < MIRROR_X)
    )
    # The part of the wall that the mirror hides or shades is not tested.
    paper = ALBEDO / np.pi * rig.intensity_w_sr
    straight = paper / np.linalg.norm(point - lens, axis=-1) ** 3
    mirrored = by_mirror * paper / np.linalg.norm(point - image, axis=-1) ** 3
    back = point * [-1, 1, 1] + [2 * MIRROR_X, 0, 0]  # where the projector sees the wall
    column = project(rig.projector, transform_points(np.linalg.inv(rig.T_cam_proj), back))[..., 0]
    level = np.clip(np.rint(column), 0, rig.projector.width_px - 1) / 255

    def pixels(values):
        return values.reshape(height, 8, width, 8).mean(axis=(1, 3))

    return pixels(straight), pixels(mirrored), pixels(mirrored * level)


RIG = make_rig(centred(96, 72, 110), centred(160, 120, 140), baseline_m=(0.1, 0.0, 0.0))
WALL = wall(1.0, lambert(ALBEDO), half_m=2.0)
CLEAR = np.s_[8:64, 52:80]  # wall alone, outside the part that the mirror shades or hides


def lit_walls(renderer, *surfaces, pattern, seeds, samples=64):
    """Render a wall and other objects, once for each seed, without a third vertex."""
    scene = in_camera(RIG, WALL, *surfaces)
    quality = Quality(samples=samples, depth=2)
    return [
        renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed).radiance
        for seed in seeds
    ]


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.01, slow(0.05)])
def test_a_mirror_lights_a_wall_like_a_mirror_image_of_the_projector(mitsuba_renderer, roughness):
    """Oracle: irradiance, edges and columns in closed form; facets blur edges by 1 or 2 pixels."""
    mirror = strip(metal(roughness))
    runs = lit_walls(mitsuba_renderer, mirror, pattern=ramp(RIG), seeds=range(6))
    straight, mirrored, level = expected_on_the_wall(RIG, 96, 72)
    each = np.array([run.white for run in runs]) - straight
    light, error = each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(len(each))
    assert abs(light[CLEAR].sum() / mirrored[CLEAR].sum() - 1) < 0.01
    inner = binary_erosion(mirrored > 0, iterations=2)
    assert inner.sum() > 500
    assert abs(light[inner].sum() / mirrored[inner].sum() - 1) < 0.005
    off = (light - mirrored)[inner] / error[inner].mean()
    assert np.sqrt(np.square(off).mean()) < 1.3, "pixels are off by more than their noise"
    outer = binary_erosion(mirrored == 0, iterations=3)[CLEAR]
    assert np.abs(light[CLEAR][outer]).max() < 0.03 * mirrored.max()
    # The caustic's light has the levels of the mirror image's columns.
    (wall_alone,) = lit_walls(mitsuba_renderer, pattern=ramp(RIG), seeds=[0])
    ramped = np.mean([run.pattern[0] for run in runs], axis=0) - wall_alone.pattern[0]
    column = 255 * (ramped[inner] / light[inner] - level[inner] / mirrored[inner])
    assert abs(column.mean()) < 0.2 and np.abs(column).max() < 4


@pytest.fixture
def from_the_camera_alone(monkeypatch):
    """Render without light tracing."""

    def switch():
        monkeypatch.setattr("graycast.rendering.mitsuba.renderer._shiny_field", lambda *of: None)

    return switch


CAMERA, PROJECTOR = optics(32, 24, 38), optics(96, 72, 100)
BENT = (-0.12, 0.05, 0.002, -0.003, 0.0)
LENS = {"aperture_m": 0.02, "psf_px": 0.5}
CASES = {
    "sharp": (CAMERA, PROJECTOR, metal(0.35, 0.9)),
    "distorted": (
        replace(CAMERA, distortion=BENT),
        replace(PROJECTOR, distortion=BENT),
        metal(0.35, 0.9),
    ),
    "vignetting": (
        replace(CAMERA, natural_vignetting=True, falloff=0.3),
        replace(PROJECTOR, natural_vignetting=True, falloff=0.4),
        metal(0.35, 0.9),
    ),
    "gaps": (
        replace(CAMERA, fill_factor=0.5, psf_px=0.7),
        replace(PROJECTOR, fill_factor=0.6),
        metal(0.35, 0.9),
    ),
    "lens": (
        replace(CAMERA, focus_m=0.9, **LENS),
        replace(PROJECTOR, focus_m=0.7, **LENS),
        metal(0.35, 0.9),
    ),
    "coat": (CAMERA, PROJECTOR, Material(base_color=(0.0, 0.0, 0.0), roughness=0.25)),
    "film": (
        CAMERA,
        PROJECTOR,
        Material(base_color=(0.9, 0.7, 0.4), metallic=1.0, roughness=0.35, film=0.3),
    ),
    "blend": (
        CAMERA,
        PROJECTOR,
        Material(base_color=(0.7, 0.5, 0.3), metallic=0.5, roughness=0.35),
    ),
}


def room(camera, projector, material):
    """Return a wall, two upright strips and a ball at an angle."""
    rig = make_rig(
        camera,
        projector,
        baseline_m=(0.1, 0.02, 0.01),
        rotation=turned(0.02, -0.05, 0.03),
        band_weights=(0.5, 0.3, 0.2),
    )
    return in_camera(
        rig,
        wall(1.0, lambert(0.5), half_m=2.0),
        strip(material),
        Quad(
            center_m=(-0.3, 0.0, 0.8),
            half_u_m=(0.0, 0.0, -0.15),
            half_v_m=(0.0, 0.2, 0.0),
            material=material,
        ),
        Sphere(center_m=(0.0, 0.1, 0.9), radius_m=0.08, material=material),
    )


def pictures(renderer, scene, *, samples, seeds, depth=4):
    """Return white, a fine pattern and the bands per seed, summed over 8 x 8 pixels."""
    pattern = plain_pattern(scene.rig, 255)
    pattern[:, :, ::2] = 0
    quality = Quality(samples=samples, depth=depth, footprint=False)
    stacks = []
    for seed in seeds:
        light = renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed).radiance
        stacks.append(np.stack([light.white, light.pattern[0], light.white_rgb[..., 2]]))
    h, w = light.white.shape
    return np.array(stacks).reshape(len(stacks), 3, h // 8, 8, w // 8, 8).sum(axis=(3, 5))


def z_of(a, b):
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b))
    return (a.mean(axis=0) - b.mean(axis=0)) / error


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_camera_and_projector_paths_together_agree_with_brute_force(
    mitsuba_renderer, from_the_camera_alone, case
):
    """The oracle is brute force: 32,768 camera paths per pixel. A 0.5 % wrong weight, Jacobian or
    pupil would be five standard errors of the whole picture.
    """
    scene = room(*CASES[case])
    both = pictures(mitsuba_renderer, scene, samples=512, seeds=range(8))
    from_the_camera_alone()
    alone = pictures(mitsuba_renderer, scene, samples=4096, seeds=range(100, 108))
    whole = z_of(both.sum(axis=(2, 3)), alone.sum(axis=(2, 3)))
    assert np.abs(whole).max() < 4, whole
    # A misplaced caustic would give tens; the noise has longer tails than a Gaussian.
    assert np.sqrt(np.square(z_of(both, alone)).mean()) < 2.2


@pytest.mark.slow
def test_camera_paths_and_projector_paths_give_equal_energy(mitsuba_renderer, monkeypatch):
    """All light of shiny surfaces is sampled from the projector only, and then from the camera
    only; on the rough metal, both have little noise.
    """
    scene = room(CAMERA, PROJECTOR, metal(0.5, 0.9))
    shares = {"projector": (0.0, 1.0), "camera": (1.0, 0.0)}
    light = {}
    for name, (camera, projector) in shares.items():
        monkeypatch.setattr("graycast.rendering.mitsuba.paths.share", lambda odds, x=camera: x)
        monkeypatch.setattr(
            "graycast.rendering.mitsuba.caustics.share", lambda odds, x=projector: x
        )
        light[name] = pictures(mitsuba_renderer, scene, samples=1024, seeds=range(8))
    a, b = (one.sum(axis=(2, 3)) for one in light.values())
    assert np.abs(z_of(a, b)).max() < 4
    assert np.abs(a.mean(axis=0) / b.mean(axis=0) - 1).max() < 0.01


@pytest.mark.slow
def test_projector_paths_do_not_change_the_mean_light_in_a_matt_room(mitsuba_renderer, monkeypatch):
    """Without shiny surfaces, no path starts at the projector; if all count as shiny, the mean is
    equal.
    """
    scene = room(CAMERA, PROJECTOR, lambert(0.7))
    plain = pictures(mitsuba_renderer, scene, samples=128, seeds=range(8))
    monkeypatch.setattr("graycast.rendering.mitsuba.scene._is_shiny", lambda material: True)
    mitsuba_renderer.close()  # This makes the next render build the world again.
    both = pictures(mitsuba_renderer, scene, samples=128, seeds=range(8))
    mitsuba_renderer.close()
    assert not np.array_equal(plain, both)
    assert np.abs(z_of(plain.sum(axis=(2, 3)), both.sum(axis=(2, 3)))).max() < 4


@pytest.mark.slow
def test_swapping_camera_and_projector_does_not_change_transported_light(mitsuba_renderer):
    """Helmholtz: light between a region of the camera's picture and one of the projector's is the
    same if camera and projector are exchanged. A black glossy coat is exactly reciprocal.
    """
    material = Material(base_color=(0.0, 0.0, 0.0), roughness=0.15, specular=1.0)
    a, b = centred(40, 32, 50), centred(40, 32, 50)
    rig = make_rig(a, b, baseline_m=(0.12, 0.0, 0.0))
    T = rig.T_cam_proj
    surfaces = wall(1.0, lambert(0.5), half_m=2.0), strip(material)
    there = in_camera(rig, *surfaces, T_world_cam=np.eye(4))
    swapped = replace(rig, T_cam_proj=np.linalg.inv(T))
    back = replace(there, rig=swapped, T_world_cam=T.copy())
    view, lit = np.s_[10:22, 24:32], np.s_[12:20, 30:40]

    def power(scene, shining, looking):
        pattern = plain_pattern(scene.rig, 0)
        pattern[0][shining] = 255
        cosine = 1 / np.sqrt(1 + ((np.mgrid[:32, :40] - [[[15.5]], [[19.5]]]) ** 2).sum(0) / 2500)
        values = [
            (
                mitsuba_renderer.render(
                    scene,
                    EMPTY_LAYOUT,
                    pattern,
                    quality=Quality(samples=256, depth=2, footprint=False),
                    seed=seed,
                ).radiance.pattern[0]
                * cosine**3
            )[looking].sum()
            for seed in range(12)
        ]
        return np.array(values)

    forth, swapped_power = power(there, lit, view), power(back, view, lit)
    assert forth.mean() > 0
    assert abs(z_of(forth, swapped_power)) < 4
    assert abs(forth.mean() / swapped_power.mean() - 1) < 0.03


@pytest.mark.slow
def test_one_seed_gives_one_picture_of_a_caustic(mitsuba_renderer):
    """Threads may add to a pixel in any order, which must not change the sum."""
    scene = room(CAMERA, PROJECTOR, metal(0.1))
    a, b = (pictures(mitsuba_renderer, scene, samples=64, seeds=[3]) for _ in range(2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, pictures(mitsuba_renderer, scene, samples=64, seeds=[4]))


@pytest.mark.slow
def test_projector_paths_reduce_the_variance_a_hundredfold(mitsuba_renderer, from_the_camera_alone):
    """At roughness 0.1, paths from the camera hit the strip's light by chance."""

    def variance():
        runs = lit_walls(
            mitsuba_renderer, strip(metal(0.1)), pattern=ramp(RIG), seeds=range(8), samples=16
        )
        return np.var([run.white[CLEAR] for run in runs], axis=0).mean()

    both = variance()
    from_the_camera_alone()
    assert both < 0.01 * variance()


@pytest.mark.slow
def test_the_stated_path_noise_includes_caustics(mitsuba_renderer):
    """The stated deviation is that of many renderings, where a caustic is on a lit wall."""
    pattern = plain_pattern(RIG, 0)
    pattern[0] = 255 * (np.arange(160) // 2 % 2)
    mirror = strip(metal(0.15))
    runs = lit_walls(mitsuba_renderer, mirror, pattern=pattern, seeds=range(16), samples=16)
    straight, mirrored, _ = expected_on_the_wall(RIG, 96, 72)
    caustic = binary_erosion(mirrored > 0, iterations=3)
    stated = np.mean([run.path_noise.stray[0][caustic] for run in runs])
    # The pattern's mean is half of the white light, and its deviation is a half.
    stray = [(run.pattern[0] - run.white / 2)[caustic] * 2 / straight[caustic] for run in runs]
    measured = np.sqrt(np.var(stray, axis=0, ddof=1).mean())
    assert 0.7 < stated / measured < 1.4, (stated, measured)


@pytest.mark.slow
def test_cycles_renders_the_same_caustic_as_mitsuba(mitsuba_renderer, cycles_renderer):
    """Oracle: another program, with camera paths only, on four strips of the wall, to 3 %."""

    def strips(renderer, samples):
        mirror = strip(metal(0.3))
        (run,) = lit_walls(renderer, mirror, pattern=ramp(RIG), seeds=[1], samples=samples)
        light = run.white - expected_on_the_wall(RIG, 96, 72)[0]
        return light[CLEAR].reshape(-1, 4, 7).sum(axis=(0, 2))

    ours, theirs = strips(mitsuba_renderer, 256), strips(cycles_renderer, 1024)
    assert np.abs(theirs / ours - 1).max() < 0.03
