"""Mitsuba and Cycles on a scene with interreflection: equal means within the noise of both."""

import numpy as np
import pytest
from corner import COAT, METAL, corner_scene
from noisy_pictures import agree, blocks
from stage import lambert, plain_pattern

from graycast.rendering import Quality
from graycast.rig.pattern import gray

pytestmark = pytest.mark.slow  # each render of Cycles takes some seconds

DEPTH = 3
DULL = {"metal": lambert(0.6, 0.5, 0.4), "coat": lambert(0.6, 0.3, 0.2)}


def stripes(rig):
    """Return white, and the second coarsest stripes."""
    code = gray(rig.projector.width_px, rig.projector.height_px)
    order = [frame.name for frame in code.frames]
    return code.render()[[order.index("white"), order.index("column_bit01")]]


def pictures(renderer, scene, layout, pattern, *, seeds, samples, depth=DEPTH):
    """Return pictures (seeds, patterns, h, w), and the truth."""
    quality = Quality(samples=samples, depth=depth, footprint=False)
    renderings = [
        renderer.render(scene, layout, pattern, quality=quality, seed=seed) for seed in seeds
    ]
    stack = np.stack([rendering.radiance.pattern for rendering in renderings])
    return stack.astype(float), renderings[0].truth


@pytest.fixture(scope="module")
def dull_pair(mitsuba_renderer, cycles_renderer):
    """Return blocks (seeds, patterns, blocks) of a scene of Lambertian surfaces only."""
    scene, layout = corner_scene(**DULL)
    pattern = stripes(scene.rig)
    return [
        blocks(pictures(renderer, scene, layout, pattern, seeds=seeds, samples=16)[0])
        for renderer, seeds in ((mitsuba_renderer, range(8)), (cycles_renderer, range(50, 56)))
    ]


def test_mitsuba_and_cycles_render_statistically_equal_pictures(dull_pair):
    """Two programs without common code, each with its own random numbers."""
    ours, theirs = dull_pair
    for k in range(ours.shape[1]):
        assert agree(ours[:, k], theirs[:, k])


def test_the_comparison_detects_a_2_percent_error_and_a_missing_bounce(dull_pair, mitsuba_renderer):
    ours, theirs = dull_pair
    for k in range(ours.shape[1]):
        assert not agree(1.02 * ours[:, k], theirs[:, k])
        assert not agree(ours[:, k], 1.02 * theirs[:, k])
    scene, layout = corner_scene(**DULL)
    pattern = plain_pattern(scene.rig, 255)
    shallow, _ = pictures(
        mitsuba_renderer, scene, layout, pattern, seeds=range(4), samples=16, depth=DEPTH - 1
    )
    assert not agree(blocks(shallow)[:, 0], theirs[:, 0])


def test_pictures_by_mitsuba_and_cycles_agree_to_half_a_percent(mitsuba_renderer, cycles_renderer):
    scene, layout = corner_scene(**DULL)
    pattern = stripes(scene.rig)
    ours, theirs = (
        blocks(pictures(renderer, scene, layout, pattern, seeds=seeds, samples=100)[0])
        for renderer, seeds in ((mitsuba_renderer, range(16)), (cycles_renderer, range(50, 66)))
    )
    for k in range(len(pattern)):
        assert agree(ours[:, k], theirs[:, k])
        assert not agree(1.005 * ours[:, k], theirs[:, k])


# Allowed differences of the models: metal is one published model in both; Cycles' coat dims its
# base by another rule, 3 % at this roughness under steep light (`test_materials_in_both.py`); the
# walls see both. The noise comes from the few pixels that see the projector in the metal.
LIMITS = {"wall": 0.002, "metal": 0.005, "coat": 0.03}
NOISE = {"wall": 0.001, "metal": 0.007, "coat": 0.003}


def test_mitsuba_and_cycles_agree_on_each_material_within_its_limit(
    mitsuba_renderer, cycles_renderer
):
    scene, layout = corner_scene(metal=METAL, coat=COAT)
    pattern = plain_pattern(scene.rig, 255)
    (ours, truth), (theirs, _) = (
        pictures(renderer, scene, layout, pattern, seeds=seeds, samples=144)
        for renderer, seeds in ((mitsuba_renderer, range(12)), (cycles_renderer, range(50, 62)))
    )
    dull, _ = corner_scene(**DULL)
    ball = np.isin(truth.instance, -1) & ~on_walls(truth.depth_m, dull)
    where = {"metal": truth.instance == 0, "coat": ball}
    where["wall"] = ~(where["metal"] | ball)
    for name, mask in where.items():
        assert mask.sum() > 40
        one, other = (stack[:, 0][:, mask].mean(axis=1) for stack in (ours, theirs))
        ratio = other.mean() / one.mean()
        error = np.hypot(one.std(ddof=1) / one.mean(), other.std(ddof=1) / other.mean())
        error /= np.sqrt(len(one))
        assert error < NOISE[name]
        assert abs(ratio - 1) < LIMITS[name] + 4 * error, name


def on_walls(depth_m, scene):
    """Return the pixels whose depth is that of one of the two inclined walls."""
    camera = scene.rig.camera
    x = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px
    normal_z, normal_x = 1 / np.hypot(0.8, 1.0), 0.8 / np.hypot(0.8, 1.0)
    z = [0.85 / (normal_z + side * normal_x * x) for side in (1, -1)]
    return np.any([np.abs(depth_m - one) < 1e-4 for one in z], axis=0)
