"""Test the input of networks: metric scale, kept proportions and separate holes."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.dataset.read.example import Example
from graycast.learn.detect.encoding import Encoding, encoding_from, fitting_size, noisy

SIZE = (64, 96)


def deep(**changed):
    settings = {"input": "depth_sl", "size_px": SIZE, "near_m": 0.5, "far_m": 1.0, "relief": False}
    return Encoding(**(settings | changed))


def scan(depth_m):
    return Example(scene_id=0, scanner_depth_m=depth_m.astype(np.float32))


def test_encoded_depth_does_not_depend_on_other_objects_in_the_picture():
    """Oracle: the encoding is linear in distance between its limits, equally in every picture."""
    for rest_m in (0.55, 0.7, 0.95, np.nan):
        depth_m = np.full(SIZE, rest_m)
        depth_m[10, 20], depth_m[11, 20], depth_m[12, 20] = 0.5, 0.625, 1.0
        channels = deep().encode(scan(depth_m), seed=0)
        np.testing.assert_allclose(channels[0, 10:13, 20], [-1.0, -0.5, 1.0], atol=1e-6)


def test_a_reduced_picture_has_the_mean_and_the_share_of_known_pixels():
    """Oracle: of four pixels three are at z and one is a hole, so the share is 3/4."""
    depth_m = np.full((128, 192), 0.75 + 0.125)  # encoded 0.5
    depth_m[0::2, 0::2] = np.nan
    height, share = deep().encode(scan(depth_m), seed=0)
    np.testing.assert_allclose(share, 0.75, atol=1e-6)
    np.testing.assert_allclose(height / share, 0.5, atol=1e-5)


@pytest.mark.parametrize(("holes", "value"), [("zero", -1.0), ("far", 1.0), ("channel", 0.0)])
def test_a_hole_gets_the_chosen_value(holes, value):
    depth_m = np.full(SIZE, 0.8)
    depth_m[5:9, 7:9] = np.nan
    channels = deep(holes=holes).encode(scan(depth_m), seed=0)
    np.testing.assert_allclose(channels[0, 5:9, 7:9], value, atol=1e-6)
    assert channels[0, 20, 20] == pytest.approx(0.2, abs=1e-5)
    assert len(channels) == (2 if holes == "channel" else 1)
    if holes == "channel":
        assert channels[1, 6, 7] == 0 and channels[1, 20, 20] == 1


def test_relief_is_the_height_above_the_neighbourhood():
    """A plane has no relief, raised areas have positive relief, and holes have no effect."""
    depth_m = np.full(SIZE, 0.8)
    depth_m[40:, :] = np.nan
    flat = deep(relief=True).encode(scan(depth_m), seed=0)[2]
    np.testing.assert_allclose(flat, 0.0, atol=1e-5)
    depth_m[20:23, 50:53] -= 0.01
    risen = deep(relief=True).encode(scan(depth_m), seed=0)[2]
    assert risen[21, 51] > 0.2
    assert risen[21, 48] < 0 and risen[50, 51] == 0


def test_colours_are_scaled_as_published_backbones_require():
    rgb = np.zeros((*SIZE, 3), np.uint8)
    rgb[:, :] = (255, 0, 128)
    channels = Encoding(input="rgb", size_px=SIZE).encode(Example(scene_id=0, rgb=rgb), seed=0)
    mean, deviation = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
    np.testing.assert_allclose(
        channels[:, 3, 3], (np.array([1, 0, 128 / 255]) - mean) / deviation, rtol=1e-5
    )


def test_a_picture_of_another_shape_keeps_its_proportions_in_the_corner():
    """Oracle: 60 x 100 pixels into 64 x 96 are 58 x 96; what remains is empty."""
    encoding = deep()
    channels = encoding.encode(scan(np.full((60, 100), 0.6)), seed=0)
    assert encoding.scale((60, 100)) == pytest.approx(0.96)
    assert (channels[1, :58, :] == 1).all() and (channels[1, 58:] == 0).all()


@pytest.mark.parametrize(
    ("picture", "longest", "size"),
    [((772, 1032), 320, (256, 320)), ((386, 516), 384, (288, 384)), ((100, 100), 33, (64, 64))],
)
def test_the_input_s_sides_are_multiples_of_32(picture, longest, size):
    assert fitting_size(picture, longest) == size


def test_noisy_depth_has_the_stated_noise_and_holes():
    """Oracle: discs of 5 % of the area that may overlap cover 1 - exp(-0.05); sigma is 1 mm."""
    depth_m = np.full((800, 1000), 0.8, np.float32)
    rough = noisy(depth_m, seed=3)
    hole = np.isnan(rough)
    assert hole.mean() == pytest.approx(1 - math.exp(-0.05), rel=0.08)
    assert np.std(rough[~hole] - 0.8) == pytest.approx(1e-3, rel=0.01)
    assert not np.array_equal(rough, noisy(depth_m, seed=4), equal_nan=True)


def test_two_pictures_with_the_same_seed_have_different_noise_and_holes():
    """Symptom: picture 40 of a training had the noise of scene 40 of its validation, and all images
    of a scene had the same noise.
    """
    near, far = (np.full((120, 160), z_m, np.float32) for z_m in (0.6, 0.7))
    a, b = noisy(near, seed=40) - near, noisy(far, seed=40) - far
    both = np.isfinite(a) & np.isfinite(b)
    assert abs(np.corrcoef(a[both], b[both])[0, 1]) < 4 / np.sqrt(both.sum())
    share = np.isnan(a).mean() * np.isnan(b).mean()
    assert (np.isnan(a) & np.isnan(b)).mean() < 5 * share
    np.testing.assert_array_equal(noisy(near, seed=40) - near, a)


def test_an_encoding_is_read_back_from_json():
    encoding = deep(holes="far", relief=True)
    assert encoding_from({**asdict(encoding), "size_px": list(SIZE)}) == encoding


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"input": "xray"}, "input is 'xray': choose one of rgb"),
        ({"holes": "none"}, "holes is 'none'"),
        ({"size_px": (60, 96)}, "a multiple of 32"),
        ({"near_m": None}, "the depth's range is None to 1.0 m"),
        ({"near_m": 2.0}, "0 < near < far"),
    ],
)
def test_an_impossible_encoding_is_refused(changed, message):
    with pytest.raises(GraycastError, match=message.replace("'", ".")):
        deep(**changed)


def test_a_missing_picture_is_named():
    with pytest.raises(GraycastError, match="scene 0 has no scanner depth"):
        deep().encode(Example(scene_id=0), seed=0)


def test_the_scanner_s_depth_is_used_if_there_is_no_perfect_depth():
    """The scanner's depth gets no added noise, and it is not read if perfect depth exists."""
    depth_m = np.full(SIZE, 0.8, np.float32)
    both = Example(scene_id=0, depth_m=depth_m - 0.1, scanner_depth_m=depth_m)
    real = scan(depth_m)
    for name in ("depth", "depth_noisy"):
        np.testing.assert_allclose(deep(input=name).encode(real, seed=0)[0], 0.2, atol=1e-6)
    np.testing.assert_allclose(deep(input="depth").encode(both, seed=0)[0], -0.2, atol=1e-6)


def test_the_channel_p_wrong_is_logarithmic_and_zero_in_holes():
    p_wrong = np.full(SIZE, 1e-4, np.float32)
    p_wrong[0, :4] = [1.0, 0.01, 1e-6, np.nan]
    example = Example(scene_id=0, scanner_depth_m=np.full(SIZE, 0.8, np.float32), p_wrong=p_wrong)
    encoding = deep(p_wrong=True, relief=True)
    channels = encoding.encode(example, seed=0)
    assert len(channels) == encoding.channels == 4
    np.testing.assert_allclose(channels[3, 0, :5], [0, 0.5, 1, 0, 1], atol=1e-6)
    plain = deep(relief=True).encode(example, seed=0)
    np.testing.assert_array_equal(channels[:3], plain)


def test_a_picture_without_probabilities_is_refused_only_for_the_channel_p_wrong():
    example = scan(np.full(SIZE, 0.8))
    assert len(deep().encode(example, seed=0)) == 2
    with pytest.raises(GraycastError, match="scene 0 has no p_wrong"):
        deep(p_wrong=True).encode(example, seed=0)


def test_an_encoding_stored_before_the_channel_p_wrong_has_none():
    record = asdict(deep())
    del record["p_wrong"]
    assert encoding_from(record) == deep()
