"""A rig or pictures with a wrong orientation are named, with the remedy."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.camera.rig_file import import_opencv
from graycast.camera.stack import decode_stack, describe_result
from graycast.rig.pattern import gray

from .simulated import describe, lens, save, shoot, small_rig

BOTH = gray(128, 96, inverses=True)
COLUMNS = gray(128, 96, inverses=True, axes=("column",))
ROWS = gray(128, 96, inverses=True, axes=("row",))
# The camera looks at the projector's picture from below and sees its upper and lower edge.
WIDE = replace(
    small_rig(),
    camera=lens(160, 120, 150.0),
    T_cam_proj=rigid(
        axis_rotation("y", -0.25) @ axis_rotation("x", 0.05), np.array([0.2, 0.0, 0.02])
    ),
)
# The baseline runs down, and the camera sees the left and the right edge.
TALL = replace(small_rig(vertical=True), camera=lens(160, 120, 130.0))


def inverted(rig):
    return replace(rig, T_cam_proj=inverse(rig.T_cam_proj))


@pytest.fixture(scope="module")
def shots():
    pairs = {"both": (WIDE, BOTH), "columns": (WIDE, COLUMNS), "rows": (TALL, ROWS)}
    return {name: (rig, code, shoot(rig, code)) for name, (rig, code) in pairs.items()}


def misfits(folder, code, stack, rig):
    warnings = decode_stack(save(folder, describe(code), stack), rig).warnings
    return [warning for warning in warnings if "the rig does not fit the stack" in warning]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["both", "columns", "rows"])
def test_a_rig_with_inverted_R_and_T_causes_a_warning(name, shots, tmp_path):
    """With one coded axis, only the edge of the projector's picture reveals the inversion."""
    rig, code, stack = shots[name]
    assert misfits(tmp_path, code, stack, rig) == []
    (message,) = misfits(tmp_path, code, stack, inverted(rig))
    assert "invert R and T of the rig" in message


@pytest.mark.slow
def test_a_note_says_that_one_axis_cannot_reveal_an_inverted_rig(tmp_path):
    """Symptom: without a visible edge, all points were wrong, and no message said so."""
    rig = small_rig()
    path = save(tmp_path, describe(COLUMNS), shoot(rig, COLUMNS))
    for own in (rig, inverted(rig)):
        result = decode_stack(path, own)
        assert result.warnings == ()
        assert "one axis cannot tell whether R and T of rig small are inverted" in result.notes[0]
        assert f"note: {result.notes[0]}" in describe_result(result)


@pytest.mark.slow
def test_points_beyond_the_working_range_reveal_an_inverted_rig(tmp_path):
    """The axes cross at 0.55 m; the inversion moves the wall to the other side of this point."""
    T_cam_proj = rigid(axis_rotation("y", -0.35), np.array([0.2, 0.0, 0.0]))
    tight = replace(small_rig(), T_cam_proj=T_cam_proj, near_m=0.6, far_m=0.9)
    path = save(tmp_path, describe(COLUMNS), shoot(tight, COLUMNS))
    right, wrong = decode_stack(path, tight), decode_stack(path, inverted(tight))
    assert (right.warnings, right.notes) == ((), ())
    assert wrong.notes == ()
    assert "invert R and T of the rig: then 100 % of the points lie in the" in wrong.warnings[0]


@pytest.mark.slow
def test_a_correct_rig_gets_no_note_if_both_axes_are_coded_or_an_edge_is_visible(shots, tmp_path):
    for name, (rig, code, stack) in shots.items():
        folder = tmp_path / name
        folder.mkdir()
        assert decode_stack(save(folder, describe(code), stack), rig).notes == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "turn", "says"),
    [
        ("both", np.s_[:, ::-1, ::-1], "turn the pictures by 180 degrees"),
        ("both", np.s_[:, :, ::-1], "mirror the pictures left to right"),
        ("both", np.s_[:, ::-1], "mirror the pictures upside down"),
        ("columns", np.s_[:, ::-1, ::-1], "turn the pictures by 180 degrees"),
        ("columns", np.s_[:, :, ::-1], "mirror the pictures left to right"),
    ],
)
def test_the_warning_about_rotated_pictures_states_the_rotation_to_apply(
    name, turn, says, shots, tmp_path
):
    rig, code, stack = shots[name]
    (message,) = misfits(tmp_path, code, np.ascontiguousarray(stack[turn]), rig)
    assert says in message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "mirror", "says"),
    [
        (1, False, "turn the pictures by 90 degrees clockwise"),
        (-1, False, "turn the pictures by 90 degrees counter-clockwise"),
        (1, True, "left to right, then turn them by 90 degrees clockwise"),
        (-1, True, "left to right, then turn them by 90 degrees counter-clockwise"),
    ],
)
def test_pictures_rotated_by_90_degrees_are_refused_with_a_remedy(
    turns, mirror, says, shots, tmp_path
):
    """`np.rot90` rotates counter-clockwise, so the correction is clockwise."""
    rig, code, stack = shots["both"]
    turned = np.rot90(stack, turns, axes=(1, 2))
    if mirror:
        turned = turned[:, :, ::-1]
    with pytest.raises(GraycastError, match=f"pictures are 120 x 160 px.*{says}"):
        misfits(tmp_path, code, np.ascontiguousarray(turned), rig)


@pytest.mark.slow
def test_an_inverted_real_rig_is_detected_from_columns_alone(shared, tmp_path):
    """Symptom: all 1.4 million points of the sea shell were wrong, and none looked wrong."""
    scan = shared / "data" / "scans" / "sea_shell"
    if not scan.is_dir():
        pytest.skip("needs ../shared/data/scans/sea_shell, which is not here")
    frames = [
        {
            "file": str(file),
            "kind": "gray",
            "axis": "column",
            "bit": int(file.name.split("-")[1]),
            "inverse": file.name.split("-")[2].startswith("01"),
        }
        for file in sorted((scan / "stack").glob("*[[]00-*.jpg"))
    ]
    path = tmp_path / "stack.yaml"
    content = {"projector": {"width_px": 1280, "height_px": 720}, "frames": frames}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    rig = import_opencv(
        scan / "calibration.yaml", unit=None, camera_size_px=None, projector_size_px=(1280, 720)
    )
    assert decode_stack(path, rig).warnings == ()
    (message,) = decode_stack(path, inverted(rig)).warnings
    assert "invert R and T of the rig" in message
