"""Checks for depth in a wrong unit, filled holes, and ray lengths."""

import numpy as np
import pytest

from graycast.base.errors import DatasetError
from graycast.real.depth_sense import depth_kind_note, filled_holes, plane_shares, refuse_beyond
from graycast.rig.optics import Optics, picture_rays

RANGE = {"near_m": 0.67, "far_m": 1.0, "name": "a.png", "whose": "the detector learnt"}


def slope(rng, middle_m=0.88):
    """Return depth of a floor that rises by 0.2 m, with noise of 1 mm and steps of 0.02 mm."""
    depth_m = middle_m + np.linspace(-0.1, 0.1, 120)[None] + 1e-3 * rng.standard_normal((90, 120))
    return np.rint(depth_m / 2e-5) * 2e-5


@pytest.mark.parametrize("factor", [5, 0.02, 10, 0.1, 1000, 0.001, 25.4, 1 / 25.4])
def test_depth_in_another_unit_is_refused(factor):
    """A public report has the factors 5 and 0.02; the others are mm, cm, 0.1 mm and inches."""
    depth_m = factor * slope(np.random.default_rng(0))
    with pytest.raises(
        DatasetError, match=r"a\.png: .*learnt 0\.67 to 1 m: .*another unit"
    ) as error:
        refuse_beyond(depth_m, **RANGE)
    assert f"{np.median(depth_m):.4g} m" in str(error.value)


@pytest.mark.parametrize("middle_m", [0.5, 0.88, 1.4])
def test_a_camera_of_another_range_is_not_called_a_wrong_unit(middle_m):
    refuse_beyond(slope(np.random.default_rng(1), middle_m), **RANGE)
    refuse_beyond(np.full((4, 4), np.nan), **RANGE)


def test_filled_holes_are_named_with_their_share_and_depth():
    rng = np.random.default_rng(2)
    depth_m = slope(rng)
    depth_m[rng.random(depth_m.shape) < 0.22] = np.max(depth_m)
    note = filled_holes(depth_m, "a.png")
    assert note.startswith("a.png: 22% ") or note.startswith("a.png: 21% ")
    assert f"{depth_m.max():.4g} m" in note and "write 0 or NaN" in note


@pytest.mark.parametrize("step_m", [2e-5, 1e-3, 2e-3])
def test_measured_depth_in_coarse_steps_is_not_called_filled_holes(step_m):
    """On a floor that faces the camera with noise of 1 mm, the farthest step has few pixels."""
    rng = np.random.default_rng(3)
    flat = np.rint((0.88 + 1e-3 * rng.standard_normal((90, 120))) / step_m) * step_m
    assert filled_holes(flat, "a.png") is None
    holed = slope(rng)
    holed[rng.random(holed.shape) < 0.22] = np.nan
    assert filled_holes(holed, "a.png") is None
    assert filled_holes(np.full((4, 4), np.nan), "a.png") is None


@pytest.mark.parametrize("pixels", [5, 100])
def test_a_few_pixels_at_the_same_distant_depth_are_reported(pixels):
    """A sentinel such as 65.535 m in floats is reported for any share of pixels."""
    depth_m = slope(np.random.default_rng(4))
    assert depth_m.size > 20 * pixels  # The share is too small for filled holes.
    depth_m.flat[:pixels] = 65.535
    note = filled_holes(depth_m, "a.png")
    assert "exactly the farthest depth, 65.53 m" in note or "65.54 m" in note
    assert note.startswith(f"a.png: {pixels / depth_m.size:.2%} of the pixels")


def heap(f_px, seed):
    """Return depth of a tilted table that parts half hide, with 1 mm of noise, and the optics."""
    rng = np.random.default_rng(seed)
    optics = Optics(width_px=120, height_px=90, fx_px=f_px, fy_px=f_px, cx_px=59.5, cy_px=44.5)
    z_m = 0.8 / (picture_rays(optics) @ np.array([0.2, -0.1, 1.0]))
    y, x = np.mgrid[:90, :120]
    for _ in range(40):
        inside = (x - rng.integers(120)) ** 2 + (y - rng.integers(90)) ** 2 < 80
        z_m[inside] -= rng.uniform(0.02, 0.06) + 1e-3 * (x - y)[inside] % 0.02
    return z_m + 1e-3 * rng.standard_normal(z_m.shape), optics


@pytest.mark.parametrize("f_px", [75.0, 150.0, 300.0], ids=["wide", "usual", "narrow"])
def test_a_plane_distinguishes_z_from_the_length_of_rays(f_px):
    """Oracle: the length is z times the norm of the ray."""
    z_m, optics = heap(f_px, seed=0)
    length_m = z_m * np.linalg.norm(picture_rays(optics), axis=-1)
    z, lengths = plane_shares([z_m], optics), plane_shares([length_m], optics)
    assert (z.lengths, lengths.lengths) == (False, True)
    assert depth_kind_note(z, ray_length=False) is depth_kind_note(lengths, ray_length=True) is None
    assert "give --ray-length" in depth_kind_note(lengths, ray_length=False)
    assert "leave out --ray-length" in depth_kind_note(z, ray_length=True)


def test_pictures_without_a_plane_do_not_show_the_kind_of_depth():
    _, optics = heap(150.0, seed=0)
    rough_m = 0.5 + 0.4 * np.random.default_rng(5).random((90, 120))
    for depths_m in ([rough_m], [np.full((90, 120), np.nan)], []):
        shares = plane_shares(depths_m, optics)
        assert shares.lengths is None and depth_kind_note(shares, ray_length=False) is None
