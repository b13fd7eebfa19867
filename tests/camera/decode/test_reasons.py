"""Reasons of pixels without a position: a pixel made for each reason, and the order of reasons."""

import ast
import pickle
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from plain_decoder import decode_plain

from graycast.camera.decode import DecodeSpec, Mark, Reason, decode, levels_of, reason_shares
from graycast.camera.sensor import SensorSpec
from graycast.rig.pattern import gray, gray_line_shift, gray_phase, multi_frequency, xor_gray
from studies.projected import LEVELS, crisp, frames_of, share_of_white

SENSOR = SensorSpec(offset_dn=0.0, gain_dn_per_e=0.1, full_well_e=1e6, bit_depth=8)
USUAL = DecodeSpec()


def one_pixel(code, *, at=5, change=None, sensor=SENSOR, spec=USUAL, **levels):
    """Return the reason of a pixel that sees projector pixel (at, 3), with a changed stack."""
    stack = crisp(code, np.array([[at]]), np.array([[3]]), **levels)
    if change is not None:
        change(stack[:, 0, 0])
    codes = decode(stack, code, spec, levels_of(sensor))
    plain = decode_plain(stack.copy(), code, spec, levels_of(sensor))
    assert codes.reason[0, 0] == plain.reason[0, 0]
    reason = Reason(codes.reason[0, 0])
    assert np.isfinite(codes.column[0, 0]) == (reason == Reason.DECODED)
    return reason


def frame_index(code, axis, bit, inverse=False):
    wanted = (axis, bit, inverse)
    return [(f.axis, f.bit, f.inverse) for f in code.frames].index(wanted)


@pytest.mark.slow
def test_contrast_below_the_set_share_of_the_sensor_range_is_low_modulation():
    code = gray(32, 16)
    spec = DecodeSpec(min_contrast=0.1)  # 10 % of 255 DN is 25.5 DN.
    assert one_pixel(code, dark=50, bright=75, spec=spec) is Reason.LOW_MODULATION
    assert one_pixel(code, dark=50, bright=76, spec=spec) is Reason.DECODED


def test_contrast_below_min_sigmas_times_the_noise_is_low_modulation():
    """At 50 DN the noise is sqrt(0.1 * 50 + 0.17) = 2.27 DN, at 150 DN 3.89 DN: a share of the
    range would be one limit for both.
    """
    code = gray(32, 16)
    spec = DecodeSpec(min_contrast=0.001, min_sigmas=10.0)
    assert one_pixel(code, dark=50, bright=72, spec=spec) is Reason.LOW_MODULATION
    assert one_pixel(code, dark=50, bright=73, spec=spec) is Reason.DECODED
    assert one_pixel(code, dark=150, bright=188, spec=spec) is Reason.LOW_MODULATION
    assert one_pixel(code, dark=150, bright=189, spec=spec) is Reason.DECODED


def test_a_pixel_is_in_shadow_when_its_frames_differ_by_noise_only():
    """At 50 DN the noise is sqrt(0.1 * 50 + 0.17) = 2.27 DN; six times that is 13.6 DN."""
    code = gray(32, 16)
    assert one_pixel(code, dark=0, bright=0) is Reason.SHADOW
    assert one_pixel(code, dark=50, bright=63) is Reason.SHADOW
    assert one_pixel(code, dark=50, bright=64) is Reason.DECODED


def test_pure_noise_becomes_shadow_and_is_hardly_ever_decoded():
    code = gray_phase(256, 192, inverses=True)
    rng = np.random.default_rng(3)
    stack = frames_of(np.full((len(code.frames), 100, 200), 400.0), rng)
    reason = decode(stack, code, DecodeSpec(min_contrast=0.001), LEVELS).reason
    assert (reason == Reason.SHADOW).mean() > 0.99
    assert (reason == Reason.DECODED).mean() < 0.002


def test_a_phase_without_amplitude_has_low_modulation_even_if_its_gray_bits_are_bright():
    code = gray_phase(256, 192)

    def flatten(stack):
        for k, frame in enumerate(code.frames):
            if frame.kind == "phase":
                stack[k] = 110

    assert one_pixel(code) is Reason.DECODED
    assert one_pixel(code, change=flatten) is Reason.LOW_MODULATION


