"""Blur of both lenses against the thin lens's closed forms, and against a rig that was measured."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1
from stage import centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.frames import transform_points
from graycast.optics import Optics, blur_radius_px
from graycast.render import Quality
from graycast.scene import EMPTY_LAYOUT, Quad, Sphere

ROWS = 24
NEAR_BY = (1e-4, 0.0, 0.0)  # a baseline without shadows and with next to no parallax
HALF_M = 0.5
BLUR_M = 20e-3  # pupils that blur by pixels


def light_of(renderer, scene, pattern, *, samples=256, depth=1, seed=0):
    quality = Quality(samples=samples, depth=depth)
    rendering = renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)
    return rendering.radiance


def half_wall(z_m, material):
    """The half x > 0 of a wall across the axis."""
    return Quad(
        center_m=(HALF_M, 0.0, z_m),
        half_u_m=(HALF_M, 0.0, 0.0),
        half_v_m=(0.0, -HALF_M, 0.0),
        material=material,
    )


def spread(edge):
    """Standard deviation of the line spread along the rows of an edge's share of white, 0 to 1, and
    its standard error [pixels]. Two boxes of a pixel, its own and the difference's, are taken off.
    """
    line = np.diff(edge, axis=1)
    assert np.abs(line.sum(axis=1) - 1).max() < 1e-3
    x = np.arange(line.shape[1])
    # A common middle: that of each row would take a part of its noise with it.
    variance = (line * (x - (line.mean(axis=0) @ x)) ** 2).sum(axis=1) - 1 / 6
    error = variance.std(ddof=1) / math.sqrt(len(edge))
    deviation = math.sqrt(max(variance.mean(), 1e-12))
    return deviation, error / (2 * deviation)


def camera_spread(renderer, camera, z_m, *, samples):
    """Of a camera that looks at the edge of a lit wall through its lens."""
    rig = make_rig(camera, centred(64, 64, 30), baseline_m=NEAR_BY)
    pattern = plain_pattern(rig, 255)
    edge, whole = (
        light_of(renderer, in_camera(rig, surface), pattern, samples=samples).white
        for surface in (half_wall(z_m, lambert(0.8)), wall(z_m, lambert(0.8)))
    )
    return spread(edge / whole)


def projector_spread(renderer, projector, z_m, *, samples, finer=2):
    """Of a projector that shows an edge, seen by a pinhole with `finer` pixels to each of its."""
    camera = centred(finer * (projector.width_px - 10), ROWS, finer * projector.fx_px)
    rig = make_rig(camera, projector, baseline_m=NEAR_BY)
    pattern = plain_pattern(rig, 0)
    pattern[:, :, projector.width_px // 2 :] = 255
    light = light_of(renderer, in_camera(rig, wall(z_m, lambert(0.8))), pattern, samples=samples)
    deviation, error = spread(light.pattern[0] / light.white)
    return deviation / finer, error / finer


def blurred(optics, focus_m, *, aperture_m=BLUR_M, **words):
    return replace(optics, aperture_m=aperture_m, focus_m=focus_m, **words)


@pytest.mark.parametrize("z_m", [0.35, 0.5, 0.8, 1.5])
@pytest.mark.parametrize("device", ["camera", "projector"])
def test_an_edge_spreads_by_half_the_radius_of_the_thin_lens(mitsuba_renderer, device, z_m):
    """The line spread of a disc of radius R has the standard deviation R / 2. R by similar
    triangles: rays from the pupil's rim to a point at z cross the plane in focus, at f, apart by
    A |z - f| / z, which is seen under a pixel per f / fx.
    """
    focus_m, psf_px, f_px = 0.5, 1.5, 300.0
    lens = blurred(centred(96, ROWS, f_px), focus_m, psf_px=psf_px)
    defocus_px = BLUR_M / 2 * abs(z_m - focus_m) / z_m / focus_m * f_px
    measure = camera_spread if device == "camera" else projector_spread
    deviation, error = measure(mitsuba_renderer, lens, z_m, samples=1024)
    expected = math.hypot(defocus_px, psf_px) / 2
    assert error < 0.01 * expected
    assert abs(deviation - expected) < 4 * error + 0.003 * expected


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_a_pupil_that_shrinks_gives_the_picture_of_a_pinhole(mitsuba_renderer, device):
    plain = make_rig(centred(48, 36, 60), centred(32, 24, 40), baseline_m=(0.1, 0.0, 0.0))
    lens = replace(getattr(plain, device), aperture_m=1e-7, focus_m=0.3)
    checker = (np.indices((24, 32)).sum(axis=0) % 2 * 255).astype(np.uint8)[None]
    ball = Sphere(center_m=(0.0, 0.05, 0.7), radius_m=0.1, material=lambert(0.6))
    images = [
        light_of(
            mitsuba_renderer, in_camera(rig, wall(0.9, lambert(0.5)), ball), checker, samples=64
        ).pattern[0]
        for rig in (plain, replace(plain, **{device: lens}))
    ]
    assert images[0].max() > 0.5
    differing = np.abs(images[0] - images[1]) > 1e-3 * images[0].max()
    assert differing.mean() < 0.01  # a ray in sixty on the other side of a border


@pytest.mark.parametrize("z_m", [0.5, 0.7, 1.0, 1.6])
def test_stripes_lose_contrast_with_distance_as_the_disc_has_it(mitsuba_renderer, z_m):
    """Transfer of a disc at frequency 1 / P: 2 J1(x) / x, x = 2 pi R / P, below 0 beyond its first
    zero (Goodman, "Introduction to Fourier Optics"); each pixel on the way is a sinc.
    """
    period_px, f_px, focus_m = 16, 160.0, 0.5
    projector = blurred(centred(160, 16, f_px), focus_m, aperture_m=40e-3)
    finer = 2.07  # so that camera pixels lie anywhere in projector pixels
    camera = centred(256, ROWS, finer * f_px)
    column = np.arange(160)
    sines = [127.5 * (1 - np.cos(2 * np.pi * (column / period_px - k / 4))) for k in range(4)]
    pattern = np.rint(np.broadcast_to(np.stack(sines)[:, None], (4, 16, 160))).astype(np.uint8)
    rig = make_rig(camera, projector, baseline_m=(0.05, 0.0, 0.0))
    scene = in_camera(rig, wall(z_m, lambert(0.8)))
    light = light_of(mitsuba_renderer, scene, pattern, samples=64)
    # Oracle of the place: similar triangles, x_cam / f_cam - b / z = x_proj / f_proj.
    place = (np.arange(256) - 127.5) / finer - f_px * 0.05 / z_m + 79.5
    lit = (place > 24) & (place < 136)
    carrier = np.exp(2j * np.pi * place / period_px)
    i = light.pattern.astype(float) / light.white
    phasor = ((i[2] - i[0]) + 1j * (i[3] - i[1])) / carrier
    seen = phasor[:, lit].reshape(ROWS, -1).mean(axis=1)
    radius_px = 20e-3 * abs(1 / focus_m - 1 / z_m) * f_px
    x = 2 * np.pi * radius_px / period_px
    expected = (2 * j1(x) / x if x else 1.0) * np.sinc(1 / period_px)
    expected *= np.sinc(1 / finer / period_px)
    error = seen.real.std(ddof=1) / math.sqrt(ROWS)
    assert error < 0.004
    assert abs(seen.mean().real - expected) < 4 * error + 0.002
    assert abs(seen.mean().imag) < 0.005  # stripes do not move


@pytest.mark.slow
@pytest.mark.parametrize("picture", ["spot", "white"])
def test_defocus_loses_no_light(mitsuba_renderer, picture):
    """A bright square, and the whole field with its borders: their sums on a wall stay."""
    sharp = make_rig(centred(96, 96, 60), centred(32, 24, 40), baseline_m=NEAR_BY)
    soft = replace(
        sharp,
        camera=blurred(sharp.camera, 0.4, aperture_m=10e-3),
        projector=blurred(sharp.projector, 0.4, aperture_m=30e-3, psf_px=1.0),
    )
    pattern = np.zeros((1, 24, 32), dtype=np.uint8)
    if picture == "spot":
        pattern[0, 8:14, 10:20] = 255
    else:
        pattern[:] = 255
    total = []
    for rig in (sharp, soft):
        scene = in_camera(rig, wall(1.0, lambert(0.8)))
        light = light_of(mitsuba_renderer, scene, pattern, samples=256)
        if picture == "white":
            assert np.abs(light.pattern[0] - light.white).max() < 1e-5 * light.white.max()
        total.append(float(light.pattern[0].sum()))
    assert total[1] / total[0] == pytest.approx(1, abs=2e-3)


@pytest.mark.slow
def test_the_shadow_of_an_edge_is_as_soft_as_the_pupil_is_wide(mitsuba_renderer):
    """Similar triangles: the pupil's disc, seen through the edge, is (z2 - z1) / z1 as large."""
    z1, z2, f_px, aperture_m = 0.5, 0.8, 200.0, 30e-3
    camera = centred(120, ROWS, f_px)
    projector = blurred(centred(64, 64, 20), z2, aperture_m=aperture_m)
    rig = make_rig(camera, projector, baseline_m=(0.2, 0.0, 0.0))
    edge_m = 0.13  # in the camera frame; its shadow falls beside what the camera sees of it
    screen = Quad(
        center_m=(edge_m + 1.0, 0.0, z1),
        half_u_m=(1.0, 0.0, 0.0),
        half_v_m=(0.0, -1.0, 0.0),
        material=lambert(0.0),
    )
    back = wall(z2, lambert(0.8))
    shadowed, whole = (
        light_of(
            mitsuba_renderer, in_camera(rig, *surfaces), plain_pattern(rig, 255), samples=1024
        ).white
        for surfaces in ((back, screen), (back,))
    )
    middle_m = 0.2 + (edge_m - 0.2) * z2 / z1
    middle_px = f_px * middle_m / z2 + 59.5
    lit = (shadowed / whole)[:, int(middle_px) - 20 : int(middle_px) + 20]
    deviation, error = spread(1 - lit)
    expected = aperture_m / 2 * (z2 - z1) / z1 * f_px / z2 / 2
    assert abs(deviation - expected) < 4 * error + 0.01 * expected
    assert error < 0.01 * expected


