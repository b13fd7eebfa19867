"""The laboratory's method, tested with sensors of known parameters."""

from dataclasses import replace

import numpy as np
import photon_transfer as laboratory
import pytest
from backends import slow
from photon_transfer import photon_transfer
from scipy import stats

from graycast.camera.sensor import Capture, SensorSpec, expose

SPEC = SensorSpec(dark_current_e_s=25.0, dsnu_e=1.2, prnu=0.008, fpn_seed=7)


def returns(measured, spec):
    """Return whether gain, read noise and full well are within 2 % of the sensor's."""
    names = ("gain_dn_per_e", "read_noise_e", "full_well_e")
    return all(abs(getattr(measured, n) / getattr(spec, n) - 1) < 0.02 for n in names)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "side_px"),
    [
        (SPEC, 128),
        slow(
            SensorSpec(bit_depth=16, gain_dn_per_e=3.0, full_well_e=18_000.0, read_noise_e=7.0), 256
        ),
        slow(
            SensorSpec(f_number=2.8, gain_dn_per_e=1.5, full_well_e=2500.0, read_noise_e=2.0), 256
        ),
    ],
)
def test_photon_transfer_measures_the_parameters_of_a_simulated_sensor(spec, side_px):
    measured = photon_transfer(spec, seed=1, side_px=side_px)
    assert returns(measured, spec)
    assert abs(measured.dark_current_e_s / spec.dark_current_e_s - 1) < 0.05
    assert abs(measured.offset_dn - spec.offset_dn) < 0.1
    assert abs(measured.dsnu_e - spec.dsnu_e) < 0.03 * spec.dsnu_e + 0.1 * (spec.dsnu_e == 0)
    assert abs(measured.prnu - spec.prnu) < 0.03 * spec.prnu + 5e-4 * (spec.prnu == 0)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_photon_transfer_notices_noise_that_is_3_percent_wrong(monkeypatch, factor):
    """The temporal noise of every picture is scaled about its level, which does not change."""

    def wrong(radiance, background, sensor, *, exposure_s, seed):
        frames = expose(
            radiance, background, sensor, exposure_s=exposure_s, seed=seed
        ).frames.astype(float)
        middle = frames.mean(axis=(1, 2), keepdims=True)
        stretched = middle + factor * (frames - middle)
        stored = np.clip(np.rint(stretched), 0, sensor.max_dn).astype(np.uint16)
        return Capture(frames=stored, sensor=sensor, exposure_s=exposure_s)

    fine = SensorSpec(bit_depth=16, gain_dn_per_e=4.0)  # rounding is negligible
    assert returns(photon_transfer(fine, seed=3, stack=8), fine)
    monkeypatch.setattr(laboratory, "expose", wrong)
    assert not returns(photon_transfer(fine, seed=3, stack=8), fine)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gain_dn_per_e", "read_noise_e", "full_well_e"])
def test_photon_transfer_notices_a_parameter_that_is_3_percent_wrong(name):
    wrong = replace(SPEC, **{name: 1.03 * getattr(SPEC, name)})
    assert not returns(photon_transfer(wrong, seed=2, stack=8), SPEC)


@pytest.mark.slow
def test_the_saturation_capacity_agrees_with_a_clipped_normal_law():
    """Oracle: variance of min(normal(mu, mu), well), scanned; the levels are 2 % apart."""
    quantile = stats.norm.ppf((np.arange(20_000) + 0.5) / 20_000)
    mean_e = np.arange(9000.0, 10_000.0, 10.0)
    counted = np.minimum(mean_e[:, None] + np.sqrt(mean_e)[:, None] * quantile, 10_000.0)
    capacity_e = mean_e[counted.var(axis=1).argmax()]
    measured = photon_transfer(SensorSpec(), seed=4, levels=120, stack=8)
    assert abs(measured.saturation_capacity_e / capacity_e - 1) < 0.02
    assert measured.saturation_capacity_e < 0.99 * measured.full_well_e