def test_a_pixel_that_sees_two_surfaces_is_contradictory_if_its_stripes_have_little_contrast():
    """Two phases, half a period apart, cancel each other while all bits are the same for both.

    A share f of the light is from the other position, so the stripes' contrast is 1 - 2 f.
    """
    code = gray_phase(256, 192, axes=("column",))

    def mixed(f):
        def change(stack):
            for k, frame in enumerate(code.frames):
                if frame.kind == "phase":
                    stack[k] = round(50 + (1 - 2 * f) * (int(stack[k]) - 50))

        return change

    spec = DecodeSpec(min_visibility=0.6)
    assert one_pixel(code, spec=spec) is Reason.DECODED
    for f, reason in ((0.15, Reason.DECODED), (0.25, Reason.INTERREFLECTION)):
        assert one_pixel(code, change=mixed(f), spec=spec, dark=0, bright=100) is reason
        assert one_pixel(code, change=mixed(f), dark=0, bright=100) is Reason.DECODED


WELL = SensorSpec(
    offset_dn=10.0, gain_dn_per_e=0.1003, full_well_e=1000.0, read_noise_e=0.1, bit_depth=8
)  # saturated at 110.26 DN, which the sensor stores as 110


@pytest.mark.parametrize(("sensor", "full"), [(SENSOR, 255), (WELL, 110)])
@pytest.mark.parametrize("inverses", [False, True])
def test_saturated_frames_alone_do_not_make_a_pixel_saturated(sensor, full, inverses):
    """White frame, coarse bit, phase-free: each bit is still clearly above or below its threshold.

    Pixel 96 is 1010000 in Gray code: its narrow stripes are dark.
    """
    code = gray(128, 16, axes=("column",), inverses=inverses)
    assert one_pixel(code, at=96, bright=full, sensor=sensor) is Reason.DECODED
    assert one_pixel(code, at=96, bright=full - 1, sensor=sensor) is Reason.DECODED
    for bright, mark in ((full, Mark.CLIPPED), (full - 1, Mark(0))):
        stack = crisp(code, np.array([[96]]), bright=bright)
        codes = decode(stack, code, USUAL, levels_of(sensor))
        assert Mark(codes.mark[0, 0]) == mark and codes.column[0, 0] == 96


@pytest.mark.parametrize("bit", range(7))
def test_a_gray_bit_is_saturated_only_if_its_inverse_is_saturated_too(bit):
    code = gray(128, 16, axes=("column",), inverses=True)
    pair = [frame_index(code, "column", bit, inverse) for inverse in (False, True)]

    def both(stack):
        stack[pair] = 255

    def the_lit_one(stack):
        stack[pair[int(stack[pair[1]] > stack[pair[0]])]] = 255

    assert one_pixel(code, change=both) is Reason.SATURATED
    assert one_pixel(code, change=the_lit_one) is Reason.DECODED


def test_a_pixel_is_saturated_if_a_narrow_stripe_without_an_inverse_is():
    """Saturated stripes hide the brightness of white, and blur moves narrow ones to its middle.

    A saturated white frame alone does not: the lit stripes show the brightness.
    """
    code = gray(128, 16, axes=("column",))
    assert one_pixel(code, at=97, bright=255) is Reason.SATURATED  # 1010001: its finest bit is lit

    def white(stack):
        stack[0] = 255

    assert one_pixel(code, at=97, change=white) is Reason.DECODED


def test_one_saturated_frame_makes_its_phase_saturated():
    code = gray_phase(256, 64, steps=8, inverses=True)

    def glare(kinds):
        def change(stack):
            lit = [k for k, f in enumerate(code.frames) if f.kind in kinds and stack[k] > 150]
            stack[lit] = 255

        return change

    assert one_pixel(code, change=glare(("white", "gray", "complementary"))) is Reason.DECODED
    for k, frame in enumerate(code.frames):
        if frame.kind == "phase":

            def one(stack, k=k):
                stack[k] = 255

            assert one_pixel(code, change=one) is Reason.SATURATED