def ramp_error_px(renderer, rig, *, samples, seeds):
    """Where a ramp of grey puts each pixel of a tilted wall, less where it is [camera pixels]."""
    size = (rig.projector.height_px, rig.projector.width_px)
    ramp = np.broadcast_to(np.arange(256, dtype=np.uint8), (1, *size))
    normal = np.array([0.3, 0.1, 1.0])
    plane = Quad(
        center_m=(0.0, 0.0, 0.9),
        half_u_m=(2.0, 0.0, -0.6),
        half_v_m=tuple((-4 * np.cross(normal, [2.0, 0.0, -0.6]) / 2).tolist()),
        material=lambert(0.7),
    )
    camera = rig.camera
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    ray = np.stack([(x - camera.cx_px), (y - camera.cy_px), 0 * x + camera.fx_px], axis=-1)
    point = ray * (0.9 / (ray @ normal))[..., None]
    q = transform_points(np.linalg.inv(rig.T_cam_proj), point)
    column = rig.projector.fx_px * q[..., 0] / q[..., 2] + rig.projector.cx_px
    per_px = np.gradient(column, axis=1)
    inside = (column > 40) & (column < 215)
    errors = []
    for seed in range(seeds):
        light = light_of(renderer, in_camera(rig, plane), ramp, samples=samples, seed=seed)
        shown = light.pattern[0][inside] / light.white[inside] * 255
        errors.append((shown - column[inside]) / per_px[inside])
    return np.stack(errors)


