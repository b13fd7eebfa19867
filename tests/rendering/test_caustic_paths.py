"""Paths from the projector only, on 32 x 32 pixels: a mirror's patch of light on a wall.

The camera's paths are not traced, so the kernel of Mitsuba compiles in about a second.
"""

import inspect
import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import convolve, uniform_filter
from scipy.special import j1
from stage import centred, in_camera, lambert, make_rig, wall

from graycast.base.frames import transform_points
from graycast.rendering import Quality
from graycast.rig.optics import project
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Quad

SIZE, ALBEDO, SUB, SAMPLES, MOST_SAMPLES = 32, 0.5, 8, 256, 65536
MIRROR_X, NEAR, FAR, HALF_Y = 0.3, 0.5, 0.9, 0.06
CAMERA_PSF, PROJECTOR_PSF, PERIOD, FOCAL = 1.6, 3.0, 12.0, 140.0
# The patch of light is at x = 0.1 to 0.28 on the wall at z = 1, in the picture's middle.
RIG = make_rig(
    replace(centred(SIZE, SIZE, FOCAL), cx_px=0.5 * (SIZE - 1) - 0.19 * FOCAL, psf_px=CAMERA_PSF),
    replace(centred(64, 64, 200), cx_px=31.5 - 0.311 * 200, psf_px=PROJECTOR_PSF),
    baseline_m=(0.1, 0.0, 0.0),
)


def stripes():
    """Return a wave over the columns, and columns that are alternately dark and bright."""
    column = np.arange(RIG.projector.width_px)
    wave = np.rint(127.5 * (1 + np.cos(2 * np.pi * column / PERIOD)))
    lines = np.stack([wave, 255 * (column % 2)]).astype(np.uint8)
    return np.repeat(lines[:, None, :], RIG.projector.height_px, axis=1)


@dataclass(frozen=True)
class Traced:
    """Sums over all samples that the paths from the projector add to each pixel."""

    white: np.ndarray
    wave: np.ndarray
    stray2: np.ndarray


@pytest.fixture(scope="module")
def open_tracer(mitsuba_renderer):
    from graycast.rendering.mitsuba.caustics import CausticTracer
    from graycast.rendering.mitsuba.projector import ShinyField
    from graycast.rendering.mitsuba.scene import build
    from graycast.rendering.mitsuba.stage import Stage

    mirror = Quad(
        center_m=(MIRROR_X, 0.0, (NEAR + FAR) / 2),
        half_u_m=(0.0, 0.0, (FAR - NEAR) / 2),
        half_v_m=(0.0, HALF_Y, 0.0),
        material=Material(base_color=(1.0,) * 3, metallic=1.0, roughness=0.01),
    )
    scene = in_camera(RIG, wall(1.0, lambert(ALBEDO), half_m=2.0), mirror)
    world = build(scene, EMPTY_LAYOUT)

    def opened(samples):
        stage = Stage(world, scene, stripes(), Quality(samples=samples, depth=2))
        field = ShinyField(stage.world, stage.light, world.shiny, stage.pixels)
        return CausticTracer(stage, field)

    return opened


def traced(tracer, seed):
    light = tracer.trace(seed)
    arrays = dr.sum(light.white), light.pattern[0], light.stray2["column"]
    return Traced(*(array.numpy().reshape(SIZE, SIZE) for array in arrays))


def in_the_camera_s_picture(values):
    """Return the picture of values on SUB x SUB points per pixel, blurred by the psf's disc."""
    r = CAMERA_PSF * SUB
    at = np.arange(-math.ceil(r), math.ceil(r) + 1)
    disc = (at[:, None] ** 2 + at**2 <= r * r).astype(float)
    blurred = convolve(values, disc / disc.sum(), mode="nearest")
    return blurred.reshape(SIZE, SUB, SIZE, SUB).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def expected():
    """Return white light and the wave's share of it in closed form, from the mirror image.

    A disc of radius r reduces a wave of period p to 2 J1(x) / x of its height, with x = 2 pi r / p
    (the Fourier transform of a disc).
    """
    at = (np.arange(SIZE * SUB) + 0.5) / SUB - 0.5
    x = (at[None, :] - RIG.camera.cx_px) / RIG.camera.fx_px
    y = (at[:, None] - RIG.camera.cy_px) / RIG.camera.fy_px
    point = np.stack(np.broadcast_arrays(x, y, 1.0), axis=-1)
    image = RIG.T_cam_proj[:3, 3] * [-1, 1, 1] + [2 * MIRROR_X, 0, 0]
    met = image + (point - image) * ((MIRROR_X - image[0]) / (point - image)[..., :1])
    lit = (np.abs(met[..., 1]) < HALF_Y) & (met[..., 2] > NEAR) & (met[..., 2] < FAR)
    white = lit * ALBEDO / np.pi * RIG.intensity_w_sr / np.linalg.norm(point - image, axis=-1) ** 3
    back = point * [-1, 1, 1] + [2 * MIRROR_X, 0, 0]  # the projector sees the wall there
    column = project(RIG.projector, transform_points(np.linalg.inv(RIG.T_cam_proj), back))[..., 0]
    turn = 2 * np.pi * PROJECTOR_PSF / PERIOD
    height = 2 * j1(turn) / turn
    # A pixel is as wide as 1 column, so a wave is also reduced by its sinc.
    height *= np.sinc(1 / PERIOD)
    wave = white * height * np.cos(2 * np.pi * column / PERIOD) / 2
    return in_the_camera_s_picture(white), in_the_camera_s_picture(wave)


