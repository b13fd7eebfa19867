"""The fast decoder agrees with the plain one: all codes, valid and random stacks, 8 and 16 bit."""

import numpy as np
import pytest
from plain_decoder import decode_plain

from graycast.camera.decode import DecodeSpec, Levels, bits, decode, phases, positions
from graycast.rig.pattern import (
    gray,
    gray_line_shift,
    gray_phase,
    micro_phase,
    multi_frequency,
    xor_gray,
)
from studies.projected import LEVELS, two_phases

BOTH = ("column", "row")
GRAY = {
    "both axes": gray(37, 22),
    "inverses": gray(37, 22, inverses=True),
    "columns": gray(64, 8, axes=("column",)),
    "rows": gray(5, 300, axes=("row",), inverses=True),
    "rows first": gray(9, 17, axes=("row", "column")),
    "xor": xor_gray(64, 48, axes=BOTH),
    "xor, no inverses": xor_gray(64, 48, base_bit=0, inverses=False),
}
PHASE = {
    "phase": gray_phase(70, 50, axes=BOTH),
    "two phases": two_phases(150, 90, gray_cell_px=25.0, periods_px=(50 / 3, 25.0)),
    "three steps": gray_phase(70, 50, steps=3, period_px=20.0, inverses=True),
    "lines": gray_line_shift(70, 50, axes=("row",)),
    "three frequencies": multi_frequency(90, 70, axes=BOTH, period_px=10.0),
    "micro": micro_phase(90, 70, axes=BOTH),
}
LEVELS_8 = Levels(offset_dn=0.0, saturation_dn=255.0, floor_dn2=0.17, slope_dn=0.1)


def half_nonsense(code, levels, dtype):
    """Return a stack with valid codes in 70 % of the pixels, and random values elsewhere."""
    rng = np.random.default_rng(7)
    h, w, n = 23, 31, len(code.frames)
    top = levels.saturation_dn
    stack = rng.integers(0, int(top) + 1, (n, h, w)).astype(dtype)
    place = rng.integers(0, code.height_px, (h, w)), rng.integers(0, code.width_px, (h, w))
    true = code.render()[:, place[0], place[1]] / 255
    light = 0.05 * top + rng.uniform(0, 1, (h, w)) * top * true
    true = np.clip(light + rng.normal(0, 0.02 * top, (n, h, w)), 0, top)
    use_true = rng.random((h, w)) < 0.7
    stack[:, use_true] = true[:, use_true].astype(dtype)
    return stack


SPECS = (
    DecodeSpec(),
    DecodeSpec(min_contrast=0.3, doubt=0.5, fine_bits=0),
    DecodeSpec(min_contrast=0.01, min_sigmas=40.0),
    DecodeSpec(min_contrast=0.01, min_visibility=0.6),
)


@pytest.mark.parametrize("name", GRAY)
@pytest.mark.parametrize(("levels", "dtype"), [(LEVELS_8, np.uint8), (LEVELS, np.uint16)])
def test_plain_and_compiled_decoders_read_equal_gray_code_bits(name, levels, dtype):
    code = GRAY[name]
    stack = half_nonsense(code, levels, dtype)
    for spec in SPECS:
        fast, plain = (f(stack.copy(), code, spec, levels) for f in (decode, decode_plain))
        assert len(np.unique(plain.reason)) >= 3
        for field in ("column", "row", "modulation", "reason", "mark"):
            a, b = getattr(fast, field), getattr(plain, field)
            assert a.dtype == b.dtype
            assert np.array_equal(a, b, equal_nan=field not in ("reason", "mark"))
        for field in ("sigma_column", "sigma_row"):
            a, b = getattr(fast, field), getattr(plain, field)
            np.testing.assert_allclose(a, b, rtol=1e-5)


@pytest.mark.parametrize("name", PHASE)
@pytest.mark.parametrize(("levels", "dtype"), [(LEVELS_8, np.uint8), (LEVELS, np.uint16)])
def test_plain_and_compiled_decoders_agree_about_phases_to_single_precision(name, levels, dtype):
    """The fast one computes in float32, in which a position of 90 px is precise to 1e-5 px."""
    code = PHASE[name]
    stack = half_nonsense(code, levels, dtype)
    for spec in SPECS:
        fast, plain = (f(stack.copy(), code, spec, levels) for f in (decode, decode_plain))
        assert len(np.unique(plain.reason)) >= 3
        assert np.array_equal(fast.reason, plain.reason)
        assert np.array_equal(fast.mark, plain.mark)
        np.testing.assert_allclose(fast.modulation, plain.modulation, rtol=1e-4, atol=1e-6)
        for field in ("column", "row"):
            a, b = getattr(fast, field), getattr(plain, field)
            np.testing.assert_allclose(a, b, atol=2e-4)
            sigma = "sigma_" + field
            np.testing.assert_allclose(getattr(fast, sigma), getattr(plain, sigma), rtol=1e-3)


def test_the_memory_order_of_a_stack_does_not_change_its_decoding():
    code = gray(37, 22)
    stack = half_nonsense(code, LEVELS_8, np.uint8)
    turned = np.asfortranarray(stack)
    a, b = (decode(s, code, DecodeSpec(), LEVELS_8) for s in (stack, turned))
    assert np.array_equal(a.column, b.column, equal_nan=True)


def test_decoding_compiles_its_kernels_once_for_each_data_type():
    """Read-only stacks, or those of one or several periods, need no version of their own; each
    costs seconds in a fresh installation."""
    for name in ("phase", "three frequencies"):
        for dtype, levels in ((np.uint8, LEVELS_8), (np.uint16, LEVELS)):
            stack = half_nonsense(PHASE[name], levels, dtype)
            decode(stack, PHASE[name], DecodeSpec(), levels)
            stack.flags.writeable = False
            decode(stack, PHASE[name], DecodeSpec(), levels)
    kernels = [phases.read_phases, bits.read_gray, bits.lose_bits, bits._read_bits]
    kernels += [positions._range, positions._range_row, positions._reach]
    for kernel in kernels:
        types = [str(signature[0].dtype) for signature in kernel.signatures]
        assert len(types) == len(set(types)), kernel
    assert len(phases.fuse.signatures) == 1
