"""Speckle from light to depth: exposures share it, sigma includes it, depth follows the law."""

from dataclasses import replace

import numpy as np
import pytest
from stage import in_camera, lambert, leaning_wall

from graycast.camera import scanner as scanner_module
from graycast.camera.faults import FaultSpec
from graycast.camera.scanner import ExposureSpec, Scanner, preset, scan, take
from graycast.camera.speckle import material_contrast
from graycast.rendering import Quality, Radiance
from graycast.rendering.reference import ReferenceRenderer
from graycast.rig.optics import Optics
from graycast.world.scene import EMPTY_LAYOUT

WALL_M = 0.75


@pytest.fixture(scope="module")
def scanner():
    """Return a window of the PhoXi M at its lowest resolution, sharp as the renderer is."""
    whole = preset("like-phoxi-m", "small")
    camera = replace(_sharp(whole.rig.camera), width_px=90, height_px=70, cx_px=44.5, cy_px=34.5)
    rig = replace(whole.rig, camera=camera, projector=_sharp(whole.rig.projector), line_noise=0.0)
    code = replace(whole.code, axes=("column",), period_px=16.0, fine_period_px=None)
    return Scanner(rig=rig, code=code, sensor=whole.sensor, exposure=ExposureSpec(target=0.5))


def _sharp(lens: Optics) -> Optics:
    return replace(lens, aperture_m=0.0, psf_px=0.0)


@pytest.fixture(scope="module")
def light(scanner):
    """Return a function from reflectance to exact light and depth of an inclined wall."""

    def rendered(reflectance: float):
        wall = leaning_wall((0.25, 0.15, 1.0), WALL_M, lambert(reflectance), half_m=0.6)
        return ReferenceRenderer().render(
            in_camera(scanner.rig, wall),
            EMPTY_LAYOUT,
            scanner.light_code().render(),
            quality=Quality(samples=16, depth=1),
            seed=0,
        )

    return {reflectance: rendered(reflectance) for reflectance in (0.03, 0.7)}


def errors(scanner, rendering, *, seeds=(1, 2, 3)):
    """Return depth errors [m] and stated sigma of several captures, away from the border."""
    shots = [scan(scanner, rendering.radiance, seed=seed).depth for seed in seeds]
    inner = np.s_[2:-2, 2:-2]
    error_m = np.stack([(shot.depth_m - rendering.truth.depth_m)[inner] for shot in shots])
    return error_m, np.stack([shot.sigma_m[inner] for shot in shots])


@pytest.mark.parametrize("reflectance", [0.03, 0.7])
def test_speckle_errors_on_black_and_white_surfaces_agree_with_sigma(scanner, light, reflectance):
    """Speckle is most of the noise on black, photons are on white. The staircase of the sharp
    projector's pixels is common to all captures; it bends the surface and is in sigma too.
    """
    error_m, sigma_m = errors(scanner, light[reflectance], seeds=range(8))
    stated_m = np.sqrt(np.nanmean(sigma_m**2))
    assert 0.9 < np.sqrt(np.nanmean(error_m**2)) / stated_m < 1.1


@pytest.mark.slow
def test_an_uneven_finish_gives_noise_longer_tails_and_no_more_power(scanner, light, monkeypatch):
    """Noise of log-normal amplitude has the kurtosis `3 exp(4 u^2)` and unchanged power, which
    sigma states; the noise of photons is even.
    """
    n, u = 8, 0.3
    monkeypatch.setattr(scanner_module, "PATCH_M", 0.002)  # With many patches, the law is exact.
    # In a deep well, photons make little noise.
    deep = replace(scanner.sensor, full_well_e=1e6, gain_dn_per_e=0.06, bit_depth=16)
    weak = {"speckle_contrast": 0.25}  # weak, so that a dark pixel is not moved farther
    power_m2, kurtosis = {}, {}
    for name, changed in (
        ("lamp", {"speckle_contrast": 0.0}),
        ("even", weak),
        ("uneven", weak | {"speckle_unevenness": u}),
    ):
        own = replace(scanner, sensor=deep, rig=replace(scanner.rig, **changed))
        error_m, _ = errors(own, light[0.03], seeds=range(n))
        noise_m = error_m - np.nanmean(error_m, axis=0)  # the staircase is not noise
        power_m2[name] = np.nanmean(noise_m**2)
        kurtosis[name] = np.nanmean(noise_m**4) / np.nanmean(noise_m**2) ** 2
    share = 1 - power_m2["lamp"] / power_m2["even"]
    remainder = ((n - 1) ** 3 + 1) / (n**2 * (n - 1))  # fourth cumulant, less the mean of n
    assert share > 0.8
    assert power_m2["uneven"] / power_m2["even"] == pytest.approx(1, abs=0.03)
    more = (kurtosis["uneven"] - kurtosis["even"]) / remainder
    assert more == pytest.approx(3 * share**2 * (np.exp(4 * u**2) - 1), rel=0.15)


