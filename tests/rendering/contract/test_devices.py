"""Properties of camera and projector besides geometry: falloff, response, pixels, wavelength."""

import math
from dataclasses import replace

import numpy as np
import pytest
from backends import direct_light
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter
from stage import (
    askew_rig,
    centre_rays,
    centred,
    in_camera,
    lambert,
    make_rig,
    optics,
    plain_pattern,
    wall,
)

from graycast.base.frames import inverse, transform_points
from graycast.rendering import Quality
from graycast.rig.optics import project
from graycast.world.scene import EMPTY_LAYOUT


def light_of(renderer, rig, pattern, *, material=None, quality=None):
    scene = in_camera(rig, wall(0.8, lambert(0.6) if material is None else material))
    return renderer.render(
        scene, EMPTY_LAYOUT, pattern, quality=quality or direct_light(renderer), seed=3
    ).radiance


def changed(rig, device, **words):
    return replace(rig, **{device: replace(getattr(rig, device), **words)})


def assert_same_light(renderer, one, other, *, rounding):
    """Check equal light up to rounding if a renderer's pictures share their samples in the pixel.

    Cycles draws new samples for each picture. On a smooth surface, the mean of 64 evenly spread
    samples is within a twentieth of a pixel of the pixel's centre, in both pictures. Elsewhere, the
    mean of n samples has a standard deviation of at most the range over 2 sqrt(n) (Popoviciu).
    """
    if renderer.name != "cycles":
        assert np.abs(one - other).max() < rounding
        return
    span = maximum_filter(other, 3) - minimum_filter(other, 3)
    smooth = span < 0.15 * other
    assert smooth.mean() > 0.3
    error = np.abs(one - other)
    assert (error <= 1e-4 * other + 0.05 * span)[smooth].all()
    assert (error <= 1e-4 * other + 4 * math.sqrt(2) * span / 2 / math.sqrt(64)).all()
    assert abs(one.sum() / other.sum() - 1) < 1e-3


def plain_and_dimmed(renderer, device, **words):
    """Return a wall's light without and with a device's settings, its points in the device's frame,
    and the lit pixels with lit neighbours.
    """
    rig = askew_rig(camera=optics(96, 72, 70))
    pattern = plain_pattern(rig, 255)
    plain = light_of(renderer, rig, pattern)
    dimmed = light_of(renderer, changed(rig, device, **words), pattern)
    point = 0.8 * centre_rays(rig.camera)
    if device == "projector":
        point = transform_points(inverse(rig.T_cam_proj), point)
    lit = (plain.white > 0) & np.roll(plain.white > 0, (1, 1), (0, 1))
    lit &= np.roll(plain.white > 0, (-1, -1), (0, 1))
    assert lit.sum() > 2500
    return plain, dimmed, getattr(rig, device), point, lit


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_light_falls_with_cos_to_the_fourth_in_a_camera_and_cos_in_a_projector(renderer, device):
    """Oracle: the ratio of pictures with and without falloff; angles by the dot product."""
    plain, dimmed, _, point, lit = plain_and_dimmed(renderer, device, natural_vignetting=True)
    cosine = np.cos(np.arccos(point[..., 2] / np.linalg.norm(point, axis=-1)))
    expected = cosine ** {"camera": 4, "projector": 1}[device]
    assert expected[lit].min() < (0.85 if device == "camera" else 0.95)
    for one, other in (
        (dimmed.white, plain.white),
        (dimmed.pattern[0], plain.pattern[0]),
        (dimmed.white_rgb[..., 1], plain.white_rgb[..., 1]),
    ):
        assert np.abs(one[lit] / other[lit] / expected[lit] - 1).max() < 1e-3
    assert np.abs(dimmed.albedo - plain.albedo).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("device", ["camera", "projector"])
def test_light_falls_with_the_square_of_the_distance_from_the_picture_s_centre(renderer, device):
    """Oracle: the ratio of pictures with and without falloff, which is a half in the corners."""
    plain, dimmed, own, point, lit = plain_and_dimmed(renderer, device, falloff=0.5)
    x, y = np.moveaxis(project(own, point), -1, 0)
    x, y = (2 * x + 1) / own.width_px - 1, (2 * y + 1) / own.height_px - 1
    expected = 1 - 0.25 * (x**2 + y**2)
    assert expected[lit].min() < 0.7
    for one, other in ((dimmed.white, plain.white), (dimmed.pattern[0], plain.pattern[0])):
        assert np.abs(one[lit] / other[lit] / expected[lit] - 1).max() < 2e-3


@pytest.mark.parametrize("levels", [(0, 255), (0, 51, 64, 128, 200, 255)])
def test_projected_grey_levels_follow_the_response_curve(renderer, levels):
    """Computed by hand, between the knots (0, 0), (127.5, 0.2) and (255, 1) of the response."""
    by_hand = {0: 0.0, 51: 0.08, 64: 0.2 * 64 / 127.5, 128: 0.2 + 0.8 * 0.5 / 127.5}
    by_hand |= {200: 0.2 + 0.8 * 72.5 / 127.5, 255: 1.0}
    rig = askew_rig(response=(0.0, 0.2, 1.0))
    light = light_of(renderer, rig, plain_pattern(rig, *levels))
    rounding = 2e-5 * light.white.max()
    for image, level in zip(light.pattern, levels, strict=True):
        if level == 0:
            assert not image.any()
        else:
            assert_same_light(renderer, image, by_hand[level] * light.white, rounding=rounding)


