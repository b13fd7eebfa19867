"""The study of the pictures of five real scans: their light, and where they are black."""

import numpy as np
import pytest

from studies import phoxi_pictures


def test_stored_numbers_become_light_by_the_transfer_function_of_srgb():
    """Values of IEC 61966-2-1: a quarter of full scale is 5 % of the light, a half is 21 %."""
    light = phoxi_pictures.linear(np.array([0.0, 0.02, 0.25, 0.5, 1.0]))
    assert light == pytest.approx([0, 0.02 / 12.92, 0.0508761, 0.2140411, 1], rel=1e-5)


def test_a_prediction_is_compared_by_error_order_and_percentiles():
    true = np.linspace(1.0, 3.0, 101)
    assert phoxi_pictures.prediction(true, 1.5 * true)[:2] == ["50%", "1.00"]
    _, rank, spans = phoxi_pictures.prediction(true, 4 - true)
    assert rank == "-1.00"
    assert spans.partition(" / ")[0] == spans.partition(" / ")[2]
    assert phoxi_pictures.prediction(true, np.full(101, 2.0))[1] == "-"


@pytest.mark.slow
def test_the_pictures_of_the_scans_are_black_wherever_depth_is_missing(shared):
    """So they are made from the depth, and are no pictures of the scanner's own camera."""
    for number in range(5):
        scan = phoxi_pictures.read_scan(number)
        missing = np.isnan(scan.depth_m)
        assert 0.3 < missing.mean() < 0.35
        assert scan.black[missing].all()
        assert 0.05 < scan.black[~missing].mean() < 0.065