def test_an_undecoded_pixel_is_saturated_only_if_a_frame_in_use_is_saturated():
    """A white frame is not used if there are inverses and phases, so it is no reason."""
    code = gray_phase(256, 64, steps=8, inverses=True)
    phases = [k for k, f in enumerate(code.frames) if f.kind == "phase"]

    def flat(stack):
        stack[phases] = 110

    def bright(stack):
        flat(stack)
        stack[0] = 255

    def glare(stack):
        flat(stack)
        stack[frame_index(code, "column", 0)] = 255

    assert one_pixel(code, change=flat) is Reason.LOW_MODULATION
    assert one_pixel(code, change=bright) is Reason.LOW_MODULATION
    assert one_pixel(code, change=glare) is Reason.SATURATED


@pytest.mark.parametrize("inverses", [False, True])
def test_bright_metal_is_decoded_if_only_its_gray_bits_are_saturated(inverses):
    """White light is 0.5 to 1.6 of the range; a lens out of focus lowers the peak of the phases to
    0.93 of white. Where no phase is saturated, all pixels are decoded, and correctly.
    """
    code = gray_phase(512, 384, inverses=inverses)
    u = np.linspace(8, 500, 400)[None].repeat(120, axis=0)
    white = LEVELS.range_dn * np.linspace(0.5, 1.6, 120)[:, None]
    light = 60 + white * share_of_white(code, u, disc_px=3.0)
    frames = np.minimum(frames_of(light, np.random.default_rng(2)), 4000)
    codes = decode(frames, code, USUAL, LEVELS)
    full = frames >= 4000
    phases = [k for k, f in enumerate(code.frames) if f.kind == "phase"]
    lost = full[phases].any(axis=0)
    shiny = full.any(axis=0) & ~lost
    assert shiny.mean() > 0.05  # earlier versions refused all of them
    assert (codes.reason[shiny] == Reason.DECODED).mean() > 0.999
    assert (codes.reason[lost] == Reason.SATURATED).all()
    off_px = np.abs(codes.column - u)[codes.reason == Reason.DECODED]
    assert off_px.max() < 1.0


@pytest.mark.parametrize("inverses", [False, True])
def test_two_doubtful_coarse_bits_contradict_but_one_bit_at_its_own_edge_does_not(inverses):
    """Pixel 127 is at the edge of bit 7 of 256 columns, where no other bit changes."""
    code = gray(256, 16, inverses=inverses)

    def doubt(*bits, axis="column"):
        def change(stack):
            for bit in bits:
                stack[frame_index(code, axis, bit)] = 110
                if inverses:
                    stack[frame_index(code, axis, bit, True)] = 110

        return change

    def one_of_each(stack):
        doubt(7)(stack)
        doubt(2, axis="row")(stack)

    assert one_pixel(code) is Reason.DECODED
    assert one_pixel(code, at=127, change=doubt(7)) is Reason.DECODED
    assert one_pixel(code, at=127, change=doubt(7, 3)) is Reason.CONTRADICTORY
    assert one_pixel(code, at=127, change=doubt(4, 7)) is Reason.CONTRADICTORY
    assert one_pixel(code, at=127, change=doubt(7, 2, 1, 0)) is Reason.DECODED  # Fine bits pass.
    assert one_pixel(code, at=127, change=one_of_each) is Reason.DECODED  # one edge per axis
    strict = DecodeSpec(fine_bits=0)
    assert one_pixel(code, at=127, change=doubt(1, 0), spec=strict) is Reason.CONTRADICTORY


def test_a_doubtful_coarse_bit_far_from_its_edges_is_interreflection():
    """If misread, it costs 2 |u - edge| columns. On the sea shell, four of five such pixels were
    wrong by columns, but only one in six of all pixels.
    """
    code = gray(256, 16)

    def doubt(stack):
        stack[frame_index(code, "column", 7)] = 110

    assert one_pixel(code, at=131, change=doubt) is Reason.DECODED
    assert one_pixel(code, at=132, change=doubt) is Reason.INTERREFLECTION
    assert one_pixel(code, at=5, change=doubt) is Reason.INTERREFLECTION


