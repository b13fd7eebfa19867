"""A rig or pictures that are turned are named, with what would set them right."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, inverse, rigid
from graycast.camera.rig_file import import_opencv
from graycast.camera.stack import decode_stack
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
# Its baseline runs down, and the edges are those on the left and on the right.
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


@pytest.mark.parametrize("name", ["both", "columns", "rows"])
def test_a_rig_whose_R_and_T_are_inverted_is_named(name, shots, tmp_path):
    """With one axis coded nothing but the edge of the projector's picture tells."""
    rig, code, stack = shots[name]
    assert misfits(tmp_path, code, stack, rig) == []
    (message,) = misfits(tmp_path, code, stack, inverted(rig))
    assert "invert R and T of the rig" in message


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
def test_turned_pictures_are_named_with_the_turn_that_undoes_it(name, turn, says, shots, tmp_path):
    rig, code, stack = shots[name]
    (message,) = misfits(tmp_path, code, np.ascontiguousarray(stack[turn]), rig)
    assert says in message


@pytest.mark.parametrize(
    ("turns", "mirror", "says"),
    [
        (1, False, "turn the pictures by 90 degrees clockwise"),
        (-1, False, "turn the pictures by 90 degrees counter-clockwise"),
        (1, True, "left to right, then turn them by 90 degrees clockwise"),
        (-1, True, "left to right, then turn them by 90 degrees counter-clockwise"),
    ],
)
def test_pictures_on_their_side_are_refused_with_the_turn(turns, mirror, says, shots, tmp_path):
    """`np.rot90` turns counter-clockwise, so what undoes one turn is clockwise."""
    rig, code, stack = shots["both"]
    turned = np.rot90(stack, turns, axes=(1, 2))
    if mirror:
        turned = turned[:, :, ::-1]
    with pytest.raises(GraycastError, match=f"pictures are 120 x 160 px.*{says}"):
        misfits(tmp_path, code, np.ascontiguousarray(turned), rig)


@pytest.mark.slow
def test_a_real_rig_that_is_inverted_is_named_with_columns_alone(shared, tmp_path):
    """The sea shell: of its 1.4 million points none looked wrong, and all were."""
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
