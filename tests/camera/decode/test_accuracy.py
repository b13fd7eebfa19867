"""Accuracy of decoded positions: errors agree with sigma for every code and with noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1

from graycast.base.errors import DecodeError
from graycast.camera.decode import DecodeSpec, Reason, decode, levels_of
from graycast.camera.sensor import SensorSpec
from graycast.rig.pattern import (
    Code,
    Frame,
    gray,
    gray_line_shift,
    gray_phase,
    micro_phase,
    multi_frequency,
    xor_gray,
)
from studies.projected import LEVELS, crisp, frames_of, share_of_white, two_phases

USUAL = DecodeSpec()
SENSOR = levels_of(SensorSpec(offset_dn=0.0, gain_dn_per_e=0.1, full_well_e=1e6, bit_depth=8))
FINE_CODES = {
    "phase": gray_phase(512, 384),
    "phase, 3 steps": gray_phase(512, 384, steps=3, period_px=24.0),
    "phase, 12 steps": gray_phase(512, 384, steps=12, period_px=60.0, inverses=True),
    "lines": gray_line_shift(512, 384),
    "three frequencies": multi_frequency(512, 384),
    "micro": micro_phase(512, 384),
}


def noisy(code, *, white_dn, seed=1, n=120):
    """Return pictures of a smooth surface lit by `white_dn` (h, 1 or a number), with noise."""
    rng = np.random.default_rng(seed)
    u = np.linspace(4, code.width_px - 5, 400)[None] + rng.uniform(0, 1, (n, 1))
    light = 60 + white_dn * share_of_white(code, u)
    return u, decode(frames_of(light, rng), code, USUAL, LEVELS)


def deviations(u, codes):
    known = codes.reason == Reason.DECODED
    return ((codes.column - u) / codes.sigma_column)[known].astype(float), known.mean()


@pytest.mark.parametrize("name", FINE_CODES)
@pytest.mark.parametrize("white_dn", [pytest.param(300.0, marks=pytest.mark.slow), 3000.0])
def test_errors_of_positions_agree_with_their_stated_sigma(name, white_dn):
    """Normal law for 48,000 deviations: 68.3 % are below 1 and 95.4 % below 2 (+- 0.2 %), and the
    mean square is 1 (+- 0.7 %). The staircase of the projector's pixels adds 0.004 px (rms); the
    smallest sigma here, that of the lines in bright light, is 0.010 px.
    """
    u, codes = noisy(FINE_CODES[name], white_dn=white_dn)
    z, decoded = deviations(u, codes)
    assert decoded > 0.97
    far = np.abs(z) > 6  # wrong periods, where noise exchanges the cosines of two positions
    assert far.mean() < 2e-4
    z = z[~far]
    assert 0.64 < (np.abs(z) < 1).mean() < 0.71
    assert 0.93 < (np.abs(z) < 2).mean() < 0.965
    assert abs(np.mean(z)) < 0.03
    assert abs(np.sqrt(np.mean(z**2)) - 1) < 0.08


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_the_check_of_sigma_fails_if_the_noise_differs_by_15_percent(factor):
    """The same check fails for a stack whose noise differs from that in `levels`."""
    code = FINE_CODES["phase"]
    rng = np.random.default_rng(1)
    u = np.linspace(4, 500, 400)[None] + rng.uniform(0, 1, (120, 1))
    light = 60 + 3000 * share_of_white(code, u)
    law = replace(LEVELS, floor_dn2=LEVELS.floor_dn2 * factor**2, slope_dn=0.39 * factor**2)
    z, _ = deviations(u, decode(frames_of(light, rng, levels=law), code, USUAL, LEVELS))
    assert not abs(np.sqrt(np.mean(z**2)) - 1) < 0.08


def test_errors_of_plain_gray_code_are_under_half_a_column_away_from_edges():
    code = gray(512, 384, axes=("column",), inverses=True)
    u, codes = noisy(code, white_dn=1500.0)
    off_px = np.abs(codes.column - u)
    known = codes.reason == Reason.DECODED
    assert known.mean() > 0.99
    sure = known & (codes.sigma_column < 0.289)
    assert sure.mean() > 0.5
    assert (off_px[sure] < 0.5).mean() > 0.998
    assert off_px[sure].max() < 0.55
    # A misread finest bit costs one column at most, and sigma includes it.
    assert off_px[known].max() < 1.5
    z, _ = deviations(u, codes)
    assert (np.abs(z) < 2).mean() > 0.99


def scatter_over_sigma(code, *, white_dn, disc_px, camera_px, frame_error=0.0):
    """Return rms error over sigma, and the modulation of the finest bit in closed form."""
    rng = np.random.default_rng(6)
    u = np.linspace(8, 500, 400)[None] + rng.uniform(0, 1, (60, 1))
    light = share_of_white(code, u, camera_px=camera_px, disc_px=disc_px)
    light = light + frame_error * rng.normal(size=light.shape)
    codes = decode(frames_of(60 + white_dn * light, rng), code, USUAL, LEVELS)
    x = 2 * np.pi * disc_px / 4
    left = np.sinc(camera_px / 4) * (2 * j1(x) / x if x else 1.0)
    z, decoded = deviations(u, codes)
    assert decoded > 0.98
    return np.sqrt(np.mean(z**2)), left


@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("white_dn", [300.0, 3000.0])
@pytest.mark.parametrize(
    ("disc_px", "camera_px", "left"),
    [(0.0, 0.7, 0.95), (1.0, 0.7, 0.69), (1.0, 1.5, 0.57), (1.5, 1.5, 0.35), (4.0, 3.0, -0.02)],
)
def test_errors_of_gray_code_agree_with_sigma_at_every_tested_blur(
    inverses, white_dn, disc_px, camera_px, left
):
    """Without the error of fine bits, the ratio is 1.7 to 3.3 if blur has removed the finest bit.
    These frames do not have that error, so the ratio is 0.8 if the bit is visible.
    """
    code = gray(512, 384, axes=("column",), inverses=inverses)
    ratio, contrast = scatter_over_sigma(
        code, white_dn=white_dn, disc_px=disc_px, camera_px=camera_px
    )
    assert contrast == pytest.approx(left, abs=0.01)
    assert 0.78 < ratio < 1.55


@pytest.mark.parametrize(("disc_px", "left"), [(0.0, 0.78), (1.5, 0.35), (2.1, 0.11), (2.4, 0.01)])
def test_errors_of_gray_code_agree_with_sigma_if_frames_differ_by_6_percent(disc_px, left):
    """The light of each frame varies by 4 %, so pattern and inverse differ by 6 %."""
    code = gray(512, 384, axes=("column",), inverses=True)
    error = 0.06 / np.sqrt(2)
    words = {"white_dn": 1500.0, "disc_px": disc_px, "camera_px": 1.5}
    ratio, contrast = scatter_over_sigma(code, frame_error=error, **words)
    assert contrast == pytest.approx(left, abs=0.01)
    assert 0.8 < ratio < 1.3


def test_phase_errors_are_a_tenth_of_gray_code_errors_in_the_same_light():
    rms = {}
    for name, code in (("gray", gray(512, 384)), ("phase", gray_phase(512, 384))):
        u, codes = noisy(code, white_dn=3000.0)
        off_px = (codes.column - u)[codes.reason == Reason.DECODED]
        rms[name] = np.sqrt(np.mean(off_px**2))
    assert rms["gray"] == pytest.approx(1 / np.sqrt(12), rel=0.03)
    assert rms["gray"] / rms["phase"] > 10


@pytest.mark.parametrize(
    ("period_px", "camera_px", "disc_px", "error_px"),
    [(8, 1.0, 0.0, 0.010), (8, 1.5, 0.0, 0.075), (8, 1.5, 1.0, 0.005), (16, 1.5, 0.5, 0.013)],
)
@pytest.mark.parametrize("make", [gray_line_shift, gray_phase])
def test_wide_projector_pixels_cause_the_documented_error_of_phases(
    make, period_px, camera_px, disc_px, error_px
):
    """The figures come from the harmonics k P + 1 of a pattern on a pixel grid, without noise."""
    code = make(64, 8, period_px=float(period_px))
    u = np.linspace(20, 44, 2001)[None]
    light = 60000 * share_of_white(code, u, camera_px=camera_px, disc_px=disc_px)
    levels = replace(LEVELS, offset_dn=0.0, saturation_dn=65535.0)
    codes = decode(frames_of(light, levels=levels), code, USUAL, levels)
    assert np.abs(codes.column - u).max() == pytest.approx(error_px, abs=0.002)


# --- frames that a stack may omit ---------------------------------------------------------------


@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("size", [(64, 48), (37, 22), (2, 3), (100, 1025)])
@pytest.mark.parametrize("make", [gray, xor_gray])
def test_decoding_gives_every_projector_pixel_its_own_position(make, size, inverses):
    code = make(*size, axes=("column", "row"), inverses=inverses)
    row, column = np.mgrid[0 : size[1], 0 : size[0]]
    codes = decode(crisp(code, column, row), code, USUAL, SENSOR)
    assert (codes.reason == Reason.DECODED).all()
    assert np.array_equal(codes.column, column) and np.array_equal(codes.row, row)
    assert np.allclose(codes.modulation, 180 / 255)
    assert np.allclose(codes.sigma_column, 1 / np.sqrt(12))


@pytest.mark.parametrize("make", [gray, gray_phase, gray_line_shift, multi_frequency, micro_phase])
def test_a_code_of_one_axis_decodes_no_position_along_the_other_axis(make):
    at = np.linspace(5, 120, 37)[None].repeat(4, axis=0)
    code = make(128, 96, axes=("column",))
    codes = decode(frames_of(1500 * share_of_white(code, at)), code, USUAL, LEVELS)
    assert np.abs(codes.column - at).max() < 0.6 and np.isnan(codes.row).all()
    assert np.isnan(codes.sigma_row).all()
    code = make(96, 128, axes=("row",))
    codes = decode(frames_of(1500 * share_of_white(code, 0 * at, at)), code, USUAL, LEVELS)
    assert np.abs(codes.row - at).max() < 0.6 and np.isnan(codes.column).all()


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_code_without_its_finest_bits_decodes_to_centres_of_wider_cells(missing):
    whole = gray(64, 8, axes=("column",), inverses=True)
    frames = tuple(f for f in whole.frames if f.kind != "gray" or f.bit >= missing)
    code = replace(whole, frames=frames)
    column = np.arange(64)[None]
    codes = decode(crisp(code, column), code, USUAL, SENSOR)
    cell = 2**missing
    assert np.array_equal(codes.column, column // cell * cell + (cell - 1) / 2)
    assert np.allclose(codes.sigma_column, cell / np.sqrt(12))


def test_gray_bits_are_decoded_without_white_and_black_frames():
    whole = gray(64, 48)
    code = replace(whole, frames=whole.frames[2:])
    row, column = np.mgrid[1:48, 1:64]
    codes = decode(crisp(code, column, row), code, USUAL, SENSOR)
    known = codes.reason == Reason.DECODED
    assert np.array_equal(codes.column[known], column[known])
    assert np.array_equal(codes.row[known], row[known])
    # Position 42 is 111111 in Gray code: if all bits are projected, no frame is dark there.
    assert np.argwhere(~known).tolist() == [[41, 41]]


def test_a_code_with_an_offset_and_a_stride_is_decoded():
    """Values are 3 px wide from pixel 10 on; a position is the centre of its value."""
    small = gray(16, 16, axes=("column",))
    code = Code(
        width_px=100,
        height_px=80,
        frames=small.frames,
        offset_px=(10.0, 0.0),
        stride_px=(3.0, 1.0),
    )
    column = np.arange(10, 58)[None]
    codes = decode(crisp(code, column), code, USUAL, SENSOR)
    assert np.array_equal(codes.column, 10 + (column - 10) // 3 * 3 + 1)
    assert np.allclose(codes.sigma_column, 3 / np.sqrt(12))


def test_gray_bits_to_single_columns_need_no_complementary_bit_with_phases():
    fine = gray(128, 96, axes=("column",))
    phase = [f for f in gray_phase(128, 96, period_px=20.0).frames if f.kind == "phase"]
    code = replace(fine, frames=(*fine.frames, *phase))
    u, codes = noisy(code, white_dn=1500.0)
    z, decoded = deviations(u, codes)
    assert decoded > 0.99
    assert 0.9 < np.sqrt(np.mean(z**2)) < 1.1


TWO_PHASES = two_phases(1000, 96, gray_cell_px=100.0, periods_px=(200 / 3, 100.0))


def as_complementary(code):
    """Return the same pictures with the finest bit declared complementary, of twice its cells."""
    frames = []
    for f in code.frames:
        if f.kind == "gray" and f.bit > 0:
            f = replace(f, bit=f.bit - 1)
        elif f.kind == "gray":
            f = Frame(kind="complementary", axis=f.axis, period_px=200.0, inverse=f.inverse)
        frames.append(f)
    return replace(code, frames=tuple(frames), stride_px=(200.0, 200.0))


@pytest.mark.parametrize("power", [1.0, 2.2])
@pytest.mark.parametrize("state", [lambda code: code, as_complementary])
def test_wide_gray_cells_and_two_phases_together_determine_the_position(power, state):
    """Places with equal phases are 200 px apart, and the cells of 100 px are wider than the shorter
    period. If light is a power p of the grey level, the cosine's second harmonic is (p - 1) / (p +
    2) of the first; it moves the phase of three steps by a sine of this amplitude.
    """
    u = np.linspace(1, 998, 2000)[None].repeat(20, axis=0)
    light = 60 + 1500 * share_of_white(TWO_PHASES, u) ** power
    frames = frames_of(light, np.random.default_rng(3))
    codes = decode(frames, state(TWO_PHASES), USUAL, LEVELS)
    known = codes.reason == Reason.DECODED
    assert known.mean() > 0.99
    off_px = np.abs(codes.column - u)[known]
    assert off_px.max() < 100 / (2 * np.pi) * np.arcsin((power - 1) / (power + 2)) + 1.0
    if power == 1:
        z, _ = deviations(u, codes)
        assert 0.9 < np.sqrt(np.mean(z**2)) < 1.1


@pytest.mark.parametrize("steps", [3, 4])
def test_a_single_period_as_wide_as_the_projector_needs_no_gray_code(steps):
    """Pixels are in doubt only where noise may exchange the first and the last column."""
    code = two_phases(512, 96, gray_cell_px=1.0, periods_px=(512.0,), steps=steps, bits=0)
    u, codes = noisy(code, white_dn=1500.0)
    known = codes.reason == Reason.DECODED
    assert known.mean() > 0.995
    z, _ = deviations(u, codes)
    assert np.abs(z).max() < 6


def test_a_stack_with_a_wrong_number_of_frames_is_refused():
    code = gray(32, 16, inverses=True)
    stack = crisp(gray(32, 16), np.array([[5]]), np.array([[3]]))
    with pytest.raises(DecodeError, match="11 frames, the code has 20"):
        decode(stack, code, USUAL, SENSOR)