@pytest.mark.slow
@pytest.mark.parametrize("soft", [False, True])
def test_a_ramp_on_a_tilted_plane_comes_back_in_its_place_and_without_noise(mitsuba_renderer, soft):
    """Mirrored samples cancel in any linear picture. What is left is rounding to the projector's
    pixels, 1 / sqrt(12) of a sixteenth of a pixel over 4 for 16 samples, and curvature.
    """
    rig = make_rig(centred(14, 40, 160), centred(256, 700, 2560), baseline_m=(5e-3, 0.0, 0.0))
    if soft:
        camera = blurred(rig.camera, 0.5, aperture_m=8e-3)
        rig = replace(rig, camera=camera, projector=blurred(rig.projector, 0.6, aperture_m=6e-3))
    error = ramp_error_px(mitsuba_renderer, rig, samples=16, seeds=4)
    bound = 1 / math.sqrt(12) / 16 / 4
    assert error.size > 800
    assert error.std() < 1.6 * bound  # unpaired R2 leaves 0.02 of a pixel, four times that
    assert abs(error.mean()) < 4 * bound / math.sqrt(error.size) + 4e-4


# What scanner_sim calls blur, over the standard deviation D / 4 of the disc's line spread.
# Camera: twice the scale of a logistic fitted to an edge, whose deviation is pi / sqrt(3) scales.
# Projector: the width of a spot, for which the line spread's full width at half maximum stands.
PER_DEVIATION = {"camera": 2 * math.sqrt(3) / math.pi, "projector": 2 * math.sqrt(3)}


