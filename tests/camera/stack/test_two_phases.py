"""A real stack of two phases and wide Gray cells (kamino410), and its author's own result."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from backends import slow
from PIL import Image

from graycast.base.errors import DecodeError
from graycast.camera.stack import decode_stack

PHASES_PX = (200 / 3, 100.0)
BITS = {"column": 5, "row": 4}


@pytest.fixture(scope="module")
def kamino(shared):
    folder = shared / "data" / "stacks" / "kamino_phase"
    if not folder.is_dir():
        pytest.skip("needs ../shared/data/stacks/kamino_phase, which is not here")
    return folder


def described(folder: Path, *, phases_px=PHASES_PX, complementary=False) -> dict:
    """Return pictures by number: phases of both axes, Gray bits of both, white and black."""
    frames = [
        {"kind": "phase", "axis": axis, "period_px": period_px, "step": step, "steps": 3}
        for axis in BITS
        for period_px in PHASES_PX
        for step in (1, 0, 2)
    ]
    for axis, count in BITS.items():
        for bit in reversed(range(count)):
            what = {"kind": "gray", "axis": axis, "bit": bit}
            if complementary:
                what["bit"] = bit - 1
                if bit == 0:
                    what = {"kind": "complementary", "axis": axis, "period_px": 200.0}
            frames += [what, what | {"inverse": True}]
    frames += [{"kind": "white"}, {"kind": "black"}]
    frames = [f | {"file": str(folder / f"pat{k:02d}.png")} for k, f in enumerate(frames)]
    selected = [f for f in frames if f["kind"] != "phase" or f["period_px"] in phases_px]
    stride_px = 200.0 if complementary else 100.0
    return {
        "projector": {"width_px": 1920, "height_px": 1080},
        "frames": selected,
        "stride_px": {"column": stride_px, "row": stride_px},
    }


def decoded(tmp_path, content):
    path = tmp_path / "STACK.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return decode_stack(path)


@pytest.mark.slow
@pytest.mark.parametrize("complementary", [slow(False), True])
def test_two_phases_together_reproduce_the_published_positions(kamino, complementary, tmp_path):
    """The author gives positions modulo 256, columns in blue and rows in green, where red is 128.
    The finest bit may also be declared a complementary bit of 200 px.
    """
    result = decoded(tmp_path, described(kamino, complementary=complementary))
    assert result.warnings == ()
    red, green, blue = np.moveaxis(np.asarray(Image.open(kamino / "author.png")).astype(int), -1, 0)
    for place, his in ((result.codes.column, blue), (result.codes.row, green)):
        apart_px = np.abs((place - his + 128) % 256 - 128)[red == 128]
        assert (apart_px <= 3).mean() > 0.96
        assert (apart_px > 10).mean() < 1e-3


@pytest.mark.parametrize("complementary", [False, True])
@pytest.mark.parametrize("period_px", PHASES_PX)
def test_one_of_the_two_phases_alone_is_refused(kamino, period_px, complementary, tmp_path):
    """With one phase, 30 % of the pixels were wrong by a period, without a message."""
    content = described(kamino, phases_px=[period_px], complementary=complementary)
    with pytest.raises(DecodeError, match=f"cannot count the phases of period {period_px:g} px"):
        decoded(tmp_path, content)
