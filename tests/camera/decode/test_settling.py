"""Periods that weak phases leave open are settled by neighbours that agree, and only then."""

from dataclasses import replace

import numba
import numpy as np
import pytest
from plain_decoder import decode_plain

from graycast.camera.decode import DecodeSpec, Mark, Reason, decode
from graycast.rig.pattern import gray_phase
from studies.decoder_limits import SHAPE, WEAK_CODES, stack, surface
from studies.projected import LEVELS, share_of_white

SPEC = DecodeSpec(min_contrast=0.005)


def weak(name, white_dn):
    code = WEAK_CODES[name]
    return code, stack(code, white_dn=white_dn)


def wrong(codes, name):
    """Return the share of decoded pixels with an error of at least half of the shortest period."""
    known = codes.reason == Reason.DECODED
    limit_px = 0.5 * min(f.period_px for f in WEAK_CODES[name].frames if f.period_px)
    return np.abs(codes.column - surface())[known] > limit_px


@pytest.mark.parametrize(
    ("name", "white_dn", "alone", "together"),
    [
        ("three frequencies", 60.0, 0.60, 0.985),
        ("two frequencies", 240.0, 0.75, 0.985),
        ("two frequencies", 60.0, 0.01, 0.97),
        ("micro phase", 60.0, 0.02, 0.97),
        ("micro phase", 120.0, 0.60, 0.985),
        ("micro phase, 8 px", 120.0, 0.25, 0.94),
    ],
)
def test_neighbours_settle_uncertain_periods_and_hardly_ever_wrongly(
    name, white_dn, alone, together
):
    """The scene has steps of some periods, and bars of 1 to 6 pixels in front of the wall."""
    code, frames = weak(name, white_dn)
    codes = decode(frames, code, SPEC, LEVELS)
    known = codes.reason == Reason.DECODED
    settled = codes.mark & Mark.SETTLED > 0
    assert (known & ~settled).mean() < alone  # Other pixels were already decoded.
    assert known.mean() > together
    assert wrong(codes, name).mean() < 6e-4


@pytest.mark.parametrize(
    ("name", "white_dn"), [("three frequencies", 90.0), ("micro phase", 140.0)]
)
def test_a_pixel_with_a_clear_period_is_never_changed(name, white_dn):
    """In a shuffled picture, neighbours are unrelated and do not agree."""
    code, frames = weak(name, white_dn)
    whole = decode(frames, code, SPEC, LEVELS)
    order = np.random.default_rng(3).permutation(whole.reason.size)
    mixed = frames.reshape(len(frames), -1)[:, order].reshape(frames.shape)
    strange = decode(np.ascontiguousarray(mixed), code, SPEC, LEVELS)
    alone = {}
    for field in ("column", "sigma_column", "reason", "mark"):
        alone[field] = np.empty(order.size, dtype=getattr(whole, field).dtype)
        alone[field][order] = getattr(strange, field).ravel()
    assert (alone["mark"] & Mark.SETTLED > 0).mean() < 1e-3
    clear = (alone["reason"] == Reason.DECODED) & (alone["mark"] == 0)
    assert 0.2 < clear.mean() < 0.995
    assert (whole.mark.ravel()[clear] == 0).all()
    for field in ("column", "sigma_column", "reason"):
        assert np.array_equal(getattr(whole, field).ravel()[clear], alone[field][clear])
    # Doubtful pixels without neighbours that agree are refused as before.
    assert (alone["reason"] == Reason.CONTRADICTORY).mean() > 0.004


@pytest.mark.parametrize(("rows", "columns", "settles"), [(3, 3, True), (2, 4, False)])
def test_eight_agreeing_neighbours_settle_a_period_but_seven_do_not(rows, columns, settles):
    """Around lit blocks all is dark, so each pixel has the others of its block as neighbours."""
    code, frames = weak("micro phase", 120.0)
    y, x = np.indices(SHAPE)
    lit = (y % (rows + 3) < rows) & (x % (columns + 3) < columns)
    dark = stack(code, white_dn=0.0, seed=2)
    # This is twelve deviations of the noise in the dark, so no dark pixel is decoded.
    spec = DecodeSpec(min_contrast=60 / LEVELS.range_dn)
    codes = decode(np.where(lit, frames, dark), code, spec, LEVELS)
    assert not (codes.reason[~lit] == Reason.DECODED).any()
    settled = (codes.mark & Mark.SETTLED > 0)[lit]
    assert settled.mean() > 0.1 if settles else not settled.any()


def test_settled_positions_scatter_by_their_sigma():
    """The period is settled; within it, the position is as noisy as its phase."""
    code, frames = weak("micro phase", 90.0)
    codes = decode(frames, code, SPEC, LEVELS)
    for settled in (False, True):
        where = (codes.reason == 0) & ((codes.mark & Mark.SETTLED > 0) == settled)
        z = ((codes.column - surface()) / codes.sigma_column)[where].astype(float)
        z = z[np.abs(z) < 6]
        assert where.mean() > 0.1
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", WEAK_CODES)
def test_plain_and_compiled_decoders_settle_the_same_pixels(name):
    """Sums in float32 and in float64 differ near a limit, and so do pixels that depend on it."""
    code, frames = weak(name, 90.0)
    frames = np.ascontiguousarray(frames[:, 100:190, 20:140])
    fast, plain = (f(frames.copy(), code, SPEC, LEVELS) for f in (decode, decode_plain))
    assert (plain.mark & Mark.SETTLED > 0).mean() > 0.01
    same = (fast.reason == plain.reason) & (fast.mark == plain.mark)
    assert same.mean() > 0.9995
    np.testing.assert_allclose(fast.column[same], plain.column[same], atol=1e-3)