def test_the_white_frame_equals_a_white_pattern_and_the_sum_of_its_bands(renderer):
    rig = askew_rig(band_weights=(0.5, 0.3, 0.2))
    material = lambert(0.8, 0.5, 0.2)
    light = light_of(renderer, rig, plain_pattern(rig, 255), material=material)
    assert light.white.max() > 1
    rounding = 1e-5 * light.white.max()
    assert_same_light(renderer, light.pattern[0], light.white, rounding=rounding)
    assert np.abs(light.white - light.white_rgb.sum(axis=-1)).max() < 1e-5 * light.white.max()


@pytest.mark.slow
@pytest.mark.parametrize("fill_factor", [0.25, 0.7])
def test_gaps_between_projector_pixels_reduce_light_by_their_area(renderer, fill_factor):
    """A camera with 12 pixels per projector pixel sees each square and the gap around it."""
    rig = make_rig(centred(120, 60, 240), centred(40, 40, 20), baseline_m=(1e-4, 0.0, 0.0))
    pattern = plain_pattern(rig, 255)
    full = light_of(renderer, rig, pattern)
    light = light_of(renderer, changed(rig, "projector", fill_factor=fill_factor), pattern)
    if renderer.name != "cycles":
        assert np.abs(light.pattern[0] - light.white).max() < 1e-5 * light.white.max()
    share = light.white / full.white
    assert share.mean() == pytest.approx(fill_factor, abs=0.01)  # 96 positions along a pixel
    x, y = (np.arange(120) - 59.5) / 12 + 19.5, (np.arange(60) - 29.5) / 12 + 19.5
    aside = [np.abs(place - np.rint(place)) for place in (x, y)]
    farthest = np.maximum(aside[0][None], aside[1][:, None])  # from the pixel's centre
    half = math.sqrt(fill_factor) / 2
    slack = 0.5 / 12 + 3e-3  # half a camera pixel, and the parallax of the baseline
    assert np.abs(share[farthest < half - slack] - 1).max() < 1e-3
    assert not share[farthest > half + slack].any()


@pytest.mark.parametrize(("side", "covered"), [(0.0, 0.5), (0.2, 0.9), (0.3, 1.0), (-0.3, 0.0)])
def test_a_camera_pixel_receives_light_only_in_its_sensitive_square(renderer, side, covered):
    """With a fill of 1/4 it is half a pixel wide. A lit half plane ends at `side` of a pixel."""
    camera = replace(centred(41, 9, 200), fill_factor=0.25)
    rig = make_rig(camera, centred(64, 64, 40), baseline_m=(1e-4, 0.0, 0.0))
    edge_m = (20 + side - 20) / 200 * 0.8
    lit = wall(0.8, lambert(0.6))
    half = replace(lit, center_m=(edge_m - 5.0, 0.0, 0.8))
    quality = Quality(samples=100, depth=1)
    white = [
        renderer.render(
            in_camera(rig, surface), EMPTY_LAYOUT, plain_pattern(rig, 255), quality=quality, seed=0
        ).radiance.white
        for surface in (half, lit)
    ]
    share = (white[0] / white[1])[:, 20]
    assert np.abs(share - covered).max() < 0.06  # a column of 10 positions
    assert abs(share.mean() - covered) < 0.02


@pytest.mark.slow
def test_the_measuring_camera_records_reflectance_at_the_projector_s_wavelength(renderer):
    """The colour picture shows the surface's colour; both pictures are relative to a grey wall."""
    rig = askew_rig(band_weights=(1.0, 0.0, 0.0))
    pattern = plain_pattern(rig, 255, 100)
    red = replace(lambert(0.9, 0.1, 0.1), projector_reflectance=0.25)
    grey, light = (
        light_of(renderer, rig, pattern, material=material) for material in (lambert(0.5), red)
    )
    lit = grey.white > 0
    assert np.abs(light.white[lit] / grey.white[lit] - 0.25 / 0.5).max() < 1e-4
    assert np.abs(light.pattern[1][lit] / grey.pattern[1][lit] - 0.25 / 0.5).max() < 1e-4
    if renderer.name == "cycles":
        assert_same_light(renderer, light.white_rgb[..., 0], 0.9 / 0.5 * grey.white, rounding=0)
        assert not light.white_rgb[..., 1:].any()
    else:
        colour = light.white_rgb[lit] / grey.white[lit][:, None]
        assert np.abs(colour - [0.9 / 0.5, 0.0, 0.0]).max() < 1e-4
    assert np.abs(light.albedo - [0.9, 0.1, 0.1]).max() < 1e-5


@pytest.mark.slow
def test_a_surface_without_a_projector_reflectance_keeps_its_own_colour(renderer):
    rig = askew_rig(band_weights=(1.0, 0.0, 0.0))
    pattern = plain_pattern(rig, 255)
    patch = wall(0.7, replace(lambert(0.9), projector_reflectance=0.3), half_m=0.06)
    back = wall(0.8, lambert(0.6, 0.2, 0.2))
    both = in_camera(rig, back, patch)
    alone = in_camera(rig, back, replace(patch, material=lambert(0.9)))
    one, other = (
        renderer.render(s, EMPTY_LAYOUT, pattern, quality=direct_light(renderer), seed=0)
        for s in (both, alone)
    )
    inside = binary_erosion(np.nan_to_num(other.truth.depth_m) > 0.75, np.ones((3, 3)))
    assert inside.sum() > 3000
    assert np.array_equal(one.radiance.white[inside], other.radiance.white[inside])
    assert one.radiance.white[36, 48] == pytest.approx(other.radiance.white[36, 48] / 3, rel=1e-4)
