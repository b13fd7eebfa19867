"""The fitted properties of the bin are written into the configuration."""

import pytest
from small_cell import write_cell

from graycast.cell.config import load_config
from graycast.cell.resolve import resolve_cell
from graycast.real.twin.parameters import BIN_COLOR, BIN_GLOSS, BIN_ROUGHNESS, PARAMETERS
from graycast.real.twin.searching import Estimate, Fit
from graycast.real.twin.twin_files import _bin

PLAIN = {"base_color": [0.1, 0.2, 0.6], "roughness": 0.5, "specular": 0.4}


def written(folder, material, values):
    path = write_cell(folder, bin={"inner_m": [0.25, 0.2, 0.1], "material": material})
    cell = resolve_cell(load_config(path), folder)
    fit = Fit(
        scanner=cell.scanner,
        estimates=tuple(
            Estimate(parameter=p, value=values[p.key], low=p.low, high=p.high)
            for p in PARAMETERS
            if p.key in values
        ),
        by_code={},
        before=(),
        after=(),
        trials=0,
    )
    return _bin(fit, cell)


def test_colour_and_coat_are_written_as_fitted(tmp_path):
    values = {BIN_COLOR: 2.0, BIN_GLOSS: 0.5, BIN_ROUGHNESS: -0.1}
    material = written(tmp_path, PLAIN, values)["bin"]["material"]
    assert material["base_color"] == pytest.approx([0.2, 0.4, 0.9])  # 0.9 is the largest value.
    assert (material["specular"], material["roughness"]) == (0.2, 0.4)
    assert "projector_reflectance" not in material


def test_the_reflectance_in_projector_light_is_scaled_like_the_colour(tmp_path):
    settings = written(tmp_path, PLAIN | {"projector_reflectance": 0.2}, {BIN_COLOR: 1.5})
    assert settings["bin"]["material"]["projector_reflectance"] == pytest.approx(0.3)
    assert settings["bin"]["material"]["specular"] == 0.4


def test_a_bin_that_was_not_fitted_is_not_written(tmp_path):
    assert written(tmp_path, PLAIN, {}) == {}
