"""Sigma of depth: each term alone follows its law, and their sum is the total.

The scene is one wall across the axis under parallel devices, so that dz/du is z^2 / (f b).
"""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stage import centred, in_camera, lambert, make_rig, wall

from graycast.camera.decode import CodeMap, Reason
from graycast.camera.faults import FaultSpec, with_faults
from graycast.camera.scanner import ExposureSpec, Scanner, measure, take
from graycast.camera.sensor import SensorSpec
from graycast.camera.sigma import TERMS, ripple_px, with_position_term
from graycast.camera.speckle import footprint_px, material_contrast, pixel_contrast
from graycast.rendering import PathNoise, Quality
from graycast.rendering.reference import ReferenceRenderer
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT

F_PX, BASELINE_M, WALL_M = 160.0, 0.1, 1.0
METRES_PER_PX = WALL_M**2 / (F_PX * BASELINE_M)
PERIOD_PX, STEPS, ALBEDO = 16.0, 4, 0.6
SPECKLE, LINES, PLACE_PX, STRAY, RASTER_PX = 0.3, 0.02, 0.03, 0.05, 0.2
INNER = np.s_[3:-3, 3:-3]


@pytest.fixture(scope="module")
def scanner():
    """Return a scanner in which nothing but the sensor is noisy."""
    return Scanner(
        rig=make_rig(centred(96, 72, F_PX), centred(192, 144, F_PX)),
        code=CodeSpec(codec="gray_phase", axes=("column",), period_px=PERIOD_PX, steps=STEPS),
        exposure=ExposureSpec(target=0.8),
        sensor=SensorSpec(),
    )


@pytest.fixture(scope="module")
def radiance(scanner):
    rendering = ReferenceRenderer().render(
        in_camera(scanner.rig, wall(WALL_M, lambert(ALBEDO))),
        EMPTY_LAYOUT,
        scanner.light_code().render(),
        quality=Quality(samples=1, depth=1),
        seed=0,
    )
    return rendering.radiance


@pytest.fixture(scope="module")
def capture(scanner, radiance):
    return take(scanner, radiance, seed=1)


def path_noise(capture):
    size = capture.frames.shape[1:]
    return PathNoise(
        place_sigma_px=np.full((2, *size), PLACE_PX, dtype=np.float32),
        stray=np.full((2, *size), STRAY, dtype=np.float32),
    )


def with_lines(scanner):
    return replace(scanner, rig=replace(scanner.rig, line_noise=LINES))


def with_speckle(scanner):
    return replace(scanner, rig=replace(scanner.rig, speckle_contrast=SPECKLE))


def variance_m2(scanner, capture, *, noise=None):
    """Return the variance [m^2] that a scanner states for each pixel inside the border."""
    depth = measure(scanner, capture, path_noise=noise)[1]
    return np.square(depth.sigma_m.astype(np.float64))[INNER]


def test_the_terms_of_sigma_s_variance_add_up_to_the_total(scanner, capture):
    """Law: variances of independent terms add. The pictures are the same in all five runs, so only
    the scanner's settings differ. The medians leave out the few pixels where noise looks like a
    bend, whose threshold depends on all other terms.
    """
    quiet = variance_m2(scanner, capture)
    noise = path_noise(capture)
    alone = [
        variance_m2(switched(scanner), capture) - quiet for switched in (with_lines, with_speckle)
    ]
    alone.append(variance_m2(scanner, capture, noise=noise) - quiet)
    assert all(np.median(term / quiet) > 0.1 for term in alone)
    whole = variance_m2(with_lines(with_speckle(scanner)), capture, noise=noise)
    np.testing.assert_allclose(np.median(whole / (quiet + sum(alone))), 1, rtol=1e-3)


def test_the_variance_from_line_noise_follows_its_law(scanner, capture):
    own = variance_m2(with_lines(scanner), capture) - variance_m2(scanner, capture)
    expected_px = PERIOD_PX / (2 * np.pi) * LINES * np.sqrt(5 / (2 * STEPS))
    np.testing.assert_allclose(np.sqrt(np.median(own)), expected_px * METRES_PER_PX, rtol=2e-3)


def test_the_variance_from_light_paths_follows_its_law(scanner, capture):
    noise = path_noise(capture)
    own = variance_m2(scanner, capture, noise=noise) - variance_m2(scanner, capture)
    expected_px = np.hypot(PLACE_PX, STRAY / np.sqrt(2) * PERIOD_PX / (2 * np.pi))
    np.testing.assert_allclose(np.sqrt(np.median(own)), expected_px * METRES_PER_PX, rtol=2e-3)


def test_the_variance_from_speckle_follows_its_law(scanner, capture):
    """On a facing wall, a pixel's light moves the position by its distance from the centre."""
    own = variance_m2(with_speckle(scanner), capture) - variance_m2(scanner, capture)
    black = SPECKLE * pixel_contrast(scanner.sensor) * footprint_px(scanner.sensor)
    volume = scanner.rig.speckle_volume
    low, high = (
        black * float(material_contrast(np.full(1, R), volume)[0]) for R in (ALBEDO, 0.8 * ALBEDO)
    )
    middle_m = np.sqrt(np.median(own))  # the light falls off towards the borders of the wall
    assert 0.98 * low * METRES_PER_PX < middle_m < 1.02 * high * METRES_PER_PX