@pytest.fixture(scope="module")
def runs(open_tracer):
    return [traced(open_tracer(SAMPLES), seed) for seed in range(12)]


def agreement(pictures, picture, template):
    """Return the ratio of a template's share in the pictures to the expected one, and its error."""
    each = np.array([(one * template).sum() for one in pictures]) / (picture * template).sum()
    return each.mean(), each.std(ddof=1) / np.sqrt(len(each))


def test_light_reflected_by_a_mirror_has_the_expected_radiance_and_blur(runs, expected):
    """The borders of the patch remain when a mean over 5 x 5 pixels is subtracted."""
    white, _ = expected
    pictures = [run.white / SAMPLES for run in runs]
    brightness, _ = agreement(pictures, white, white)
    assert abs(brightness - 1) < 0.005
    sharpness, error = agreement(pictures, white, white - uniform_filter(white, 5))
    assert error < 0.01
    assert abs(sharpness - 1) < 4 * error


def test_stripes_reflected_by_a_mirror_have_the_blur_of_the_projector(runs, expected):
    _, wave = expected
    contrast, error = agreement([run.wave - run.white / 2 for run in runs], wave, wave)
    contrast, error = contrast / SAMPLES, error / SAMPLES
    assert error < 0.01
    assert abs(contrast - 1) < 4 * error


def test_the_variance_of_a_single_path_is_the_square_of_its_light(open_tracer):
    """Lines that are alternately bright and dark differ from their mean by the path's whole light.
    The variance is at most the square of the sum, and equal to it if a pixel has one path.
    """
    run = traced(open_tracer(1), seed=3)
    lit = run.white > 0
    ratio = run.stray2[lit] / np.square(run.white[lit])
    assert lit.sum() > 50
    assert ratio.max() < 1.0001
    assert (ratio > 0.9999).mean() > 0.4


def test_paths_are_evenly_spaced_even_beyond_two_to_the_32(open_tracer):
    """Oracle: Python's own integers, which have no limit."""
    from graycast.rendering.mitsuba.projector import CELL_PX, R2_STEPS

    field, total, lanes, start = open_tracer(1).field, 2**34 + 5, 16, (11, 13)
    cells = field._cells.numpy().tolist()
    assert len(cells) == field.count > 4
    for first in (0, 2**32 - 8, 2**33 + 7, total - lanes):
        index = dr.arange(mi.UInt64, lanes) + dr.opaque(mi.UInt64, first)
        place = field.places(index, total, mi.Point2u(*start)).numpy()
        for k in range(lanes):
            row, column = divmod(cells[(first + k) * field.count // total], field.columns)
            inside = [
                ((first + k) * step + at) % 2**32 / 2**32
                for step, at in zip(R2_STEPS, start, strict=True)
            ]
            must = (np.array([column - 1, row - 1]) + inside) * CELL_PX - 0.5
            np.testing.assert_allclose(place[:, k], must, atol=1e-3)


def test_a_picture_with_more_than_two_to_the_32_paths_is_rendered(
    open_tracer, expected, monkeypatch
):
    """A full picture with thousands of samples has that many paths, which caused an error.

    Of 2^34 paths, the first thousand of each of the projector's cells are traced: they are as
    bright as all of them.
    """
    tracer = open_tracer(SAMPLES)
    tracer.total = 2**34
    count, lanes = tracer.field.count, 1000
    each = [(-(-k * tracer.total // count), lanes) for k in range(count)]
    monkeypatch.setattr("graycast.rendering.mitsuba.caustics.blocks", lambda total: each)
    light = traced(tracer, seed=2).white.sum() * tracer.field.paths / (count * lanes)
    assert light == pytest.approx(expected[0].sum(), rel=0.02)


@pytest.mark.parametrize("samples", [1, 256, 257, MOST_SAMPLES])
def test_a_sum_of_the_brightest_samples_does_not_overflow(open_tracer, samples):
    """A sum of 2^64 would start again at 0."""
    from graycast.rendering.mitsuba.caustics import BRIGHTEST

    tracer = open_tracer(samples)
    lanes = SimpleNamespace(pixel=dr.zeros(mi.UInt32, samples))
    every = dr.full(mi.Bool, True, samples)
    add = inspect.unwrap(type(tracer)._add)  # each lane counts as whole paths
    add(tracer, lanes, dr.zeros(mi.UInt32, samples), mi.Color3f(1e30), every)
    most = samples * BRIGHTEST * RIG.intensity_w_sr / np.pi
    sums = tracer._result()
    for light in (*sums.white, sums.pattern[0]):
        assert light.numpy()[0] == pytest.approx(most, rel=1e-6)
