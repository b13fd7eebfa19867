"""Certificates of small scanners: nearly perfect scanners, and one with a wrong calibration."""

import json
import math
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from metered import Metered
from stage import centred, make_rig, turned

from graycast.camera.exposure import ExposureSpec
from graycast.camera.faults import FaultSpec
from graycast.camera.scanner import Scanner
from graycast.camera.sensor import SensorSpec
from graycast.rig.pair import depth_per_line_m
from graycast.rig.pattern import CodeSpec
from graycast.score.metrology import Scope, certify, describe, write_certificate
from graycast.score.metrology.certify import _plane, _Pose
from graycast.score.metrology.lab import conditions, open_lab

LITTLE = Scope(distances=3, tilts_deg=(), spheres=1, bars=1, captures=4)
NOISELESS = SensorSpec(
    full_well_e=1e9, gain_dn_per_e=6e-5, read_noise_e=0.0, bit_depth=16, dark_current_e_s=0.0
)

# A fit distinguishes a cap's radius from its distance by the spread of the cosine of incidence.
# This is the standard deviation of a cosine that is uniform from cos 50 degrees to 1.
COSINE_SPREAD = (1 - math.cos(math.radians(50))) / math.sqrt(12)


def small_rig(*, baseline_m=0.2, finer=1):
    """Return a toed-in pair of pinholes with a working range from 0.5 to 0.9 m."""
    rig = make_rig(
        centred(160 * finer, 120 * finer, 190 * finer),
        centred(512, 384, 600),
        baseline_m=(baseline_m, 0.0, 0.0),
        rotation=turned(0.0, -0.3, 0.0),
    )
    return replace(rig, near_m=0.5, far_m=0.9)


def small_scanner(sensor=None, **words):
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=32.0, steps=4)
    return Scanner(rig=small_rig(), code=code, sensor=sensor or SensorSpec(), **words)


@pytest.fixture(scope="module")
def certificate(mitsuba_renderer):
    return certify(small_scanner(), renderer=mitsuba_renderer, seed=3, scope=LITTLE)


@pytest.mark.slow
def test_temporal_noise_is_the_standard_deviation_that_the_decoder_propagates(certificate):
    """Oracle: the scatter over shots, against the sensor's noise propagated through decoding and
    triangulation. Without filters, they share no code; 4 shots have a standard error of 3 %.
    """
    for plane in certificate.facing:
        assert abs(plane.noise_m / plane.sigma_m - 1) < 0.08
    near, _, far = certificate.facing
    assert far.noise_m / near.noise_m > 2  # Noise grows at least with the square of the distance.


@pytest.mark.slow
def test_point_spacing_is_depth_over_focal_length(mitsuba_renderer):
    """The spacing is computed from measured depth, so it has the noise of depth."""
    few = replace(LITTLE, captures=2)
    certificate = certify(small_scanner(), renderer=mitsuba_renderer, seed=3, scope=few)
    for plane in certificate.facing:
        assert abs(plane.spacing_m / (plane.z_m / 190.0) - 1) < 2e-3


@pytest.mark.slow
def test_a_certificate_is_written_as_json_and_as_a_self_contained_page(certificate, tmp_path):
    page = write_certificate(certificate, tmp_path / "new")
    record = json.loads((tmp_path / "new" / "certificate.json").read_text())
    assert record["summary"]["temporal_noise_m"] == certificate.middle.noise_m
    assert len(record["planes"]) == len(certificate.planes)
    assert record["planes"][-1]["noise_m"] is None  # A single shot has no scatter.
    tags = _Tags()
    tags.feed(page.read_text(encoding="utf-8"))
    assert not tags.open and "script" not in tags.names and "link" not in tags.names
    assert len(tags.sources) == 4
    assert all(source.startswith("data:image/png;base64,") for source in tags.sources)
    assert {path.name for path in page.parent.glob("*.png")} == {
        "noise.png", "shape.png", "focus.png", "volume.png"
    }  # fmt: skip
    assert "test" in page.read_text() and "mm" in describe(certificate)
    assert f"{1e3 * certificate.middle.exposures_s[0]:.3g} ms a frame" in page.read_text()


