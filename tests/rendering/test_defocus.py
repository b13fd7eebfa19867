"""Blur of both lenses in Mitsuba: stripes, positions, and a measured rig."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from edge_spread import ROWS, blurred, camera_spread, light_of, projector_spread
from scipy.special import j1
from stage import centred, in_camera, lambert, make_rig, wall

from graycast.base.frames import transform_points
from graycast.rig.optics import Optics, blur_radius_px
from graycast.world.scene import Quad


@pytest.mark.parametrize("z_m", [0.5, 0.7, 1.0, 1.6])
def test_defocused_stripes_lose_contrast_as_the_blur_disc_predicts(mitsuba_renderer, z_m):
    """Oracle: the transfer function of a disc at frequency 1 / P is 2 J1(x) / x with x = 2 pi R /
    P, which is negative beyond its first zero (Goodman, "Introduction to Fourier Optics"); each
    pixel adds a sinc.
    """
    period_px, f_px, focus_m = 16, 160.0, 0.5
    projector = blurred(centred(160, 16, f_px), focus_m, aperture_m=40e-3)
    finer = 2.07  # Camera pixels are then anywhere in projector pixels.
    camera = centred(256, ROWS, finer * f_px)
    column = np.arange(160)
    sines = [127.5 * (1 - np.cos(2 * np.pi * (column / period_px - k / 4))) for k in range(4)]
    pattern = np.rint(np.broadcast_to(np.stack(sines)[:, None], (4, 16, 160))).astype(np.uint8)
    rig = make_rig(camera, projector, baseline_m=(0.05, 0.0, 0.0))
    scene = in_camera(rig, wall(z_m, lambert(0.8)))
    light = light_of(mitsuba_renderer, scene, pattern, samples=64)
    # Oracle of the position: similar triangles, x_cam / f_cam - b / z = x_proj / f_proj.
    place = (np.arange(256) - 127.5) / finer - f_px * 0.05 / z_m + 79.5
    lit = (place > 24) & (place < 136)
    carrier = np.exp(2j * np.pi * place / period_px)
    i = light.pattern.astype(float) / light.white
    phasor = ((i[2] - i[0]) + 1j * (i[3] - i[1])) / carrier
    contrast = phasor[:, lit].reshape(ROWS, -1).mean(axis=1)
    radius_px = 20e-3 * abs(1 / focus_m - 1 / z_m) * f_px
    x = 2 * np.pi * radius_px / period_px
    expected = (2 * j1(x) / x if x else 1.0) * np.sinc(1 / period_px)
    expected *= np.sinc(1 / finer / period_px)
    error = contrast.real.std(ddof=1) / math.sqrt(ROWS)
    assert error < 0.004
    assert abs(contrast.mean().real - expected) < 4 * error + 0.002
    assert abs(contrast.mean().imag) < 0.005  # stripes do not move


def ramp_error_px(renderer, rig, *, samples, seeds):
    """Return the error of a grey ramp's position in each pixel of a tilted wall [camera pixels]."""
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
        level = light.pattern[0][inside] / light.white[inside] * 255
        errors.append((level - column[inside]) / per_px[inside])
    return np.stack(errors)


@pytest.mark.slow
@pytest.mark.parametrize("soft", [False, True])
def test_a_defocused_ramp_on_a_tilted_plane_keeps_its_exact_position(mitsuba_renderer, soft):
    """Mirrored samples cancel in any linear picture. The rest is rounding to the projector's
    pixels, 1 / sqrt(12) of a sixteenth of a pixel over 4 for 16 samples, and curvature.
    """
    rig = make_rig(centred(14, 40, 160), centred(256, 700, 2560), baseline_m=(5e-3, 0.0, 0.0))
    if soft:
        camera = blurred(rig.camera, 0.5, aperture_m=8e-3)
        rig = replace(rig, camera=camera, projector=blurred(rig.projector, 0.6, aperture_m=6e-3))
    error = ramp_error_px(mitsuba_renderer, rig, samples=16, seeds=4)
    bound = 1 / math.sqrt(12) / 16 / 4
    assert error.size > 800
    assert error.std() < 1.6 * bound  # unpaired R2 has 0.02 of a pixel, four times that
    assert abs(error.mean()) < 4 * bound / math.sqrt(error.size) + 4e-4


# Blur in scanner_sim, over the standard deviation D / 4 of the disc's line spread. Camera: twice
# the scale of a logistic fitted to an edge, whose deviation is pi / sqrt(3) scales. Projector: the
# width of a spot, represented by the line spread's full width at half maximum.
PER_DEVIATION = {"camera": 2 * math.sqrt(3) / math.pi, "projector": 2 * math.sqrt(3)}


def measured_curve(shared, device):
    """Return distance [m], blur [m on the plane, or pixels], and other values of the file in SI."""
    content = json.loads((shared / "data/rigs/scanner_sim" / f"{device}_focus.json").read_text())
    curve = next(value for key, value in content.items() if key.startswith("dof"))
    z_mm, blur = np.array(curve)
    order = np.argsort(z_mm)
    unit = 1e-3 if device == "projector" else 1.0
    best = next(value for key, value in content.items() if key.startswith("best_res"))
    figures = content["aperture, mm"] / 1e3, content["focus, mm"] / 1e3, best * unit
    return z_mm[order] / 1e3, blur[order] * unit, *figures


def simulated_over_measured(renderer, shared, device, z, blur, lens_of):
    """Return the ratio of the deviation of an edge's spread to the published blur, by distance."""
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
def test_the_blur_of_a_measured_camera_follows_its_curve_at_every_distance(
    mitsuba_renderer, shared
):
    """scanner_sim's camera (CC BY 4.0), with the aperture and focus of its file. The measure is the
    deviation of the edge's line spread. One factor is fitted, and is near the expected one.
    """
    z, blur, *lens = measured_curve(shared, "camera")
    pick = np.linspace(0, len(z) - 1, 9).astype(int)
    ratio = simulated_over_measured(mitsuba_renderer, shared, "camera", z[pick], blur[pick], lens)
    factor = 1 / np.exp(np.log(ratio).mean())
    assert factor == pytest.approx(PER_DEVIATION["camera"], rel=0.05)
    assert np.abs(factor * ratio - 1).max() < 0.05


@pytest.mark.slow
def test_the_blur_of_a_measured_projector_has_its_shape_at_every_distance(mitsuba_renderer, shared):
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


def test_the_renderer_and_the_optics_module_use_equal_blur_radii(mitsuba_renderer):
    """Other functions use `optics.blur_radius_px` for planning."""
    lens = blurred(centred(96, ROWS, 300.0), 0.5, psf_px=2.0)
    deviation, error = camera_spread(mitsuba_renderer, lens, 0.9, samples=256)
    assert isinstance(lens, Optics)
    assert abs(deviation - blur_radius_px(lens, np.array([0.9]))[0] / 2) < 5 * error
