"""Parameters are set in a scanner, and read back, by their keys in the rig file."""

import numpy as np
import pytest

from graycast.camera.rig_file import load_scanner, save_scanner
from graycast.camera.scanner import preset
from graycast.real.twin.parameters import (
    BIN_ROUGHNESS,
    OF_BIN,
    PARAMETERS,
    candidate_codes,
    shares_of,
    value_of,
    values_at,
    with_values,
)
from graycast.rig.pattern import CodeSpec

SCANNER = preset("like-phoxi-m", "small")


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.key)
def test_parameter_values_are_read_back_from_the_scanner_and_its_file(parameter, tmp_path):
    if parameter.key in OF_BIN:
        assert value_of(SCANNER, parameter) == (0.0 if parameter.key == BIN_ROUGHNESS else 1.0)
        return
    value = parameter.value(0.7)
    scanner = with_values(SCANNER, [parameter], {parameter.key: value})
    save_scanner(scanner, tmp_path / "rig.yaml")
    for one in (scanner, load_scanner(tmp_path / "rig.yaml")):
        assert value_of(one, parameter) == pytest.approx(value)


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.key)
def test_parameters_as_shares_of_their_bounds_can_be_converted_back(parameter):
    assert (parameter.value(0.0), parameter.value(1.0)) == (parameter.low, parameter.high)
    for share in (0.0, 0.3, 0.8, 1.0):
        assert parameter.share(parameter.value(share)) == pytest.approx(share, abs=1e-3)


def test_setting_a_parameter_changes_no_other_value():
    values = values_at(shares_of(SCANNER, PARAMETERS), PARAMETERS)
    fitted = with_values(SCANNER, PARAMETERS, values)
    assert fitted.rig.camera == SCANNER.rig.camera
    assert fitted.code == SCANNER.code
    assert fitted.filters == SCANNER.filters
    assert fitted.faults == SCANNER.faults
    assert fitted.decode == SCANNER.decode
    assert fitted.rig.speckle_contrast == SCANNER.rig.speckle_contrast
    assert fitted.sensor == SCANNER.sensor


def test_a_filter_and_a_fault_are_off_below_their_smallest_value():
    low = with_values(SCANNER, PARAMETERS, values_at(np.zeros(len(PARAMETERS)), PARAMETERS))
    assert low.filters.smoothing_px is None and low.faults.raster_px is None
    assert low.rig.projector.falloff is None
    some = with_values(SCANNER, PARAMETERS, values_at(np.full(len(PARAMETERS), 0.5), PARAMETERS))
    assert some.filters.smoothing_px == 0.35 and some.faults.raster_px == 0.3
    assert some.rig.projector.falloff == 0.45


def test_a_larger_full_well_does_not_change_the_digital_number_at_saturation():
    well = next(p for p in PARAMETERS if p.key == "sensor.full_well_e")
    deep = with_values(SCANNER, [well], {well.key: 8e4}).sensor
    assert deep.full_well_e == 8e4
    full_dn = SCANNER.sensor.full_well_e * SCANNER.sensor.gain_dn_per_e
    assert deep.full_well_e * deep.gain_dn_per_e == pytest.approx(full_dn, rel=1e-3)


def test_finer_codes_are_tried_for_phase_codes_only():
    codes = candidate_codes(SCANNER.code)
    assert [code.period_px for code in codes] == [48.0, 24.0, 12.0]
    projector = SCANNER.rig.projector
    for code in codes:  # The projector can show each code.
        assert code.code(projector.width_px, projector.height_px).frames
    plain = CodeSpec(codec="gray")
    assert candidate_codes(plain) == (plain,)


def test_the_parameters_of_a_laser_scanner_are_within_their_ranges():
    for parameter in PARAMETERS:
        assert parameter.low <= parameter.laser <= parameter.high