class _Tags(HTMLParser):
    """Collect element names and link targets, and check that elements close in order."""

    def __init__(self):
        super().__init__()
        self.open, self.names, self.sources = [], set(), []

    def handle_starttag(self, tag, attributes):
        self.names.add(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_an_impossible_scope_is_refused():
    with pytest.raises(ValueError, match="odd number"):
        Scope(distances=4)
    with pytest.raises(ValueError, match="at least 2"):
        Scope(captures=1)


@pytest.mark.slow
def test_progress_counts_every_scene(mitsuba_renderer):
    meter = Metered()
    scope = replace(LITTLE, captures=2)
    result = certify(
        small_scanner(),
        renderer=mitsuba_renderer,
        seed=0,
        scope=scope,
        progress=meter,
    )
    assert len(meter.stages) == result.scenes
    assert meter.counts == [("scenes", k, result.scenes) for k in range(result.scenes + 1)]


@pytest.mark.slow
def test_a_scanner_without_noise_has_nearly_zero_errors_in_its_certificate(mitsuba_renderer):
    """Only the projector's pixels limit the accuracy. Each of n paths of a camera pixel sees one
    column, up to half a column off, so their mean is off by 1 / sqrt(12 n) columns. Without
    filters, this is the deviation of every point; the slope of a sphere adds to it.
    """
    scanner = replace(small_scanner(NOISELESS), rig=small_rig(finer=2))
    scope = Scope(distances=3, tilts_deg=(30.0, 60.0), spheres=4, bars=7, captures=2)
    result = certify(scanner, renderer=mitsuba_renderer, seed=1, scope=scope)

    def step_m(z_m):
        return depth_per_line_m(scanner.rig, z_m, "column") / math.sqrt(12 * scope.samples)

    assert result.middle.noise_m < 0.1 * step_m(result.middle.z_m)
    for plane in result.facing:
        assert plane.std_m < 1.2 * step_m(plane.z_m)
        assert abs(plane.offset_m) < 0.1 * step_m(plane.z_m)
        assert plane.decoded_share > 0.995
    for one in result.probing:
        assert one.std_m < 1.5 * step_m(one.centre_m[2])
        assert abs(one.size_m) < 3 * 2 * one.std_m / (math.sqrt(one.points) * COSINE_SPREAD)
    for one in result.spacing:
        share = math.hypot(*(1 / math.sqrt(points) for points in one.points)) / COSINE_SPREAD
        assert min(one.points) > 100 and abs(one.error_m) < 3 * share * step_m(one.ends_m[1][2])


@pytest.mark.slow
def test_a_baseline_error_of_a_thousandth_scales_all_lengths_by_a_thousandth(mitsuba_renderer):
    """A point is where a camera ray meets a light plane, so it moves along its ray in proportion to
    the baseline: the measured world is a copy scaled about the camera. Seeds and pictures are
    equal.
    """
    truth = small_scanner()
    wrong = replace(truth, rig=small_rig(baseline_m=0.2 * 1.001))
    scope = replace(LITTLE, bars=7, spheres=3)
    right, scaled = (
        certify(one, renderer=mitsuba_renderer, seed=5, scope=scope, rendered_with=truth.rig)
        for one in (truth, wrong)
    )
    length_m = right.bar_length_m
    assert length_m == scaled.bar_length_m > 0.2
    for a, b in zip(right.spacing, scaled.spacing, strict=True):
        assert abs((b.error_m + length_m) / (a.error_m + length_m) - 1.001) < 2e-6
    for a, b in zip(right.probing, scaled.probing, strict=True):
        assert abs(b.form_m / a.form_m - 1.001) < 1e-3
        expected_m = 1.001 * (a.size_m + right.probing_diameter_m) - right.probing_diameter_m
        assert abs(b.size_m - expected_m) < 2e-6 * right.probing_diameter_m
    assert scaled.conditions["calibration_differs"]


@pytest.mark.slow
def test_the_error_of_a_shot_includes_systematic_errors(mitsuba_renderer):
    """Raster points that are off the pixels' centres shift the depth of a slope equally in every
    shot. Oracle: a plane z = z0 + tan(t) y rises by tan(t) z^2 / (z0 f) per pixel.
    """
    raster_px, tilt_deg, z_m = 0.2, 50.0, 0.7
    scanner = small_scanner(faults=FaultSpec(raster_px=raster_px))
    lab = open_lab(scanner, scanner.rig, LITTLE, mitsuba_renderer)
    pose = _Pose(name="steep", z_m=z_m, captures=8, tilt_deg=tilt_deg)
    steep, _ = _plane(lab, pose, seed=2)
    raster_m = raster_px * math.tan(math.radians(tilt_deg)) * z_m / 190.0
    assert math.sqrt(steep.error_m**2 - steep.noise_m**2) == pytest.approx(raster_m, rel=0.05)
    assert steep.error_m == pytest.approx(steep.sigma_m, rel=0.05)
    assert steep.noise_m < 0.5 * steep.sigma_m  # Sigma includes the error; this noise does not.


@pytest.mark.slow
def test_a_plane_states_all_exposures_of_its_pictures(mitsuba_renderer):
    one, two = (
        _exposed(mitsuba_renderer, ExposureSpec(target=0.2, factors=factors))
        for factors in ((1.0,), (1.0, 4.0))
    )
    assert two.exposures_s == pytest.approx([one.exposures_s[0], 4 * one.exposures_s[0]])


@pytest.mark.slow
def test_half_an_exposure_gives_half_the_brightness(mitsuba_renderer):
    """In an earlier version, a single factor was applied twice."""
    half, dim = (
        _exposed(mitsuba_renderer, exposure)
        for exposure in (ExposureSpec(target=0.4, factors=(0.5,)), ExposureSpec(target=0.2))
    )
    assert half.exposures_s == pytest.approx(dim.exposures_s)
    assert half.noise_m == pytest.approx(dim.noise_m, rel=1e-6)


@pytest.mark.slow
def test_automatic_exposures_are_stated_as_chosen(mitsuba_renderer):
    exposure = ExposureSpec(auto=True, factors=(1.0, 7.0))
    scanner = small_scanner(exposure=exposure)
    lab = open_lab(scanner, scanner.rig, LITTLE, mitsuba_renderer)
    assert conditions(lab, 0)["exposures"] == "automatic"
    fixed = replace(lab, scanner=replace(scanner, exposure=replace(exposure, auto=False)))
    assert conditions(fixed, 0)["exposures"] == [1.0, 7.0]
    # A plane of one colour has little contrast, so one exposure suffices.
    assert len(_exposed(mitsuba_renderer, exposure).exposures_s) == 1


def _exposed(renderer, exposure):
    scanner = small_scanner(exposure=exposure)
    lab = open_lab(scanner, scanner.rig, LITTLE, renderer)
    return _plane(lab, _Pose(name="facing", z_m=0.7, captures=2), seed=2)[0]