def measured_curve(shared, device):
    """Distance [m] and blur [m on the plane, or pixels], and the file's other figures in SI."""
    content = json.loads((shared / "data/rigs/scanner_sim" / f"{device}_focus.json").read_text())
    curve = next(value for key, value in content.items() if key.startswith("dof"))
    z_mm, blur = np.array(curve)
    order = np.argsort(z_mm)
    unit = 1e-3 if device == "projector" else 1.0
    best = next(value for key, value in content.items() if key.startswith("best_res"))
    figures = content["aperture, mm"] / 1e3, content["focus, mm"] / 1e3, best * unit
    return z_mm[order] / 1e3, blur[order] * unit, *figures


def simulated_over_measured(renderer, shared, device, z, blur, lens_of):
    """Ratio of the standard deviation of an edge's spread to the published blur, by distance."""
    aperture_m, focus_m, best = lens_of
    geometry = json.loads((shared / f"data/rigs/scanner_sim/{device}_geometry.json").read_text())
    f_px = geometry["mtx"][0][0]
    best_px = best if device == "camera" else best / focus_m * f_px
    psf_px = 2 * best_px / PER_DEVIATION[device]
    lens = blurred(centred(120, ROWS, f_px), focus_m, aperture_m=aperture_m, psf_px=psf_px)
    measure = camera_spread if device == "camera" else projector_spread
    simulated = np.array([measure(renderer, lens, distance, samples=128)[0] for distance in z])
    return simulated * (1 if device == "camera" else z / f_px) / blur


@pytest.mark.slow
def test_a_measured_cameras_blur_follows_its_curve_over_all_distances(mitsuba_renderer, shared):
    """scanner_sim's camera (CC BY 4.0), aperture and focus as its file has them. The measure is the
    edge's line spread's standard deviation. One factor is fitted, and lies near the one expected.
    """
    z, blur, *lens = measured_curve(shared, "camera")
    pick = np.linspace(0, len(z) - 1, 9).astype(int)
    ratio = simulated_over_measured(mitsuba_renderer, shared, "camera", z[pick], blur[pick], lens)
    factor = 1 / np.exp(np.log(ratio).mean())
    assert factor == pytest.approx(PER_DEVIATION["camera"], rel=0.05)
    assert np.abs(factor * ratio - 1).max() < 0.05


@pytest.mark.slow
def test_a_measured_projectors_blur_has_its_shape_over_all_distances(mitsuba_renderer, shared):
    """scanner_sim's projector: the curve, scaled to a largest value of 1, is met within 0.1.

    It is not met within 10 % point by point: between 0.35 and 0.595 m the published figures are up
    to 1.8 times below any evenly lit disc of the published aperture and focus. They are twice the R
    of a fit of `scale / (1 + exp(r - R) / sigma)` to a spot, and that function determines only
    `R + ln(sigma)`; sigma was not published.
    """
    z, blur, *lens = measured_curve(shared, "projector")
    pick = np.linspace(0, len(z) - 1, 13).astype(int)
    ratio = simulated_over_measured(
        mitsuba_renderer, shared, "projector", z[pick], blur[pick], lens
    )
    factors = np.linspace(0.8, 1.2, 81)[:, None] * PER_DEVIATION["projector"]
    off = np.abs(factors * ratio - 1) * blur[pick] / blur.max()
    best = off.max(axis=1).argmin()
    assert factors[best, 0] == pytest.approx(PER_DEVIATION["projector"], rel=0.1)
    assert off[best].max() < 0.10


def test_the_radius_in_the_renderer_is_the_one_that_optics_states(mitsuba_renderer):
    """`optics.blur_radius_px` is what others plan with."""
    lens = blurred(centred(96, ROWS, 300.0), 0.5, psf_px=2.0)
    deviation, error = camera_spread(mitsuba_renderer, lens, 0.9, samples=256)
    assert isinstance(lens, Optics)
    assert abs(deviation - blur_radius_px(lens, np.array([0.9]))[0] / 2) < 5 * error