def test_black_is_noisier_than_white_only_because_of_speckle(scanner, light):
    """Without speckle, an exposure that suits either gives both the same noise."""
    laser = {r: np.nanstd(errors(scanner, light[r])[0]) for r in light}
    lamp = replace(scanner, rig=replace(scanner.rig, speckle_contrast=0.0))
    led = {r: np.nanstd(errors(lamp, light[r])[0]) for r in light}
    assert led[0.03] == pytest.approx(led[0.7], rel=0.05)
    speckle = {r: np.sqrt(laser[r] ** 2 - led[r] ** 2) for r in light}
    # `speckle.material_contrast` gives sqrt(1 + 5 * 1.4 / 0.51) / sqrt(1 + 5 * 0.06) = 3.37.
    assert speckle[0.03] / speckle[0.7] == pytest.approx(3.37, rel=0.15)


def test_speckle_uncertainty_of_depth_follows_the_law_of_dorsch_et_al(scanner, light):
    """Law: delta z = C lambda / (2 pi sin u sin theta) for pixels of any size, where u is half the
    aperture's angle and theta the angle between the two rays. Pixels here are five speckles wide,
    so the tolerance is a quarter.
    """
    lamp = replace(scanner, rig=replace(scanner.rig, speckle_contrast=0.0))
    laser_m, lamp_m = (np.nanstd(errors(s, light[0.03])[0]) for s in (scanner, lamp))
    rig, sensor = scanner.rig, scanner.sensor
    aperture_m = rig.camera.fx_px * sensor.pixel_pitch_m / sensor.f_number
    sin_u = 0.5 * aperture_m / WALL_M
    to_projector = rig.T_cam_proj[:3, 3] - np.array([0, 0, WALL_M])
    cosine = -to_projector[2] / np.linalg.norm(to_projector)
    contrast = rig.speckle_contrast / np.sqrt(1 + rig.speckle_volume * 0.06)
    law_m = contrast * sensor.wavelength_m / (2 * np.pi * sin_u * np.sqrt(1 - cosine**2))
    assert np.sqrt(laser_m**2 - lamp_m**2) == pytest.approx(law_m, rel=0.25)


def test_all_frames_of_a_capture_share_one_speckle_pattern_and_captures_differ(
    scanner, light, monkeypatch
):
    taken = []
    monkeypatch.setattr(scanner_module, "merge_exposures", lambda one: taken.extend(one) or one[0])
    twice = replace(scanner, exposure=ExposureSpec(target=0.5, factors=(1.0, 0.5)))
    for seed in (1, 2):
        take(twice, light[0.03].radiance, seed=seed)
    white = scanner.light_code().brightest
    clean = light[0.03].radiance.white
    first, same, other = (
        (shot.frames[white] - 64.0)[2:-2, 2:-2] / clean[2:-2, 2:-2] for shot in taken[:3]
    )
    assert np.corrcoef(first.ravel(), same.ravel())[0, 1] > 0.85
    assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.06


def test_ambient_light_causes_no_speckle(scanner, light):
    """All light is ambient and strong: only the noise of photons is left."""
    radiance = light[0.03].radiance
    dark = {name: getattr(radiance, name) for name in radiance.__dataclass_fields__}
    lit = Radiance(**dark | {"pattern": radiance.pattern * 0, "ambient": radiance.white * 0 + 1e3})
    white = take(scanner, lit, seed=1).frames[scanner.light_code().brightest]
    noise_dn = np.sqrt(scanner.sensor.variance_dn2(float(white.mean())))
    assert white.std() == pytest.approx(noise_dn, rel=0.05)


def test_raster_noise_decreases_with_reflectance_like_speckle(scanner, light):
    """Both come from uneven light, so reflectance R has `1 / sqrt(1 + volume 2R / (1 - R^2))` times
    the noise of a black surface. The wall leans away from the projector, so it seems
    darker by the cosine.
    """
    normal = np.array([0.25, 0.15, 1.0]) / np.linalg.norm([0.25, 0.15, 1.0])
    from_projector = np.array([0.0, 0.0, WALL_M]) - scanner.rig.T_cam_proj[:3, 3]
    cosine = normal @ from_projector / np.linalg.norm(from_projector)
    rig = replace(scanner.rig, speckle_contrast=0.05, speckle_volume=5.0)
    noise_m = {}
    for reflectance, rendering in light.items():
        depth_m = {}
        for raster_px in (0.0, 0.5):
            own = replace(scanner, rig=rig, faults=FaultSpec(raster_px=raster_px))
            depth_m[raster_px] = scan(own, rendering.radiance, seed=1).depth.depth_m
        noise_m[reflectance] = np.nanstd((depth_m[0.5] - depth_m[0.0])[2:-2, 2:-2])
    law = material_contrast(np.array([0.7, 0.03]) * cosine, 5.0)
    assert noise_m[0.7] / noise_m[0.03] == pytest.approx(law[0] / law[1], rel=0.08)
