"""Real stacks cause no warning, and faults that are added to them are named."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from backends import slow
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.camera.stack import decode_stack

from .simulated import save

BITS = {"column": 5, "row": 4}


def _kamino(folder: Path):
    """Two phases and Gray cells, in the order of the pictures."""
    frames = [
        {"kind": "phase", "axis": axis, "period_px": period_px, "step": step, "steps": 3}
        for axis in BITS
        for period_px in (200 / 3, 100.0)
        for step in (1, 0, 2)
    ]
    for axis, count in BITS.items():
        for bit in reversed(range(count)):
            frame = {"kind": "gray", "axis": axis, "bit": bit}
            frames += [frame, frame | {"inverse": True}]
    frames += [{"kind": "white"}, {"kind": "black"}]
    content = {
        "projector": {"width_px": 1920, "height_px": 1080},
        "stride_px": {"column": 100.0, "row": 100.0},
        "frames": frames,
    }
    return content, [folder / f"pat{k:02d}.png" for k in range(len(frames))]


def _yarn(folder: Path):
    """Three periods of eight steps on both axes."""
    frames, files = [], []
    for way, axis in (("horizontal", "column"), ("vertical", "row")):
        for count in (35, 36, 37):
            for k in range(8):
                files.append(folder / f"{way}_f{count}_{k + 1}.png")
                frame = {"kind": "phase", "axis": axis, "period_px": 1000 / count}
                frames.append(frame | {"step": k, "steps": 8})
    return {"projector": {"width_px": 1000, "height_px": 1000}, "frames": frames}, files


def _xema(folder: Path):
    """Machined metal: four periods of both axes, and a white frame."""
    content = yaml.safe_load((folder / "stack.yaml").read_text(encoding="utf-8"))
    return content, [folder / frame["file"] for frame in content["frames"]]


STACKS = {"kamino_phase": _kamino, "yarn_three_frequencies": _yarn, "xema_metal": _xema}


@pytest.fixture(scope="module")
def stacks(shared):
    """Return description and frames of a real stack, by its folder's name."""

    def read(name):
        folder = shared / "data" / "stacks" / name
        if not folder.is_dir():
            pytest.skip("needs ../shared/data/stacks, which is not here")
        content, files = STACKS[name](folder)
        pictures = []
        for file in files:
            with Image.open(file) as picture:
                pictures.append(np.asarray(picture.convert("L")))
        for k, frame in enumerate(content["frames"]):
            frame["file"] = f"{k:02d}.png"
        return content, np.array(pictures)

    return read


def warnings_of(folder, content, stack):
    try:
        return decode_stack(save(folder, content, np.ascontiguousarray(stack))).warnings
    except GraycastError as error:  # a refusal ends with the first warning
        return (str(error),)


@pytest.mark.parametrize("name", [slow(each) for each in STACKS])
def test_a_real_stack_causes_no_warning(name, stacks, tmp_path):
    assert warnings_of(tmp_path, *stacks(name)) == ()


@pytest.mark.parametrize("name", [slow(each) for each in STACKS])
def test_a_bump_of_a_real_camera_causes_a_warning(name, stacks, tmp_path):
    """Oracle: the frames of the rows were shifted by 2 px to the right and 1 px down."""
    content, stack = stacks(name)
    at = next(k for k, frame in enumerate(content["frames"]) if frame.get("axis") == "row")
    stack[at:] = np.roll(stack[at:], (1, 2), axis=(1, 2))
    (warning,) = warnings_of(tmp_path, content, stack)
    assert warning.startswith(f"the picture moved by 2.2 px between pictures {at} and {at + 1} ")


@pytest.mark.parametrize("name", [slow(each) for each in STACKS])
def test_a_phase_step_that_is_too_bright_in_a_real_stack_is_named(name, stacks, tmp_path):
    content, stack = stacks(name)
    k = 1 + next(
        k for k, f in enumerate(content["frames"]) if f["kind"] == "phase" and f["period_px"] < 200
    )
    stack[k] = np.clip(np.rint(1.2 * stack[k]), 0, 255).astype(np.uint8)
    (warning,) = warnings_of(tmp_path, content, stack)
    assert f"({k:02d}.png) is 1.2" in warning and "times as bright as the other steps" in warning


@pytest.mark.parametrize("name", [slow(each) for each in STACKS])
def test_real_pictures_in_reverse_order_are_named(name, stacks, tmp_path):
    content, stack = stacks(name)
    (warning,) = warnings_of(tmp_path, content, stack[::-1])
    assert "the pictures are in the opposite order: state the files" in warning


@pytest.mark.parametrize(
    ("name", "one", "other", "says"),
    [
        slow("kamino_phase", 0, 1, "step00 and column_phase_66.6667px_step01 may be"),
        slow("yarn_three_frequencies", 0, 1, "step00 (00.png) and column_phase_28.5714px_step01"),
        slow("yarn_three_frequencies", 34, 39, "step02 (34.png) and row_phase_27.7778px_step07"),
        slow("xema_metal", 14, 18, "step00.5 (14.png) and column_phase_10px_step02.5 (18.png)"),
        slow("xema_metal", 9, 10, "step01 (10.png) and column_phase_40px_step02 (09.png)"),
    ],
)
def test_two_exchanged_pictures_of_a_real_stack_are_named(name, one, other, says, stacks, tmp_path):
    """Stripes are not a sine even in the right order: an exchange doubles their difference."""
    content, stack = stacks(name)
    stack[[one, other]] = stack[[other, one]]
    (warning,) = warnings_of(tmp_path, content, stack)
    assert says in warning


@pytest.mark.slow
def test_each_reversed_period_of_a_real_stack_is_named(stacks, tmp_path):
    """Symptom: only one of four was named, because a phase changes little between neighbours.

    A Gray value of 100 px is one and a half times one period, and as long as the other.
    """
    content, stack = stacks("kamino_phase")
    for frame in content["frames"]:
        if frame["kind"] == "phase":
            frame["step"] = -frame["step"] % 3
    warnings = warnings_of(tmp_path, content, stack)
    assert len(warnings) == 4
    assert all("the steps run backwards. With step 0, 2, 1 of 3" in text for text in warnings)
