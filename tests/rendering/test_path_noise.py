"""Sigma includes the errors from few light paths: of the mean position, and of stray light."""

from dataclasses import replace

import numpy as np
import pytest
from stage import centred, in_camera, lambert, leaning_wall, make_rig

from benchmarks.cells import QUIET_SENSOR
from graycast.camera.decode import triangulate
from graycast.camera.scanner import Scanner, measure, scan
from graycast.camera.sigma import light_path_px
from graycast.rendering import Quality
from graycast.rendering.path_noise import path_noise
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT

RIG = make_rig(centred(56, 44, 60), centred(160, 120, 110), baseline_m=(0.1, 0.0, 0.0))
BLURRED = replace(RIG, projector=replace(RIG.projector, psf_px=1.0))
FINE = Quality(depth=1)


def taken(renderer, scanner, *surfaces, quality, seed):
    scene = in_camera(scanner.rig, *surfaces)
    code = scanner.light_code()
    rendering = renderer.render(scene, EMPTY_LAYOUT, code.render(), quality=quality, seed=seed)
    return rendering, scan(scanner, rendering.radiance, seed=seed)


def rms(values):
    return float(np.sqrt(np.nanmean(np.square(values, dtype=np.float64))))


@pytest.mark.parametrize(
    ("codec", "samples", "rig"),
    [
        ("gray_phase", 1, RIG),
        ("gray_phase", 16, RIG),
        ("multi_frequency", 4, BLURRED),
        *(
            pytest.param(codec, samples, rig, marks=pytest.mark.slow)
            for codec in ("gray", "gray_phase", "multi_frequency", "micro_phase")
            for samples in (1, 2, 4, 16, 64)
            for rig in (RIG, BLURRED)
        ),
    ],
)
def test_sigma_includes_the_error_of_few_paths(mitsuba_renderer, codec, samples, rig):
    """Oracle: the true depth of a plane that is inclined along both axes."""
    scanner = Scanner(rig=rig, code=CodeSpec(codec=codec, axes=("column",)))
    wall = leaning_wall((0.35, 0.2, 1.0), 0.8, lambert(0.6))
    quality = replace(FINE, samples=samples)
    rendering, shot = taken(mitsuba_renderer, scanner, wall, quality=quality, seed=samples)
    off_m = shot.depth.depth_m - rendering.truth.depth_m
    assert np.isfinite(off_m).mean() > 0.9
    assert 0.8 < rms(off_m / shot.depth.sigma_m) < 1.3


def test_sigma_of_the_code_excludes_the_error_of_few_paths(mitsuba_renderer):
    """This shows that the test above can fail: without the renderer's share, sigma is far too
    small; the share comes from paths, so it falls with their number.
    """
    scanner = Scanner(rig=RIG, code=CodeSpec(codec="gray_phase", axes=("column",)))
    wall = leaning_wall((0.35, 0.2, 1.0), 0.8, lambert(0.6))
    share_px = {}
    for samples in (1, 16):
        quality = replace(FINE, samples=samples)
        rendering, _ = taken(mitsuba_renderer, scanner, wall, quality=quality, seed=samples)
        noise = rendering.radiance.path_noise
        share_px[samples] = np.median(light_path_px(scanner.light_code(), noise)["column"])
    assert share_px[16] < share_px[1] / 4
    codes = scan(scanner, replace(rendering.radiance, path_noise=None), seed=3).codes
    alone = triangulate(codes, scanner.rig)  # sigma of the code
    assert rms((alone.depth_m - rendering.truth.depth_m) / alone.sigma_m) > 2


def test_sigma_includes_the_error_of_stray_light(mitsuba_renderer):
    """Oracle: two renderings with other paths differ by sqrt(2) sigma; their common interreflection
    cancels. Two white walls face each other, and the sensor has no noise.
    """
    scanner = Scanner(
        rig=RIG, code=CodeSpec(codec="gray_phase", axes=("column",)), sensor=QUIET_SENSOR
    )
    walls = [leaning_wall((n, 0.1, 1.0), 0.8, lambert(0.8), half_m=0.6) for n in (0.6, -0.6)]
    quality = Quality(samples=4)
    (one, shot), (_, other) = (
        taken(mitsuba_renderer, scanner, *walls, quality=quality, seed=seed) for seed in (1, 2)
    )
    sigma_px = np.hypot(shot.codes.sigma_column, other.codes.sigma_column)
    off = np.abs(shot.codes.column - other.codes.column) / sigma_px
    noise = one.radiance.path_noise
    of_both = light_path_px(scanner.light_code(), noise)["column"]
    of_place = noise.place_sigma_px[0]
    assert np.isfinite(off).mean() > 0.9
    assert np.median(of_both) > 1.2 * np.median(of_place)
    assert 0.8 < np.nanquantile(off, 0.6827) < 1.2


def test_edges_and_shadows_do_not_increase_the_path_noise_of_a_position():
    """Oracle: noise of a known size on a ramp; a step of 30 px, whose pixels see both sides, and a
    dark stripe, next to which light is one-sided, do not increase it. Without light it is 0.
    """
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:60, :80].astype(np.float32)
    centre = np.stack([1.5 * x + 30 * (x >= 40), y], axis=-1)
    mean = centre + rng.normal(0, 0.05, centre.shape).astype(np.float32)
    mean[:, 39:41] += 12
    mean[:, [60, 64]] += 0.7
    mean[:, 61:64] = np.nan
    straight = np.isfinite(mean[..., 0]).astype(np.float32)
    stray2 = {"column": np.full(straight.shape, 1e-4, dtype=np.float32)}
    places = {axis: (mean[..., i], centre[..., i]) for i, axis in enumerate(("column", "row"))}
    noise = path_noise(places, straight, stray2, samples=16)
    lit = straight > 0
    np.testing.assert_allclose(np.median(noise.place_sigma_px[:, lit], axis=1), 0.05, rtol=0.1)
    assert noise.place_sigma_px[0, lit].max() < 0.08
    assert (noise.place_sigma_px[:, ~lit] == 0).all() and (noise.stray[:, ~lit] == 0).all()
    np.testing.assert_allclose(noise.stray[0, lit], 0.01, rtol=1e-5)
    assert (noise.stray[1] == 0).all()


def test_pictures_without_known_path_noise_add_nothing_to_sigma(mitsuba_renderer):
    """Real pictures have no path noise, and some renderers do not know theirs."""
    scanner = Scanner(rig=RIG, code=CodeSpec(codec="gray_phase", axes=("column",)))
    wall = leaning_wall((0.35, 0.2, 1.0), 0.8, lambert(0.6))
    rendering, shot = taken(mitsuba_renderer, scanner, wall, quality=FINE, seed=1)
    codes, _ = measure(scanner, shot.capture, path_noise=None)
    own = light_path_px(scanner.light_code(), rendering.radiance.path_noise)["column"]
    np.testing.assert_allclose(
        shot.codes.sigma_column, np.hypot(codes.sigma_column, own), rtol=1e-6
    )
    assert np.nanmedian(shot.codes.sigma_column / codes.sigma_column) > 1.5