def test_a_doubtful_period_bit_is_refused_inside_a_period_but_not_at_its_border():
    """It may be in doubt at the border of a period, where the phase tells the side."""
    code = gray_phase(256, 64, period_px=16.0)

    def doubt(stack):
        stack[frame_index(code, "column", 0)] = 110

    assert one_pixel(code, at=40, change=doubt) is not Reason.DECODED
    assert one_pixel(code, at=16, change=doubt) is Reason.DECODED  # bit 0 changes there


@pytest.mark.slow
@pytest.mark.parametrize("inverses", [False, True])
def test_a_phase_up_to_an_eighth_of_a_period_outside_its_cell_is_decoded(inverses):
    """Cells are half a period, 8 px: a phase within 6 px of a cell's middle belongs to it.

    The Gray bits are unchanged and the cosines are moved, as by indirect light.
    """
    code = gray_phase(256, 64, period_px=16.0, inverses=inverses)
    phases = [k for k, frame in enumerate(code.frames) if frame.kind == "phase"]
    middle_px = 99.5  # for the cell from 95.5 to 103.5
    for off_px, reason in (
        (0.0, Reason.DECODED),
        (5.7, Reason.DECODED),
        (6.3, Reason.INTERREFLECTION),
        (7.7, Reason.INTERREFLECTION),
    ):
        for side in (-1, 1):
            stack = np.round(20 + 180 * share_of_white(code, np.array([[middle_px]]), disc_px=0))
            there = np.array([[middle_px + side * off_px]])
            moved = np.round(20 + 180 * share_of_white(code, there, disc_px=0))
            stack[phases] = moved[phases]
            codes = decode(stack.astype(np.uint8), code, USUAL, levels_of(SENSOR))
            assert Reason(codes.reason[0, 0]) is reason, (off_px, side)


@pytest.mark.parametrize(
    ("off_rad", "reason"), [(0.14, Reason.DECODED), (0.18, Reason.CONTRADICTORY)]
)
def test_phases_that_disagree_by_three_deviations_are_contradictory(off_rad, reason):
    """Deviations are 0.05 rad (model) and 0.016 rad (noise): three of them are 0.158 rad.

    The two longer periods are moved against the shortest, which gives the position in a period.
    """
    code, place, share = multi_frequency(512, 384), 200.3, []
    shortest_px = min(f.period_px for f in code.frames if f.kind == "phase")
    for frame in code.frames:
        if frame.kind != "phase":
            share.append(float(frame.kind == "white"))
            continue
        off = 0.0 if frame.period_px == shortest_px else off_rad
        turn = 2 * np.pi * (place / frame.period_px - frame.step / frame.steps) + off
        share.append(0.5 + 0.5 * np.cos(turn))
    stack = frames_of(60 + 3000 * np.array(share)[:, None, None])
    codes = decode(stack, code, USUAL, LEVELS)
    assert Reason(codes.reason[0, 0]) is reason


def test_a_code_word_without_a_projector_column_is_outside_the_projector():
    """20 columns need 5 bits, so 12 words belong to no column; 27 in Gray code is 10110."""
    code = gray(20, 16)

    def change(stack):
        for bit, value in zip((4, 3, 2, 1, 0), (1, 0, 1, 1, 0), strict=True):
            stack[frame_index(code, "column", bit)] = 200 if value else 20

    assert one_pixel(code, change=change) is Reason.OUTSIDE_PROJECTOR


def test_saturation_precedes_every_other_reason_for_a_pixel_without_a_position():
    """A pixel that is saturated in all frames has no contrast, but is not called shadow."""
    code = gray(256, 16)

    def change(stack):
        stack[:] = 255

    assert one_pixel(code, change=change) is Reason.SATURATED

    def glare(stack):
        stack[0] = 255
        stack[2:6] = 137

    assert one_pixel(code, change=glare) is Reason.SATURATED


