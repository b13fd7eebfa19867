"""Gray code: its defining properties, a table by hand, and the order of the stack."""

import numpy as np
import pytest

from graycast.rig.pattern import gray, gray_from_binary


def bits_of(code, axis):
    """Return the code word of every projector pixel along an axis, read from the pictures."""
    word = 0
    for frame, picture in zip(code.frames, code.render(), strict=True):
        if frame.kind == "gray" and frame.axis == axis and not frame.inverse:
            line = picture[0] if axis == "column" else picture[:, 0]
            word = word * 2 + (line > 127).astype(int)
    return word


def test_eight_columns_have_the_code_words_of_gray_s_patent():
    """The reflected code by hand: 000 001 011 010 110 111 101 100."""
    code = gray(8, 2, axes=("column",))
    pictures = code.render()[2:] // 255
    assert pictures[:, 0].tolist() == [
        [0, 0, 0, 0, 1, 1, 1, 1],
        [0, 0, 1, 1, 1, 1, 0, 0],
        [0, 1, 1, 0, 0, 1, 1, 0],
    ]


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (1024, 768), (5, 3), (2, 2), (1025, 9)])
@pytest.mark.parametrize("axis", ["column", "row"])
def test_neighbouring_code_words_differ_in_one_bit_and_no_word_occurs_twice(width, height, axis):
    code = gray(width, height)
    word = bits_of(code, axis)
    assert len(word) == {"column": width, "row": height}[axis]
    assert len(set(word.tolist())) == len(word)
    step = word[1:] ^ word[:-1]
    assert (np.bitwise_count(step) == 1).all()


def test_neighbouring_integers_of_any_type_differ_in_one_gray_code_bit():
    word = gray_from_binary(np.arange(2**16))
    assert (np.bitwise_count(word[1:] ^ word[:-1]) == 1).all()
    assert np.array_equal(np.sort(word), np.arange(2**16))


@pytest.mark.parametrize(
    ("size", "bits"), [(2, 1), (3, 2), (4, 2), (5, 3), (1024, 10), (1025, 11), (1280, 11)]
)
def test_an_axis_uses_the_fewest_bits_that_distinguish_its_pixels(size, bits):
    code = gray(size, 2)
    assert sum(frame.axis == "column" for frame in code.frames) == bits
    assert 2 ** (bits - 1) < size <= 2**bits


def test_frames_begin_with_white_and_black_and_then_run_from_coarse_to_fine_bits():
    names = [frame.name for frame in gray(8, 4).frames]
    assert names == [
        "white",
        "black",
        "column_bit02",
        "column_bit01",
        "column_bit00",
        "row_bit01",
        "row_bit00",
    ]


def test_each_inverse_follows_its_pattern_and_is_its_complement():
    code = gray(10, 6, axes=("row", "column"), inverses=True)
    pictures = code.render()
    assert [frame.name for frame in code.frames[2:4]] == ["row_bit02", "row_bit02_inverse"]
    assert code.frames[-1].name == "column_bit00_inverse"
    assert np.array_equal(pictures[2::2], 255 - pictures[3::2])
    assert len({frame.name for frame in code.frames}) == len(code.frames)


def test_rendered_frames_begin_with_white_and_black_and_have_two_levels():
    pictures = gray(7, 5).render()
    assert pictures.dtype == np.uint8
    assert pictures.shape == (2 + 3 + 3, 5, 7)
    assert (pictures[0] == 255).all()
    assert (pictures[1] == 0).all()
    assert set(np.unique(pictures)) == {0, 255}


def test_column_patterns_have_vertical_stripes_and_row_patterns_horizontal_stripes():
    code = gray(9, 6)
    for frame, picture in zip(code.frames[2:], code.render()[2:], strict=True):
        along = picture if frame.axis == "column" else picture.T
        assert (along == along[0]).all()
        assert along[0].min() < along[0].max()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width_px": 1, "height_px": 8}, "1 x 8 px"),
        ({"width_px": 8, "height_px": 8, "axes": ()}, "column, row or both"),
        ({"width_px": 8, "height_px": 8, "axes": ("row", "row")}, "each once"),
    ],
)
def test_an_impossible_gray_code_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        gray(**settings)
