"""Wrong stacks cause an error that names the file, or a warning with the measured symptom."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.camera.decode import Reason
from graycast.camera.stack import decode_stack
from graycast.rig.pattern import gray, gray_phase, multi_frequency

from .simulated import describe, save, shoot, small_rig, view_of, write_yaml

RIG = small_rig()
GRAY = gray(128, 96, inverses=True)
PHASE = gray_phase(128, 96, axes=("column", "row"), period_px=16.0, steps=4)
THREE = multi_frequency(128, 96, period_px=16.0)


@pytest.fixture(scope="module")
def shots():
    return {id(code): shoot(RIG, code) for code in (GRAY, PHASE, THREE)}


@pytest.fixture
def make(tmp_path, shots):
    """Write a valid stack; `edit` changes its description or its files before it is read."""

    def write(edit, code=GRAY, stack=None):
        content = describe(code)
        save(tmp_path, content, shots[id(code)] if stack is None else stack)
        changed = edit(content, tmp_path)
        return write_yaml(tmp_path, content if changed is None else changed)

    return write


def entry(content, name):
    return next(e for e in content["frames"] if e["file"] == f"{name}.png")


def swap(content, one, other):
    a, b = entry(content, one), entry(content, other)
    a["file"], b["file"] = b["file"], a["file"]


# --- errors ------------------------------------------------------------------------------------


def file_missing(content, folder):
    (folder / "column_bit03.png").unlink()


def bit_missing(content, folder):
    content["frames"] = [e for e in content["frames"] if "column_bit03" not in e["file"]]


def coarsest_missing(content, folder):
    content["frames"] = [e for e in content["frames"] if "column_bit06" not in e["file"]]


def inverse_without_pattern(content, folder):
    content["frames"].remove(entry(content, "column_bit06"))


def other_size(content, folder):
    Image.new("L", (160, 121), 80).save(folder / "row_bit02.png")


def other_depth(content, folder):
    with Image.open(folder / "row_bit02.png") as image:
        deep = np.asarray(image).astype(np.uint16) * 257
    Image.fromarray(deep).save(folder / "row_bit02.png")


def cut_short(content, folder):
    path = folder / "row_bit02.png"
    path.write_bytes(path.read_bytes()[:3000])


def cut_short_jpeg(content, folder):
    with Image.open(folder / "row_bit02.png") as image:
        image.save(folder / "row_bit02.jpg")
    path = folder / "row_bit02.jpg"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    entry(content, "row_bit02")["file"] = "row_bit02.jpg"


def no_picture(content, folder):
    (folder / "row_bit02.png").write_text("not a picture")


def empty_picture(content, folder):
    (folder / "row_bit02.png").write_bytes(b"")


def a_folder(content, folder):
    (folder / "row_bit02.png").unlink()
    (folder / "row_bit02.png").mkdir()


def floats(content, folder):
    Image.fromarray(np.zeros((120, 160), np.float32)).save(folder / "row_bit02.tif")
    entry(content, "row_bit02")["file"] = "row_bit02.tif"


def nothing(content, folder):
    return {}


def misspelt(content, folder):
    entry(content, "row_bit02")["invers"] = True


def no_axis(content, folder):
    del entry(content, "row_bit02")["axis"]


def bit_twice(content, folder):
    entry(content, "row_bit02")["bit"] = 3


def file_twice(content, folder):
    entry(content, "row_bit02")["file"] = "row_bit03.png"


def wrong_kind(content, folder):
    entry(content, "row_bit02")["kind"] = "grey"


def axis_of_white(content, folder):
    entry(content, "white")["axis"] = "row"


def only_ends(content, folder):
    content["frames"] = [e for e in content["frames"] if e["kind"] in ("white", "black")]


def wider_projector(content, folder):
    content["projector"]["width_px"] = 1024


ERRORS = {
    file_missing: "column_bit03.png: no such file",
    bit_missing: "column: Gray bit 3 is missing",
    coarsest_missing: "column: 6 Gray bits of 1 px reach 64 px, the projector has 128",
    inverse_without_pattern: "bit 6 has an inverse but no frame of its own",
    other_size: "row_bit02.png is 160 x 121 px, white.png is 160 x 120 px",
    other_depth: "row_bit02.png has 16 bits a pixel, white.png has 8",
    cut_short: "row_bit02.png: is damaged or cut short",
    cut_short_jpeg: "row_bit02.jpg: is damaged or cut short",
    no_picture: "row_bit02.png: is not a picture",
    empty_picture: "row_bit02.png: is empty",
    a_folder: "row_bit02.png: cannot be read",
    floats: "row_bit02.tif: holds floating-point numbers",
    nothing: "projector is missing",
    misspelt: "unknown key frames.*invers: did you mean inverse",
    no_axis: "a gray frame needs axis",
    bit_twice: "row_bit03.png and row_bit02.png are both row_bit03",
    file_twice: "row_bit03.png is given as row_bit03 and row_bit02",
    wrong_kind: "kind is 'grey'",
    axis_of_white: "a white frame has no axis",
    only_ends: "no frame carries a code",
    wider_projector: "column: 7 Gray bits of 1 px reach 128 px, the projector has 1024",
}


@pytest.mark.parametrize("edit", ERRORS, ids=lambda edit: edit.__name__)
def test_the_error_for_a_broken_stack_names_its_fault(edit, make):
    path = make(edit)
    with pytest.raises(GraycastError, match=ERRORS[edit]) as refusal:
        decode_stack(path)
    assert "\n" not in str(refusal.value)


def test_the_error_for_a_missing_phase_step_names_the_step(make):
    def edit(content, folder):
        content["frames"].remove(entry(content, "column_phase_16px_step02"))

    with pytest.raises(GraycastError, match="column: period 16 px lacks step 2 of 4"):
        decode_stack(make(edit, PHASE))


def test_a_stack_file_that_is_missing_empty_or_not_yaml_is_refused(tmp_path):
    with pytest.raises(GraycastError, match="no such file"):
        decode_stack(tmp_path / "STACK.yaml")
    (tmp_path / "STACK.yaml").write_text("frames: [")
    with pytest.raises(GraycastError, match="is not YAML in line"):
        decode_stack(tmp_path / "STACK.yaml")
    (tmp_path / "STACK.yaml").write_text("")
    with pytest.raises(GraycastError, match="holds no keys"):
        decode_stack(tmp_path / "STACK.yaml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("level", "says"),
    [
        (4, "no pixel is lit.*values are 4 to 4 DN"),
        (255, "are saturated .*255 to 255 DN"),
    ],
)
def test_pictures_that_are_all_dark_or_all_white_are_refused(level, says, make, shots):
    flat = np.full_like(shots[id(GRAY)], level)
    with pytest.raises(GraycastError, match=says):
        decode_stack(make(lambda *_: None, stack=flat))


@pytest.mark.slow
def test_overexposed_pictures_are_refused_or_warned_of(make):
    """With 40 times the light, even the dark frames, 3 % of white, are saturated."""
    with pytest.raises(GraycastError, match=r"almost no pixel is decoded: .* are saturated"):
        decode_stack(make(lambda *_: None, stack=shoot(RIG, GRAY, bright=40.0)))
    stack = shoot(RIG, GRAY)
    stack[:, :, :60] = shoot(RIG, GRAY, bright=40.0)[:, :, :60]
    some = decode_stack(make(lambda *_: None, stack=stack))
    assert any("% of the lit pixels are saturated" in w for w in some.warnings)


@pytest.mark.slow
def test_pictures_with_saturated_stripes_are_decoded_from_their_inverses(make):
    """With three times the light, a stripe and its inverse still distinguish bright from dark."""
    over = decode_stack(make(lambda *_: None, stack=shoot(RIG, GRAY, bright=3.0)))
    assert over.figures.decoded_share > 0.97
    assert over.figures.clipped_share > 0.9
    off_px = np.abs(over.codes.column - view_of(RIG).column)[over.codes.reason == Reason.DECODED]
    assert np.quantile(off_px, 0.98) < 0.51


# --- warnings ----------------------------------------------------------------------------------


def inverse_swapped(content, folder):
    swap(content, "column_bit04", "column_bit04_inverse")


def coarsest_inverse_swapped(content, folder):
    swap(content, "row_bit06", "row_bit06_inverse")


def inverses_mixed_up(content, folder):
    swap(content, "column_bit04_inverse", "column_bit05_inverse")


def shifted_by_one(content, folder):
    """A camera dropped a frame: each file has the picture of the next one."""
    files = [e["file"] for e in content["frames"]]
    for e, file in zip(content["frames"], [*files[1:], files[0]], strict=True):
        e["file"] = file


def bits_exchanged(content, folder):
    for suffix in ("", "_inverse"):
        swap(content, f"column_bit02{suffix}", f"column_bit05{suffix}")


def axes_exchanged(content, folder):
    for e in content["frames"]:
        e["axis"] = {"column": "row", "row": "column"}.get(e.get("axis"))
        if e["axis"] is None:
            del e["axis"]
    content["projector"] = {"width_px": 128, "height_px": 128}


def ends_swapped(content, folder):
    swap(content, "white", "black")


def same_picture(content, folder):
    shutil.copy(folder / "row_bit03.png", folder / "row_bit03_inverse.png")


def smaller_projector(content, folder):
    content["projector"]["width_px"] = 80


def wrong_period(content, folder):
    for e in content["frames"]:
        if e["kind"] == "phase" and e["axis"] == "column":
            e["period_px"] = 21.0


def steps_exchanged(content, folder):
    swap(content, "column_phase_16px_step01", "column_phase_16px_step03")


def brighter_pair(content, folder):
    for name in ("column_bit04", "column_bit04_inverse"):
        with Image.open(folder / f"{name}.png") as image:
            picture = np.asarray(image).astype(float)
        Image.fromarray((0.7 * picture).astype(np.uint8)).save(folder / f"{name}.png")


WARNINGS = [
    (inverse_swapped, GRAY, r"columns apart, 0\.\d % if column_bit04 were its inverse"),
    slow(coarsest_inverse_swapped, GRAY, r"mirror image in \d+ %"),
    slow(inverses_mixed_up, GRAY, r"column_bit05 and its inverse are alike in \d+ %.*correlation"),
    slow(bits_exchanged, GRAY, r"if column_bit05 and column_bit02 were exchanged"),
    slow(axes_exchanged, GRAY, r"mirror image in \d+ %"),
    slow(ends_swapped, GRAY, r"white is darker than black by \d+ DN"),
    (same_picture, GRAY, r"row_bit03.png and row_bit03_inverse.png are the same picture"),
    slow(smaller_projector, GRAY, r"\d+ % of the codes lie outside the projector of 80 x 96 px"),
    (
        wrong_period,
        PHASE,
        r"% of the well lit pixels have frames that contradict: check period_px",
    ),
    (
        steps_exchanged,
        PHASE,
        r"run backwards. With step 0, 3, 2, 1 of 4 instead of 0, 1, 2, 3",
    ),
    (brighter_pair, GRAY, r"column_bit04 .* together are 0\.(69|70) times as bright"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "code", "says"), WARNINGS, ids=lambda v: getattr(v, "__name__", "")
)
def test_a_doubtful_stack_is_decoded_with_a_warning_that_names_the_symptom(edit, code, says, make):
    warnings = decode_stack(make(edit, code)).warnings
    assert any(re.search(says, warning) for warning in warnings), warnings


@pytest.mark.slow
def test_a_wrong_period_without_gray_bits_makes_pixels_contradictory(make):
    def edit(content, folder):
        for e in content["frames"]:
            if e["kind"] == "phase" and abs(e["period_px"] - 16) < 1e-6:
                e["period_px"] = 17.0

    with pytest.raises(GraycastError, match=r"almost no pixel is decoded: \d+ % .* contradictory"):
        decode_stack(make(edit, THREE))


@pytest.mark.slow
def test_a_stack_whose_files_are_shifted_by_one_is_refused(make):
    with pytest.raises(
        GraycastError, match=r"almost no pixel is decoded.*\(white is darker than bl.*"
    ):
        decode_stack(make(shifted_by_one))


# --- the rig -----------------------------------------------------------------------------------


def test_a_rig_with_another_camera_size_than_the_pictures_is_refused(make):
    other = replace(RIG, camera=replace(RIG.camera, width_px=161))
    with pytest.raises(GraycastError, match=r"pictures are 160 x 120 px, .* 161 x 120"):
        decode_stack(make(lambda *_: None), other)


def test_a_rig_whose_baseline_axis_has_no_code_is_refused_before_reading(make):
    def edit(content, folder):
        content["frames"] = [e for e in content["frames"] if e.get("axis") != "column"]

    with pytest.raises(GraycastError, match="baseline runs along its columns"):
        decode_stack(make(edit), RIG)
    with pytest.raises(GraycastError, match="averaging joins"):
        decode_stack(make(edit), small_rig(vertical=True), average=True)
    with pytest.raises(GraycastError, match="need a rig"):
        decode_stack(make(edit), average=True)


def moved(rig):
    T = rig.T_cam_proj.copy()
    T[:3, 3] += [0.0, 0.05, 0.0]
    return replace(rig, T_cam_proj=T)


def other_range(rig):
    return replace(rig, near_m=2.0, far_m=3.0)


def other_projector(rig):
    return replace(rig, projector=replace(rig.projector, height_px=100))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (moved, "epipolar residual's median is"),
        slow(other_range, "100 % of the decoded pixels lie outside the rig's working range"),
        slow(other_projector, "projector is 128 x 96 px, that of rig small 128 x 100"),
    ],
)
def test_decoding_with_the_rig_of_another_stack_causes_a_warning(wrong, says, make):
    warnings = decode_stack(make(lambda *_: None), wrong(RIG)).warnings
    assert any(says in warning for warning in warnings), warnings
