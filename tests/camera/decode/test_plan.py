"""Lists of frames that no decoder can read, each refused by name before a pixel is looked at."""

from dataclasses import replace

import pytest

from graycast.base.errors import DecodeError
from graycast.camera.decode import DecodeSpec, Levels
from graycast.camera.decode.plan import plan_axes
from graycast.rig.pattern import gray, gray_phase, micro_phase, multi_frequency, xor_gray

GRAY = gray(64, 48, axes=("column",), inverses=True)
PHASE = gray_phase(128, 96, period_px=16.0, steps=4, inverses=True)


def without(code, test):
    return replace(code, frames=tuple(f for f in code.frames if not test(f)))


def bit_is(bit, inverse):
    return lambda f: f.kind == "gray" and f.bit == bit and f.inverse == inverse


def is_complementary(f):
    return f.kind == "complementary"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            without(GRAY, lambda f: f.bit == 5),
            "5 Gray bits of 1 px reach 32 px, the projector has 64: add the coarsest bit",
        ),
        (without(GRAY, bit_is(3, False)), "bit 3 has an inverse but no frame of its own"),
        (
            without(GRAY, lambda f: f.bit == 3),
            "Gray bit 3 is missing between finer and coarser bits",
        ),
        (
            without(xor_gray(64, 48, inverses=False), bit_is(1, False)),
            "Gray bit 1 is missing between finer and coarser bits|"
            "which the code must also have uncombined",
        ),
        (
            without(xor_gray(64, 48, base_bit=0, inverses=False), bit_is(0, False)),
            "bit 5 is combined with bit 0, which the code must also have uncombined",
        ),
        (
            without(PHASE, is_complementary),
            "Gray values 16 px wide cannot count the phases of period 16 px, which repeat every 16 "
            "px: add a complementary bit",
        ),
        (
            without(PHASE, lambda f: is_complementary(f) and not f.inverse),
            "the complementary bit has an inverse frame but no frame of its own",
        ),
        (
            without(PHASE, lambda f: f.kind == "gray"),
            "the code has a complementary bit but no Gray bits: add the Gray bits",
        ),
        (replace(PHASE, stride_px=(32.0, 32.0)), "stride_px must be the period"),
        (
            replace(
                PHASE,
                frames=tuple(
                    replace(f, period_px=30.0) if is_complementary(f) else f for f in PHASE.frames
                ),
                stride_px=(30.0, 30.0),
            ),
            "Gray values 15 px wide cannot count the phases of period 16 px",
        ),
        (
            replace(
                PHASE,
                frames=(
                    *PHASE.frames,
                    *(f for f in gray_phase(128, 96, period_px=32.0).frames if is_complementary(f)),
                ),
            ),
            "more than one complementary bit",
        ),
        (
            without(PHASE, lambda f: f.kind == "phase" and f.step == 2),
            "period 16 px lacks step 2 of 4",
        ),
        (
            without(multi_frequency(128, 96), lambda f: f.kind == "phase" and f.step > 0),
            "no period has all its steps; give at least one period with all its",
        ),
        (
            without(PHASE, lambda f: f.kind in ("gray", "complementary")),
            "the phases of period 16 px repeat within the projector's 128 px",
        ),
    ],
)
def test_the_error_for_undecodable_frames_names_the_missing_ones(code, message):
    with pytest.raises(DecodeError, match=message):
        plan_axes(code, fine_bits=3)


@pytest.mark.parametrize("code", [GRAY, PHASE, multi_frequency(128, 96), micro_phase(128, 96)])
def test_every_built_in_code_can_be_decoded(code):
    assert set(plan_axes(code, fine_bits=3)) == {"column"}


def test_a_gray_bit_counts_against_a_pixel_only_if_misreading_it_costs_much():
    """Plain code: the three finest. With a phase: those that cost less than half a period."""
    assert [b.counts for b in plan_axes(GRAY, 3)["column"].bits] == [True] * 3 + [False] * 3
    assert all(b.counts for b in plan_axes(PHASE, 3)["column"].bits)
    phase = tuple(f for f in PHASE.frames if f.kind == "phase")
    fine = gray(128, 96, axes=("column",))
    plan = plan_axes(replace(fine, frames=(*fine.frames, *phase)), 0)["column"]
    assert [b.counts for b in plan.bits] == [True] * 4 + [False] * 3
    assert plan.reach * plan.cell_px == 8.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_contrast", 0.0),
        ("min_contrast", 1.0),
        ("min_sigmas", -1.0),
        ("doubt", -0.1),
        ("doubt", 1.0),
        ("fine_bits", -1),
    ],
)
def test_impossible_decode_settings_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        DecodeSpec(**{name: value})


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"saturation_dn": 10.0}, "saturation_dn must be greater than offset_dn"),
        ({"floor_dn2": 0.0}, "the floor is positive"),
        ({"slope_dn": -0.1}, "the slope not negative"),
    ],
)
def test_impossible_sensor_levels_are_refused(words, message):
    usual = {"offset_dn": 10.0, "saturation_dn": 255.0, "floor_dn2": 1.0, "slope_dn": 0.1}
    with pytest.raises(ValueError, match=message):
        Levels(**usual | words)
