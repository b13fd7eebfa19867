"""Settings that do not affect a stack are noted in one line."""

import numpy as np
import pytest
import yaml

from graycast.camera.decode import DecodeSpec
from graycast.camera.decode.maps import CodeMap, Levels
from graycast.camera.decode.positions import decode
from graycast.camera.stack import StackDescription, decode_stack, describe_result, unread_settings
from graycast.camera.stack.idle_settings import idle_settings
from graycast.rig.pattern import gray, gray_phase, multi_frequency, xor_gray

from .simulated import describe, save, shoot, small_rig

CODES = {
    "gray": gray(128, 96, inverses=True),
    "xor": xor_gray(128, 96),
    "gray and phase": gray_phase(128, 96, inverses=True),
    "phases": multi_frequency(128, 96),
}
FAR_OFF = {
    "doubt": 0.9,
    "fine_bits": 0,
    "settling_votes": 8,
    "min_visibility": 0.95,
}
LEVELS = Levels(offset_dn=0.0, saturation_dn=255.0, floor_dn2=4.0, slope_dn=0.5)


@pytest.fixture(scope="module")
def stacks():
    """Return pictures of each code with much noise, so that each used setting has an effect."""
    rng, rig = np.random.default_rng(1), small_rig()
    noisy = {}
    for name, code in CODES.items():
        light = shoot(rig, code).astype(np.float64)
        noise = rng.normal(scale=0.15 * light.max(), size=light.shape)
        noisy[name] = np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
    return noisy


def maps(codes: CodeMap):
    return np.stack([codes.column, codes.row, codes.sigma_column, codes.sigma_row, codes.reason])


@pytest.mark.parametrize("setting", FAR_OFF)
@pytest.mark.parametrize("name", CODES)
def test_a_setting_that_changes_no_pixel_is_noted_as_idle(name, setting, stacks):
    """Oracle: the decoder itself, with a value far from the default."""
    code, spec = CODES[name], DecodeSpec(**{setting: FAR_OFF[setting]})
    usual = maps(decode(stacks[name], code, DecodeSpec(), LEVELS))
    changed = maps(decode(stacks[name], code, spec, LEVELS))
    same = np.array_equal(usual, changed, equal_nan=True)
    notes = idle_settings(spec, None, code, None)
    assert (notes != []) == same
    assert all(f": {setting} {FAR_OFF[setting]:g} (" in note for note in notes)


def decoded(folder, code, settings, rig=None):
    content = describe(code) | {"decode": settings}
    return decode_stack(save(folder, content, shoot(small_rig(), code)), rig)


@pytest.mark.slow
def test_preset_settings_without_effect_on_gray_code_without_a_rig_are_noted(tmp_path):
    guards = {"min_visibility": 0.5, "settling_votes": 12, "max_epipolar_px": 2.0}
    result = decoded(tmp_path, CODES["gray"], guards | {"fine_bits": 3, "doubt": 0.15})
    (note,) = result.notes
    assert note == (
        "settings of decode that have no effect on this stack: settling_votes 12 (it needs phases "
        "and Gray bits of one axis), min_visibility 0.5 (it needs phases or lines), "
        "max_epipolar_px 2 (it needs a rig and frames of both axes)"
    )
    assert f"note: {note}" in describe_result(result)
    assert yaml.safe_load((tmp_path / "STACK.yaml").read_text())["decode"]["settling_votes"] == 12


@pytest.mark.slow
def test_settings_that_are_used_or_switched_off_are_not_noted(tmp_path):
    off = {"min_visibility": 0.0, "settling_votes": 0, "max_epipolar_px": 2.0, "fine_bits": 2}
    assert decoded(tmp_path, CODES["gray"], off, small_rig()).notes == ()


def test_decode_settings_of_a_rig_file_that_a_stack_does_not_use_are_noted():
    """A stack is read with its own file, so the guards of --rig like-phoxi-m have no effect."""
    content = describe(CODES["gray"])
    rig_file = DecodeSpec(min_visibility=0.5, min_sigmas=7.0)
    (note,) = unread_settings(StackDescription.model_validate(content), rig_file)
    assert "stack is read by its own file: min_sigmas 7, min_visibility 0.5; state them" in note
    content["decode"] = {"min_visibility": 0.4, "min_sigmas": 7.0}
    assert unread_settings(StackDescription.model_validate(content), rig_file) == []
    assert unread_settings(StackDescription.model_validate(content), DecodeSpec()) == []
