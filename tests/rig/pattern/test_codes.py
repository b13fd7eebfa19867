"""Phases, lines, combinations: laws of the frames on which a decoder may rely."""

import numpy as np
import pytest
from PIL import Image

from graycast.rig.pattern import (
    CODECS,
    Code,
    CodeSpec,
    Frame,
    gray,
    gray_line_shift,
    gray_phase,
    level_share,
    micro_phase,
    multi_frequency,
    write_pngs,
    xor_gray,
)


def shares(code, axis, kind):
    """Return the share of light of each frame of a kind along an axis."""
    i = 0 if axis == "column" else 1
    return [
        level_share(
            frame,
            code.size_px(axis),
            offset_px=code.offset_px[i],
            stride_px=code.stride_px[i],
        )
        for frame in code.frames
        if frame.axis == axis and frame.kind == kind and not frame.inverse
    ]


@pytest.mark.parametrize("axis", ["column", "row"])
@pytest.mark.parametrize("steps", [3, 4, 8])
def test_phase_steps_average_to_half_light_and_cover_one_full_turn(axis, steps):
    code = gray_phase(200, 150, axes=(axis,), period_px=20.0, steps=steps)
    share = np.array(shares(code, axis, "phase"))
    assert np.allclose(share.mean(axis=0), 0.5)
    delta = 2 * np.pi * np.arange(steps) / steps
    z = (share * np.exp(1j * delta)[:, None]).sum(axis=0)
    turn = np.angle(z) / (2 * np.pi)
    u = np.arange(code.size_px(axis))
    off = u / 20 - turn
    assert np.abs(off - np.round(off)).max() < 1e-12
    assert np.allclose(np.abs(z), steps / 4)  # amplitude 1/2


def test_line_shift_patterns_light_each_pixel_once_per_period():
    code = gray_line_shift(50, 10, period_px=8.0)
    share = np.array(shares(code, "column", "line"))
    assert share.shape == (8, 50)
    assert (share.sum(axis=0) == 1).all()
    assert (share[:, 8:] == share[:, :-8]).all()
    assert share[3, 3] == share[3, 11] == 1


def test_the_complementary_bit_changes_only_in_the_middle_of_every_period():
    """The Gray bits change at the borders of periods, so both never change at one position."""
    code = gray_phase(160, 120, period_px=16.0)
    (complementary,) = shares(code, "column", "complementary")
    gray_bits = np.array(shares(code, "column", "gray"))
    turns = np.flatnonzero(np.diff(complementary)) + 1
    assert turns.tolist() == list(range(8, 160, 16))
    borders = np.flatnonzero(np.abs(np.diff(gray_bits, axis=1)).sum(axis=0)) + 1
    assert borders.tolist() == list(range(16, 160, 16))


@pytest.mark.parametrize("period_px", [16.0, 20.0])
def test_phases_at_three_frequencies_are_unique_for_each_position(period_px):
    """This includes both ends of the axis; 0.4 rad is ten sigmas of a typical phase."""
    code = multi_frequency(640, 480, period_px=period_px)
    periods = sorted({frame.period_px for frame in code.frames if frame.kind == "phase"})
    assert len(periods) == 3 and periods[0] == pytest.approx(period_px)
    first = np.arange(-0.5, period_px, 0.5)[:, None, None]
    u = first + period_px * np.arange(40)  # all positions of one phase of the first period
    inside = u < 639.5
    apart = 0.0
    for period in periods[1:]:
        turns = u / period - np.swapaxes(u, 1, 2) / period
        apart = np.maximum(apart, 2 * np.pi * np.abs(turns - np.round(turns)))
    pair = inside & np.swapaxes(inside, 1, 2) & ~np.eye(40, dtype=bool)
    assert apart[pair].min() > 0.4


@pytest.mark.parametrize("base", [0, 1, 2])
def test_stripes_of_an_xor_code_are_at_most_as_wide_as_its_base_stripes(base):
    """Two pixels per stripe in XOR-02, four in XOR-04, as in their names; eight for our bit 2."""
    code = xor_gray(256, 192, base_bit=base)
    widest = []
    for share in shares(code, "column", "gray"):
        edges = np.flatnonzero(np.diff(share))
        widest.append(np.diff(edges).max())
    assert max(widest) == 2 ** (base + 1)