def test_the_number_of_threads_does_not_change_settled_pixels():
    code, frames = weak("micro phase", 60.0)
    before = numba.get_num_threads()
    try:
        results = []
        for threads in (1, before):
            numba.set_num_threads(threads)
            results.append(decode(frames, code, SPEC, LEVELS))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(results[0].column, results[1].column, equal_nan=True)
    assert np.array_equal(results[0].mark, results[1].mark)


VOTES = 14
CONTRADICTION = gray_phase(512, 384, axes=("column",), period_px=24.0)


def contradicting(spoilt, share=None):
    """Return a strong stack in which two coarse Gray bits of the given pixels are grey."""
    frames = stack(CONTRADICTION, white_dn=1200.0, share=share)
    bits = [k for k, f in enumerate(CONTRADICTION.frames) if f.kind == "gray"][1:3]
    middle = (frames.max(axis=0) / 2 + frames.min(axis=0) / 2).astype(np.uint16)
    for k in bits:
        frames[k][spoilt] = middle[spoilt]
    return frames


def read(frames, votes, decoder=decode):
    return decoder(frames, CONTRADICTION, replace(SPEC, settling_votes=votes), LEVELS)


def test_neighbours_settle_the_period_of_a_pixel_with_contradictory_bits():
    """One pixel in a hundred is contradictory, on surfaces and next to steps and bars."""
    spoilt = np.random.default_rng(5).random(SHAPE) < 0.01
    before, after = (read(contradicting(spoilt), votes) for votes in (0, VOTES))
    assert (before.reason[spoilt] != Reason.DECODED).all()
    clear = before.reason == Reason.DECODED
    for field in ("column", "sigma_column", "reason", "mark"):  # the other pixels are unchanged
        assert np.array_equal(getattr(before, field)[clear], getattr(after, field)[clear])
    settled = after.mark & Mark.SETTLED > 0
    assert settled[spoilt].mean() > 0.9
    assert not settled[clear].any()
    off_px = np.abs(after.column - surface())[settled]
    assert (off_px < 6 * after.sigma_column[settled] + 0.02).all()


def test_a_region_of_contradictory_pixels_is_not_filled():
    """Settled pixels do not count as neighbours, so only the border of the region is settled."""
    spoilt = np.zeros(SHAPE, dtype=bool)
    spoilt[20:40, 10:30] = True  # This area is on the wall.
    after = read(contradicting(spoilt), VOTES)
    assert (after.reason[22:38, 12:28] != Reason.DECODED).all()
    assert (after.mark[22:38, 12:28] & Mark.SETTLED == 0).all()


def test_neighbours_on_different_surfaces_do_not_settle_a_pixel():
    """A step of two periods is invisible in the phase."""
    x = np.broadcast_to(np.arange(SHAPE[1], dtype=float), SHAPE)
    place = 60 + 1.5 * x + 48.0 * (x >= 128)
    spoilt = np.zeros(SHAPE, dtype=bool)
    spoilt[10:180:5, 100:156] = True
    spoilt[:, ::2] = False
    after = read(contradicting(spoilt, share_of_white(CONTRADICTION, place)), VOTES)
    settled = spoilt & (after.mark & Mark.SETTLED > 0)
    assert not settled[:, 127:129].any()
    assert settled[:, 101:126].sum() == spoilt[:, 101:126].sum()
    assert (np.abs(after.column - place)[settled] < 0.5).all()


@pytest.mark.slow
def test_a_pixel_is_refused_if_one_of_its_two_axes_cannot_be_settled():
    """The plain decoder gives the same result for each axis."""
    code = gray_phase(512, 384, axes=("column", "row"), period_px=24.0)
    column = surface()
    row = np.broadcast_to(np.linspace(40, 300, SHAPE[0])[:, None], SHAPE)
    frames = (60 + 1200 * share_of_white(code, column, row)).astype(np.uint16)
    lone = np.random.default_rng(8).random(SHAPE) < 0.01
    block = np.zeros(SHAPE, dtype=bool)
    block[20:40, 10:30] = True
    middle = np.uint16(660)
    for axis, spoilt in (("column", block), ("row", lone)):
        bits = [k for k, f in enumerate(code.frames) if f.kind == "gray" and f.axis == axis][1:3]
        for k in bits:
            frames[k][spoilt] = middle
    spec = replace(SPEC, settling_votes=VOTES)
    fast, plain = (f(frames, code, spec, LEVELS) for f in (decode, decode_plain))
    assert (fast.reason[22:38, 12:28] != Reason.DECODED).all()
    assert (fast.mark & Mark.SETTLED > 0).sum() > 0.8 * (lone & ~block).sum()
    assert np.array_equal(fast.reason, plain.reason)
    assert np.array_equal(fast.mark, plain.mark)
    for field in ("column", "row"):
        np.testing.assert_allclose(getattr(fast, field), getattr(plain, field), atol=2e-3)


@pytest.mark.slow
def test_a_saturated_pixel_is_not_settled_by_either_decoder():
    """Reasons of light come before reasons of code: saturation may cause the contradiction."""
    spoilt = np.random.default_rng(5).random(SHAPE) < 0.01
    frames = contradicting(spoilt)
    clipped = spoilt & (np.arange(SHAPE[1]) % 2 == 0)
    frames[0][clipped] = int(LEVELS.saturation_dn)
    fast, plain = (read(frames, VOTES, decoder) for decoder in (decode, decode_plain))
    assert not (fast.mark & Mark.SETTLED > 0)[clipped].any()
    assert (fast.reason[clipped] == Reason.SATURATED).any()
    assert (fast.mark & Mark.SETTLED > 0)[spoilt & ~clipped].mean() > 0.9
    assert np.array_equal(fast.reason, plain.reason)
    assert np.array_equal(fast.mark, plain.mark)
