"""Measured errors of decoded depth and of edges equal the errors that the tests add."""

from types import SimpleNamespace

import numpy as np
import pytest
from stage import centred

from benchmarks.decoded import decoding_error, edge_shifts, fine_contrast, one_surface
from graycast.camera.decode import CodeMap, DepthMap, Reason
from graycast.rendering import Radiance
from graycast.rig.pattern import gray

CODE = gray(64, 8, axes=("column",))


def result(column, depth_m, valid):
    """Return a decoded map with the given columns and depths."""

    def where(values):
        return np.where(valid, values, np.nan).astype(np.float32)

    reason = np.where(valid, Reason.DECODED, Reason.SHADOW).astype(np.uint8)
    none = np.full(column.shape, np.nan, dtype=np.float32)
    codes = CodeMap(
        column=where(column), row=none, sigma_column=none, sigma_row=none, modulation=none,
        reason=reason,
    )  # fmt: skip
    camera = centred(*column.shape[::-1], 100.0)
    depth = DepthMap(depth_m=where(depth_m), sigma_m=none, reason=reason, camera=camera)
    return SimpleNamespace(codes=codes, depth=depth)


def test_each_kind_of_error_is_counted_as_a_share_of_the_reference():
    """In the reference, 80 of 100 pixels have depth. In the result, 4 of these are wrong by two
    columns and 10 mm, 8 are lost, and 5 others have depth. The rest have an error of one column and
    3 mm, which does not count as wrong.
    """
    column, depth_m = np.full((10, 10), 30.0), np.full((10, 10), 0.7)
    valid = np.arange(100).reshape(10, 10) < 80
    reference = result(column, depth_m, valid)
    other = valid.copy()
    other.flat[:8] = False
    other.flat[80:85] = True
    column, depth_m = column + 1, depth_m + 0.003
    column.flat[20:24] += 1
    depth_m.flat[20:24] += 0.007
    error = decoding_error(result(column, depth_m, other), reference)
    assert error["wrong_share"] == pytest.approx(4 / 80)
    assert error["hole_share"] == pytest.approx(8 / 80)
    assert error["extra_share"] == pytest.approx(5 / 80)
    assert error["bad_share"] == pytest.approx(17 / 80)
    assert error["depth_rms_right_mm"] == pytest.approx(3, rel=1e-4)
    assert error["depth_median_mm"] == pytest.approx(3, rel=1e-4)
    assert error["depth_rmse_mm"] == pytest.approx(np.sqrt((68 * 9 + 4 * 100) / 72), rel=1e-4)


def test_a_result_compared_with_itself_has_no_error():
    same = result(np.full((4, 4), 3.0), np.full((4, 4), 0.5), np.ones((4, 4), dtype=bool))
    assert not any(decoding_error(same, same).values())


def light(shift_px=0.0, growth_px=0.0, per_column=4, blur_px=3.0):
    """Return frames of a wall: a column is `per_column` camera pixels, an edge `blur_px` wide.

    `shift_px` moves all edges to the right; `growth_px` moves both edges of lit stripes outwards.
    """
    x = np.arange(64 * per_column)
    stack = []
    for picture in CODE.render():
        line = picture[0] / 255
        image = np.full(len(x), line[0])
        for k in np.flatnonzero(np.diff(line)):
            rising = line[k + 1] > line[k]
            place = (k + 1) * per_column - 0.5 + shift_px - (growth_px if rising else -growth_px)
            step = np.clip((x - place) / blur_px + 0.5, 0, 1)
            image += step if rising else -step
        stack.append(np.tile(image, (3, 1)))
    stack = 5 * np.array(stack, dtype=np.float32)
    rgb = np.zeros((*stack.shape[1:], 3), dtype=np.float32)
    return Radiance(
        pattern=stack, white=stack[0], ambient=0 * stack[0], white_rgb=rgb, ambient_rgb=rgb,
        albedo=rgb,
    )  # fmt: skip


EVERYWHERE = np.ones((3, 256), dtype=bool)


@pytest.mark.parametrize(("shift_px", "growth_px"), [(0.3, 0.0), (0.0, -0.2), (-0.25, 0.1)])
def test_moved_edges_are_located_at_their_new_positions(shift_px, growth_px):
    """Rising and falling edges are about equally many, so shift and growth can be separated."""
    figures = edge_shifts(light(shift_px, growth_px), light(), CODE, EVERYWHERE)
    # Edges of wide stripes: bits 2 to 5 of 64 values have 8, 4, 2 and 1 edges.
    rising, falling = 4 + 2 + 1 + 1, 4 + 2 + 1
    unbalanced = (falling - rising) / (rising + falling)
    assert figures["edge_bias_px"] == pytest.approx(shift_px + unbalanced * growth_px, abs=1e-4)
    assert figures["edge_growth_px"] == pytest.approx(growth_px + unbalanced * shift_px, abs=1e-4)
    assert figures["edge_lost_share"] == 0


def test_an_edge_that_moved_too_far_counts_as_lost():
    assert edge_shifts(light(2.5), light(), CODE, EVERYWHERE) == {}
    nowhere = np.zeros_like(EVERYWHERE)
    assert edge_shifts(light(), light(), CODE, nowhere) == {}


def test_blur_reduces_the_contrast_of_the_finest_stripes():
    """Stripes are 8 camera pixels wide. With linear edges of b pixels, the mean distance from the
    mean level is 1 - b / 16 of that of sharp stripes.
    """
    for blur_px in (2.0, 6.0):
        contrast = fine_contrast(light(blur_px=blur_px), CODE, EVERYWHERE)
        assert contrast == pytest.approx(1 - blur_px / 16, abs=0.02)


def test_pixels_at_a_step_are_not_on_one_surface():
    depth_m = np.full((2, 6), 0.6)
    depth_m[:, 3:] = 0.65
    valid = np.ones((2, 6), dtype=bool)
    valid[1, 0] = False
    near = one_surface(result(np.zeros((2, 6)), depth_m, valid))
    assert near.tolist() == [
        [True, True, False, True, True, False],
        [False, True, False, True, True, False],
    ]