def test_the_periods_of_micro_phase_shifting_differ_by_less_than_a_seventh():
    code = micro_phase(640, 480, period_px=16.0)
    periods = {frame.period_px for frame in code.frames if frame.kind == "phase"}
    assert len(periods) == 6
    assert max(periods) / 16 < 8 / 7 and min(periods) / 16 > 7 / 8
    assert len(code.frames) == 2 + 3 + 5


def test_offset_and_stride_set_the_projector_columns_of_a_code():
    """Value 0 starts at pixel 5, and each value is three pixels wide; bit 0 is 0 1 1 0 0 1 1 0."""
    frame = Frame(kind="gray", axis="column", bit=0)
    share = level_share(frame, 23, offset_px=5.0, stride_px=3.0)
    assert share[5:].tolist() == [0] * 3 + [1] * 6 + [0] * 6 + [1] * 3


def test_patterns_compensate_for_the_projector_s_response():
    code = gray_phase(64, 8, steps=4)
    squared = code.render(lambda share: np.round(255 * np.sqrt(share)).astype(np.uint8))
    light = (squared / 255.0) ** 2
    assert np.abs(light - code.render() / 255.0).max() < 1.5 / 255


def test_pattern_files_are_numbered_in_the_order_of_projection(tmp_path):
    code = gray_phase(40, 30, axes=("row",), inverses=True)
    paths = list(write_pngs(code, tmp_path))
    assert len({p.name for p in paths}) == len(code.frames)
    assert [p.name for p in paths] == sorted(p.name for p in tmp_path.iterdir())
    for path, picture in zip(paths, code.render(), strict=True):
        assert np.array_equal(np.asarray(Image.open(path)), picture)


@pytest.mark.parametrize("codec", CODECS)
def test_every_codec_has_a_name_and_accepts_its_own_options(codec):
    code = CodeSpec(codec=codec, axes=("row",)).code(320, 240)
    assert code.axes == ("row",)
    assert (code.width_px, code.height_px) == (320, 240)
    assert len({frame.name for frame in code.frames}) == len(code.frames)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"codec": "gray", "steps": 4}, "gray has no steps; it takes axes, inverses"),
        ({"codec": "micro_phase", "base_bit": 1}, "micro_phase has no base_bit"),
    ],
)
def test_a_codec_refuses_options_of_other_codecs(words, message):
    with pytest.raises(ValueError, match=message):
        CodeSpec(**words)


WHITE = Frame(kind="white")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: xor_gray(320, 240, base_bit=20), "base_bit is 20; the code has bits 0 to 8"),
        (lambda: Frame(kind="gray", bit=1), "has axis None"),
        (lambda: Frame(kind="gray", axis="column"), "bit -1; give 0 .the finest bit. to 23"),
        (lambda: Frame(kind="gray", axis="row", bit=3, xor_bit=24), "xor_bit 24"),
        (lambda: Frame(kind="phase", axis="row", period_px=1.0), "period_px 1.0; give at least 2"),
        (
            lambda: Frame(kind="phase", axis="row", period_px=9.0, steps=2),
            "steps 2; give at least 3",
        ),
        (
            lambda: Frame(kind="phase", axis="row", period_px=9.0, steps=4, step=4),
            "step 4; give at least 0 and less than its steps, which is 4",
        ),
        (
            lambda: Frame(kind="phase", axis="row", period_px=9.0, steps=4, inverse=True),
            "has no inverse",
        ),
        (lambda: Frame(kind="line", axis="row", period_px=9.0, steps=4), "steps is 4, period_px 9"),
        (lambda: Code(width_px=8, height_px=8, frames=(WHITE,)), "no frame carries a code"),
        (lambda: Code(width_px=8, height_px=8, frames=gray(8, 8).frames * 2), "white occurs twice"),
        (
            lambda: Code(width_px=8, height_px=8, frames=gray(8, 8).frames, stride_px=(0.0, 1.0)),
            "stride_px is .0.0, 1.0.",
        ),
        (lambda: multi_frequency(40, 30, period_px=16.0), "3.5 periods of 16.0 px"),
        (lambda: gray_phase(16, 12, period_px=16.0), "one period spans all pixels"),
        (lambda: gray_line_shift(64, 8, period_px=7.5), "period_px is 7.5; give a whole number"),
    ],
)
def test_impossible_frames_and_codes_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