# --- indirect light -----------------------------------------------------------------------------


def mirrored(code, u, *, ratio):
    """Two facing stripes: each point also receives, over a window 40 px wide, light meant for the
    position mirrored in the picture's middle, `ratio` times its own light.
    """
    mirror = code.width_px - 1 - u
    own = share_of_white(code, u, camera_px=0, disc_px=0)
    other = share_of_white(code, mirror, camera_px=40.0, disc_px=0)
    return 1000 * (own + ratio * other)


def coarse_bits_differ(u, width):
    """Whether a bit of stripes wider than the window differs at the mirrored position."""
    a, b = (np.rint(x).astype(int) for x in (u, width - 1 - u))
    return ((a ^ (a >> 1)) ^ (b ^ (b >> 1))) >> 6 > 0


def test_strong_interreflection_is_contradictory_at_pixels_whose_coarse_bits_differ():
    """Equal direct and indirect light cancel in a bit that differs at the two positions."""
    code = gray(512, 8, axes=("column",), inverses=True)
    u = np.arange(512.0)[None]
    inner = (u > 24) & (u < 488)  # nearer to the border, part of the window is dark
    own = np.abs(u - 255.5) < 20  # the window includes the position itself
    clash = coarse_bits_differ(u, 512) & inner & ~own
    codes = decode(frames_of(mirrored(code, u, ratio=1.0)), code, USUAL, LEVELS)
    assert clash.sum() > 400
    assert (codes.reason[clash] == Reason.INTERREFLECTION).all()
    # Pixels that are still decoded are correct.
    known = (codes.reason == Reason.DECODED) & inner
    assert known.sum() > 20
    assert np.array_equal(codes.column[known], u[known])