def test_the_variance_from_the_raster_follows_its_law(scanner, capture):
    """Law: the point is j off the pixel's centre, so the error is j times the slope of depth."""
    plain = measure(scanner, capture, path_noise=None)[1]
    depth = plain.depth_m.astype(np.float64)
    slope = np.hypot(
        0.5 * (np.roll(depth, -1, 1) - np.roll(depth, 1, 1)),
        0.5 * (np.roll(depth, -1, 0) - np.roll(depth, 1, 0)),
    )
    # The jagged depth has bends, so the raster is evaluated before the term `bend` is added.
    jagged = with_faults(plain, FaultSpec(raster_px=RASTER_PX), seed=0)
    own = jagged.sigma_m.astype(np.float64) ** 2 - plain.sigma_m.astype(np.float64) ** 2
    np.testing.assert_allclose(
        np.sqrt(np.maximum(own, 0))[INNER], (RASTER_PX * slope)[INNER], rtol=0.02, atol=2e-7
    )


def test_the_stated_sigma_agrees_with_the_scatter_of_captures(scanner, radiance):
    """The sensor's term: several captures of one light scatter by the sigma of each."""
    scans = [
        measure(scanner, take(scanner, radiance, seed=seed), path_noise=None)[1]
        for seed in range(8)
    ]
    scatter = np.stack([scan.depth_m[INNER] for scan in scans]).var(axis=0, ddof=1).mean()
    stated = np.median(np.stack([scan.sigma_m[INNER] for scan in scans]))
    assert np.sqrt(scatter) / stated == pytest.approx(1, abs=0.05)


# --- ripple ------------------------------------------------------------------------------------


def phases_of(gamma, *, steps, rng, noise=0.0):
    """Return positions from steps of a cosine; the display's light is a power of the grey level.

    The pictures show a plane with 234.4 periods; the part of a period matters by 1 / 234.
    """
    place = np.linspace(3.0, 3.0 + 234.4 * PERIOD_PX, 40_000)
    shift = 2 * np.pi * np.arange(steps)[:, None] / steps
    level = 0.5 + 0.5 * np.cos(2 * np.pi * place / PERIOD_PX - shift)
    light = level**gamma + noise * rng.standard_normal(level.shape)
    phase = np.arctan2((light * np.sin(shift)).sum(0), (light * np.cos(shift)).sum(0))
    off = np.mod(phase * PERIOD_PX / (2 * np.pi) - place + PERIOD_PX / 2, PERIOD_PX) - PERIOD_PX / 2
    return place + off, off


def codes_of(column):
    column = column.astype(np.float32).reshape(200, -1)
    nothing = np.full(column.shape, np.nan, dtype=np.float32)
    return CodeMap(
        column=column,
        row=nothing,
        sigma_column=np.full(column.shape, 1e-3, dtype=np.float32),
        sigma_row=nothing.copy(),
        modulation=np.full(column.shape, 0.5, dtype=np.float32),
        reason=np.full(column.shape, int(Reason.DECODED), dtype=np.uint8),
    )


@pytest.mark.parametrize(("gamma", "steps"), [(1.5, 3), (2.2, 3), (2.2, 4)])
def test_a_nonlinear_display_adds_its_phase_error_to_sigma(gamma, steps):
    """Oracle: the true positions of the plane. A gamma of 2.2 is off by 0.3 rad in 3 steps."""
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=PERIOD_PX, steps=steps).code(
        512, 8
    )
    column, off = phases_of(gamma, steps=steps, rng=np.random.default_rng(1))
    stated = ripple_px(codes_of(column), code)
    assert list(stated) == ["column"]
    assert stated["column"] == pytest.approx(off.std(), rel=0.1)
    widened = with_position_term(codes_of(column), stated)
    assert 0.9 < np.sqrt(np.mean((off / widened.sigma_column.ravel()) ** 2)) < 1.1


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_linear_display_causes_no_phase_ripple(noise):
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=PERIOD_PX, steps=3).code(
        4096, 8
    )
    column, _ = phases_of(1.0, steps=3, rng=np.random.default_rng(2), noise=noise)
    assert ripple_px(codes_of(column), code) == {"column": 0.0}


def test_a_code_with_two_periods_has_no_separate_term_for_phase_ripple():
    code = CodeSpec(
        codec="gray_phase", axes=("column",), period_px=48.0, fine_period_px=PERIOD_PX
    ).code(4096, 8)
    column, _ = phases_of(2.2, steps=4, rng=np.random.default_rng(3))
    assert ripple_px(codes_of(column), code) == {}


# --- the list ----------------------------------------------------------------------------------


def test_each_term_of_sigma_names_an_existing_function():
    for term in TERMS:
        for source in term.source.split(", "):
            module, name = f"graycast.camera.{source}".rsplit(".", 1)
            assert callable(getattr(importlib.import_module(module), name)), term.name


def test_the_page_on_depth_has_a_row_for_each_term_of_sigma():
    page = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "depth.md"
    rows = [line.split("|")[1].strip() for line in page.read_text().splitlines() if "|" in line]
    assert [row for row in rows if row in {term.name for term in TERMS}] == [
        term.name for term in TERMS
    ]
