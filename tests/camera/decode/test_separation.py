"""Separation of direct and global light, compared with a mixture of known parts."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.base.errors import DecodeError
from graycast.camera.decode.separation import separate
from graycast.rig.pattern import gray, gray_line_shift, gray_phase, multi_frequency, xor_gray
from studies.projected import LEVELS, frames_of, share_of_white

CODES = {
    "phase": gray_phase(512, 384),
    "three frequencies": multi_frequency(512, 384, period_px=12.0),
    "lines": gray_line_shift(512, 384),
    "gray": gray(512, 384, axes=("column",), inverses=True),
    "gray without inverses": gray(512, 384, axes=("column",)),
    "combined": xor_gray(512, 384),
}
U = np.repeat(np.linspace(60, 450, 391)[None], 3, axis=0)


def groove(code, *, camera_px=0.0):
    """Like a V-groove: a direct part that falls towards the fold, and a global part, the light of
    a wide patch of the other side, that rises; with a constant light that is not the projector's.
    """
    fold = np.abs(U - 255.0) / 195.0
    direct = 400 + 1600 * fold
    around = 1200 * (1 - fold) + 100
    own = share_of_white(code, U, camera_px=camera_px, disc_px=0.0)
    other = share_of_white(code, 510.0 - U, camera_px=192.0, disc_px=0.0)
    return direct, around, 150 + direct * own + around * other


@pytest.mark.parametrize("name", CODES)
def test_sharp_stripes_separate_direct_light_from_global_light(name):
    """A window of 192 px has whole periods of all narrow stripes except for phases of odd length,
    whose remainder is under 2 % of the global light.
    """
    code = CODES[name]
    direct, around, light = groove(code)
    direct_estimate, around_estimate = separate(frames_of(light), code, LEVELS)
    assert np.abs(direct_estimate - direct).max() < 0.02 * 1300 + 2
    assert np.abs(around_estimate - around).max() < 0.04 * 1300 + 4


@pytest.mark.parametrize("name", ["phase", "combined"])
def test_ambient_light_counts_as_global_only_without_a_black_frame(name):
    code = CODES[name]
    _, around, light = groove(code)
    blackless = replace(code, frames=tuple(f for f in code.frames if f.kind != "black"))
    keep = [k for k, f in enumerate(code.frames) if f.kind != "black"]
    estimate = separate(frames_of(light), code, LEVELS)[1]
    blackless_estimate = separate(frames_of(light[keep]), blackless, LEVELS)[1]
    assert np.allclose(blackless_estimate - estimate, 2 * 150, atol=4)
    assert np.abs(estimate - around).max() < 60


def test_noise_brightens_the_direct_light_of_stripes_without_inverses_only_a_little():
    """The mean of the larger two of four normal values is 0.663 standard deviations too large.

    With noise of 5 DN, a difference deviates by 10 DN, or by 12.2 DN with white and black frames,
    whose noise four differences share. The largest of four would be 10.3 DN too large.
    """
    code = gray(512, 384)
    column = np.repeat(U, 80, axis=0)
    own = share_of_white(code, column, 0.5 * column, camera_px=0.0, disc_px=0.0)
    light = 100 + 100 * own + np.random.default_rng(0).normal(0, 5, own.shape)
    direct, around = separate(frames_of(light), code, LEVELS)
    assert 6.5 < direct.mean() - 100 < 8.2
    assert 6.5 < -around.mean() < 8.2


def test_blur_moves_the_lost_contrast_from_direct_to_global_light():
    """A box of 4 px moves 1 - sinc(4 / 16) of a cosine of 16 px to the global light."""
    code = CODES["phase"]
    direct, around, light = groove(code, camera_px=4.0)
    direct_estimate, around_estimate = separate(frames_of(light), code, LEVELS)
    contrast = np.sinc(4 / 16) * np.sinc(1 / 16)
    assert np.allclose(direct_estimate / direct, contrast, atol=0.015)
    assert np.allclose(direct_estimate + around_estimate, direct + around, atol=45)


def test_a_code_with_only_wide_stripes_cannot_separate_light():
    whole = gray(512, 384, axes=("column",))
    for kind in ("white", "black"):  # Both are needed to compute the inverses of narrow stripes.
        code = replace(whole, frames=tuple(f for f in whole.frames if f.kind != kind))
        with pytest.raises(DecodeError, match="period of at most 32 px with their inverses"):
            separate(frames_of(np.zeros((len(code.frames), 2, 2))), code, LEVELS)
    code = replace(whole, frames=tuple(f for f in whole.frames if f.bit < 0 or f.bit > 3))
    with pytest.raises(DecodeError, match="direct and global light need phases"):
        separate(frames_of(np.zeros((len(code.frames), 2, 2))), code, LEVELS)
    whole = gray(512, 384, axes=("column",), inverses=True)
    code = replace(whole, frames=tuple(f for f in whole.frames if f.bit < 0 or f.bit > 3))
    with pytest.raises(DecodeError, match="direct and global light need phases"):
        separate(frames_of(np.zeros((len(code.frames), 2, 2))), code, LEVELS)