@pytest.mark.parametrize(("margin_dn", "reason"), [(12, "CONTRADICTORY"), (16, "DECODED")])
@pytest.mark.parametrize("at", [5, 20, 50])
def test_an_xor_bit_is_accepted_from_three_deviations_of_noise_upwards(at, margin_dn, reason):
    """At 110 DN a frame's variance is 0.1 * 110 + 0.17 DN^2; 3 deviations of a pair, 14.2 DN."""
    code, noise_alone = xor_gray(64, 48), replace(USUAL, doubt=0.0)

    def weaken(stack):
        for k, frame in enumerate(code.frames):
            if frame.xor_bit >= 0 and frame.bit in (3, 4):
                stack[k] = 110 + (margin_dn // 2 if stack[k] > 110 else -margin_dn // 2)

    assert one_pixel(code, at=at, change=weaken, spec=noise_alone) is Reason[reason]


@pytest.mark.parametrize(("margin_dn", "reason"), [(16, "INTERREFLECTION"), (20, "DECODED")])
@pytest.mark.parametrize("at", [5, 20, 50])
def test_a_weak_xor_bit_is_doubtful_far_from_its_own_edge(at, margin_dn, reason):
    """The limit is two thirds of 0.15 of a contrast of 180 DN: 18 DN; of noise, 14.2 DN."""
    code = xor_gray(64, 48)

    def weaken(stack):
        for k, frame in enumerate(code.frames):
            if frame.xor_bit >= 0 and frame.bit == 5:
                stack[k] = 110 + (margin_dn // 2 if stack[k] > 110 else -margin_dn // 2)

    assert one_pixel(code, at=at, change=weaken) is Reason[reason]


@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_a_doubtful_base_bit_of_an_xor_code_makes_its_pixel_doubtful(inverses, turned):
    """If misread, it inverts all bits combined with it, which shows no contradiction.

    Its frames are 16 of 180 DN apart, which is more than three deviations of the noise of a pair.
    """
    code = xor_gray(64, 48, inverses=inverses)
    first = frame_index(code, "column", 1)

    def weaken(stack):
        half = 8 if (stack[first] > 110) != turned else -8
        stack[first] = 110 + half
        if inverses:
            stack[frame_index(code, "column", 1, True)] = 110 - half

    assert one_pixel(code, at=20) is Reason.DECODED
    assert one_pixel(code, at=20, change=weaken) is Reason.CONTRADICTORY
    careless = replace(USUAL, doubt=0.0)
    noisy = inverses is False  # 16 DN from the threshold, whose own noise counts too
    expected = Reason.CONTRADICTORY if noisy else Reason.DECODED
    assert one_pixel(code, at=20, change=weaken, spec=careless) is expected


def test_indirect_light_stronger_than_direct_light_inverts_gray_bits_but_not_xor_bits():
    """Theory (Gupta et al. 2011): a point whose global light exceeds its direct light shows wide
    stripes as the other point does; narrow stripes arrive as half light in all patterns.
    """
    u = np.arange(512.0)[None]
    code = gray(512, 8, axes=("column",), inverses=True)
    plain = decode(frames_of(mirrored(code, u, ratio=2.0)), code, USUAL, LEVELS)
    code = xor_gray(512, 8)
    combined = decode(frames_of(mirrored(code, u, ratio=2.0)), code, USUAL, LEVELS)
    inner = slice(24, 488)  # nearer to the border, part of the window is dark
    wrong = ~(np.abs(plain.column - u) < 0.5)
    assert wrong[0, inner].mean() > 0.9
    assert np.array_equal(combined.column[0, inner], u[0, inner])


@pytest.mark.parametrize(("bits_shift_px", "harm"), [(1.9, False), (-1.9, False), (9.0, True)])
def test_gray_edges_displaced_by_an_eighth_of_a_period_cause_no_period_jump(bits_shift_px, harm):
    """The complementary bit is exact; the Gray bits are displaced, as by blur, interreflection or a
    tilted surface. The last case shows that the test can fail.
    """
    code = gray_phase(640, 48, period_px=16.0)
    u = np.linspace(20, 600, 3000)[None]
    light = 1500 * share_of_white(code, u)
    moved = 1500 * share_of_white(code, u + bits_shift_px)
    for k, frame in enumerate(code.frames):
        if frame.kind == "gray":
            light[k] = moved[k]
    codes = decode(frames_of(light), code, USUAL, LEVELS)
    off_px = np.abs(codes.column - u)
    known = codes.reason == Reason.DECODED
    if harm:
        assert (off_px[known] > 8).any() or known.mean() < 0.9
    else:
        assert known.mean() > 0.99
        assert off_px[known].max() < 0.1


# --- limits of a code ----------------------------------------------------------------------------


def test_ambiguous_periods_with_a_repeating_beat_are_contradictory_and_not_guessed():
    """The beat of 16 and 17 px is 272 px long: positions occur two or three times in 640 px."""
    base = gray_phase(640, 48, period_px=16.0, steps=4).frames
    frames = [f for f in base if f.kind == "phase"]
    frames += [replace(f, period_px=17.0) for f in frames]
    code = replace(gray_phase(640, 48), frames=tuple(frames))
    u = np.linspace(5, 634, 500)[None]
    codes = decode(frames_of(100 + 1500 * share_of_white(code, u)), code, USUAL, LEVELS)
    assert (codes.reason == Reason.CONTRADICTORY).all()
    narrow = replace(code, width_px=256)
    u = np.linspace(5, 250, 500)[None]
    codes = decode(frames_of(100 + 1500 * share_of_white(narrow, u)), narrow, USUAL, LEVELS)
    assert (codes.reason == Reason.DECODED).all()
    assert np.abs(codes.column - u).max() < 0.1


EDGE_CODES = {
    "gray": gray(512, 384),
    "gray with inverses": gray(512, 384, inverses=True),
    "gray, not a power of two": gray(500, 384),
    "phase": gray_phase(512, 384),
    "phase, period of 12": gray_phase(512, 384, period_px=12.0, inverses=True),
    "lines": gray_line_shift(512, 384),
    "three frequencies": multi_frequency(512, 384),
    "combined": xor_gray(512, 384),
}


@pytest.mark.parametrize("name", EDGE_CODES)
def test_a_pixel_at_the_border_is_never_decoded_to_the_opposite_border(name):
    """In a Gray code of 2^n columns, the first and the last differ in one bit. Half of such a pixel
    sees the projector, so all its frames are equally darker.
    """
    code = EDGE_CODES[name]
    rng = np.random.default_rng(4)
    last = code.width_px - 1
    u = np.concatenate([np.linspace(-2.5, 3, 56), np.linspace(last - 3, last + 2.5, 56)])
    u = np.repeat(u[None], 40, axis=0)
    light = 100 + 1500 * share_of_white(code, u, np.full(u.shape, 100.0))
    codes = decode(frames_of(light, rng), code, USUAL, LEVELS)
    off_px = np.abs(codes.column - u)
    assert np.nanmax(off_px) < 3
    inside = (u > 0.75) & (u < last - 0.75)
    least = 0.9 if name != "combined" else 0.85  # The base bit's edges cause doubts.
    assert (codes.reason[inside] == Reason.DECODED).mean() > least
    beyond = (u < -1.8) | (u > last + 1.8)
    assert not (codes.reason[beyond] == Reason.DECODED).any()


def test_the_page_on_formats_quotes_the_text_for_each_reason():
    """Numbers, names and meanings are in `Reason`; the page must not differ."""
    page = (Path(__file__).resolve().parents[3] / "docs/reference/formats.md").read_text(
        encoding="utf-8"
    )
    rows = re.findall(r"^\| (\d) \| `([A-Z_]+)` \| (.*) \|$", page, re.MULTILINE)
    assert rows == [(str(int(r)), r.name, r.meaning) for r in Reason]


def test_the_colours_for_reasons_are_clearly_different():
    """An eye distinguishes a distance of 30 (of at most 442) in RGB in a map next to its legend."""
    color = np.array([to_rgb(reason.color) for reason in Reason]) * 255
    apart = np.linalg.norm(color[:, None] - color[None], axis=-1)
    assert apart[~np.eye(len(color), dtype=bool)].min() > 30


def test_a_reason_is_saved_pickled_and_compiled_as_its_number():
    """Files have numbers, pickles go to other processes, and kernels use whole numbers."""
    for reason in Reason:
        assert Reason(int(reason)) is reason is pickle.loads(pickle.dumps(reason))
        assert np.uint8(reason) == reason == Reason[reason.name]
    shares = reason_shares(np.array([[0, 0, 8, 1]], np.uint8))
    assert [name for name, share in shares.items() if share] == ["decoded", "shadow", "outlier"]
    assert sum(shares.values()) == 1


def setters_of_reasons():
    """Return the functions, as module.function, that give a pixel each reason but DECODED."""
    setters = defaultdict(set)
    camera = Path(__file__).parents[3] / "src/graycast/camera"
    for path in [*camera.glob("decode/*.py"), camera / "stack/believed_depth.py"]:
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(function, ast.FunctionDef):
                continue
            # Only these expressions read a reason; all others give it to a pixel.
            readers = [
                node.slice if isinstance(node, ast.Subscript) else node
                for node in ast.walk(function)
                if isinstance(node, ast.Compare | ast.Subscript)
                or (isinstance(node, ast.Call) and ast.unparse(node.func) == "np.isin")
            ]
            read = {id(inner) for node in readers for inner in ast.walk(node)}
            for node in ast.walk(function):
                if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "Reason":
                    if node.attr.isupper() and id(node) not in read:
                        setters[node.attr].add(f"{path.stem}.{function.name}")
                elif isinstance(node, ast.Name) and node.id in Reason.__members__:
                    setters[node.id].add(f"{path.stem}.{function.name}")
    setters.pop("DECODED")
    return dict(setters)


def test_the_docstring_names_the_functions_that_set_each_reason():
    table = Reason.__doc__[Reason.__doc__.index("    SHADOW") :]
    rows = re.split(r"\b([A-Z_]{5,})\b", table)[1:]
    named = {
        name: set(re.findall(r"[a-z_]+\.[a-z_]+", functions))
        for name, functions in zip(rows[::2], rows[1::2], strict=True)
    }
    assert named == setters_of_reasons()
