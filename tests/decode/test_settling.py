"""Periods that weak phases leave open: neighbours settle them where they agree, and only those."""

import numba
import numpy as np
import pytest
from limits import SHAPE, WEAK_CODES, stack, surface
from projected import LEVELS

from graycast.decode import DecodeSpec, Mark, Reason, decode, decode_plain

SPEC = DecodeSpec(min_contrast=0.005)


def weak(name, white_dn):
    code = WEAK_CODES[name]
    return code, stack(code, white_dn=white_dn)


def wrong(codes, name):
    """Of the decoded pixels, which are half of the shortest period or more off."""
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
def test_neighbours_settle_what_weak_phases_leave_open_and_hardly_ever_wrongly(
    name, white_dn, alone, together
):
    """The scene has steps of some periods, and bars of 1 to 6 pixels before the wall."""
    code, frames = weak(name, white_dn)
    codes = decode(frames, code, SPEC, LEVELS)
    known = codes.reason == Reason.DECODED
    settled = codes.mark & Mark.SETTLED > 0
    assert (known & ~settled).mean() < alone  # what was decoded before
    assert known.mean() > together
    assert wrong(codes, name).mean() < 6e-4


@pytest.mark.parametrize(
    ("name", "white_dn"), [("three frequencies", 90.0), ("micro phase", 140.0)]
)
def test_a_pixel_that_is_clear_by_itself_is_never_changed(name, white_dn):
    """Pixels in another order have other neighbours: strangers, which agree on nothing."""
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
    # What is in doubt and has no neighbours that agree is refused as before.
    assert (alone["reason"] == Reason.CONTRADICTORY).mean() > 0.004


@pytest.mark.parametrize(("rows", "columns", "settles"), [(3, 3, True), (2, 4, False)])
def test_eight_neighbours_settle_a_period_and_seven_do_not(rows, columns, settles):
    """Lit blocks with dark all around: each pixel has all others of its block as neighbours."""
    code, frames = weak("micro phase", 120.0)
    y, x = np.indices(SHAPE)
    lit = (y % (rows + 3) < rows) & (x % (columns + 3) < columns)
    dark = stack(code, white_dn=0.0, seed=2)
    # Twelve deviations of the dark's noise, and half of the light: no dark pixel says anything.
    spec = DecodeSpec(min_contrast=60 / LEVELS.range_dn)
    codes = decode(np.where(lit, frames, dark), code, spec, LEVELS)
    assert not (codes.reason[~lit] == Reason.DECODED).any()
    settled = (codes.mark & Mark.SETTLED > 0)[lit]
    assert settled.mean() > 0.1 if settles else not settled.any()


def test_settled_places_scatter_by_their_sigma():
    """A settled count says which period it is; the place in it is as noisy as its phase."""
    code, frames = weak("micro phase", 90.0)
    codes = decode(frames, code, SPEC, LEVELS)
    for settled in (False, True):
        where = (codes.reason == 0) & ((codes.mark & Mark.SETTLED > 0) == settled)
        z = ((codes.column - surface()) / codes.sigma_column)[where].astype(float)
        z = z[np.abs(z) < 6]
        assert where.mean() > 0.1
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("name", WEAK_CODES)
def test_the_plain_decoder_settles_the_same(name):
    """Sums in float32 and in float64 differ next to a limit, and in what follows from it."""
    code, frames = weak(name, 90.0)
    frames = np.ascontiguousarray(frames[:, 100:190, 20:140])
    fast, plain = (f(frames.copy(), code, SPEC, LEVELS) for f in (decode, decode_plain))
    assert (plain.mark & Mark.SETTLED > 0).mean() > 0.01
    same = (fast.reason == plain.reason) & (fast.mark == plain.mark)
    assert same.mean() > 0.9995
    np.testing.assert_allclose(fast.column[same], plain.column[same], atol=1e-3)


def test_threads_settle_the_same():
    code, frames = weak("micro phase", 60.0)
    before = numba.get_num_threads()
    try:
        found = []
        for threads in (1, before):
            numba.set_num_threads(threads)
            found.append(decode(frames, code, SPEC, LEVELS))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(found[0].column, found[1].column, equal_nan=True)
    assert np.array_equal(found[0].mark, found[1].mark)
