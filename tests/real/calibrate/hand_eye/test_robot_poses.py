"""Pose files in all forms give the same transforms, and ambiguous ones are refused."""

import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graycast.base.errors import GraycastError
from graycast.real.calibrate.hand_eye import read_poses

TURN = Rotation.from_rotvec([[0.1, -0.4, 1.2], [2.0, 0.3, -0.5]])
PLACE_M = np.array([[0.4, -0.2, 0.9], [0.1, 0.7, 0.3]])
POSES = np.tile(np.eye(4), (2, 1, 1))
POSES[:, :3, :3], POSES[:, :3, 3] = TURN.as_matrix(), PLACE_M


def table(heads, place, turn, names=None):
    """Return CSV text, with a column of scans if there are names."""
    rows = [[*p, *t] for p, t in zip(place.tolist(), turn.tolist(), strict=True)]
    if names:
        heads, rows = f"scan,{heads}", [[n, *r] for n, r in zip(names, rows, strict=True)]
    return "\n".join([heads, *(",".join(map(str, row)) for row in rows)]) + "\n"


FORMS = {
    "quaternion.csv": table("x_m,y_m,z_m,qx,qy,qz,qw", PLACE_M, TURN.as_quat()),
    "vector.csv": table("x_m,y_m,z_m,rx_rad,ry_rad,rz_rad", PLACE_M, TURN.as_rotvec()),
    "units.csv": table(
        "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg", 1e3 * PLACE_M, np.degrees(TURN.as_rotvec())
    ),
    "matrix.json": json.dumps({"T_base_tool": POSES.tolist()}),
    "matrix.yaml": json.dumps(
        {"unit": "mm", "T_base_tool": (POSES * np.where(np.arange(4) == 3, 1e3, 1)
                                       ** (np.arange(4) < 3)[:, None]).tolist()}
    ),
}  # fmt: skip


def written(tmp_path, text, name="poses.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", FORMS)
def test_each_form_gives_the_same_poses(tmp_path, name):
    poses = read_poses(written(tmp_path, FORMS[name], name))
    np.testing.assert_allclose(poses.T_base_tool, POSES, atol=1e-12)


def test_poses_are_matched_to_scans_by_name(tmp_path):
    text = table("x_m,y_m,z_m,qx,qy,qz,qw", PLACE_M, TURN.as_quat(), ["b", "a"])
    path = written(tmp_path, text)
    np.testing.assert_allclose(read_poses(path).of(["a"], path).T_base_tool, POSES[1:], atol=1e-12)
    with pytest.raises(GraycastError, match="no pose for the scan c"):
        read_poses(path).of(["a", "c"], path)


def test_a_number_of_poses_unlike_that_of_scans_is_refused(tmp_path):
    path = written(tmp_path, FORMS["quaternion.csv"])
    with pytest.raises(GraycastError, match="has 2 poses, and there are 3 scans"):
        read_poses(path).of(["a", "b", "c"], path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("x_m,y_m,z_m,roll,pitch,yaw", PLACE_M, TURN.as_rotvec()), "roll is an Euler angle"),
        (table("X_mm,Y_mm,Z_mm,A_deg,B_deg,C_deg", PLACE_M, TURN.as_rotvec()), "an Euler angle"),
        (table("x,y,z,qx,qy,qz,qw", PLACE_M, TURN.as_quat()), "give a CSV file with the columns"),
        (
            table("x_m,y_m,z_m,rx_rad,ry_rad,rz_rad", PLACE_M, np.degrees(TURN.as_rotvec())),
            "degrees for radians: name the columns rx_deg",
        ),
        (
            table("x_m,y_m,z_m,qx,qy,qz,qw", 1e3 * PLACE_M, TURN.as_quat()),
            "millimetres for metres: divide them by 1000",
        ),
        (table("x_m,y_m,z_m,qx,qy,qz,qw", PLACE_M, 2 * TURN.as_quat()), "has the length 2"),
        ("x_m,y_m,z_m,qx,qy,qz,qw\n1,2,3,0,0,0\n", "line 2 lacks a number"),
    ],
)
def test_a_table_that_is_ambiguous_or_in_another_unit_is_refused(tmp_path, text, message):
    with pytest.raises(GraycastError, match=re.escape(message)):
        read_poses(written(tmp_path, text))


def test_a_matrix_that_is_not_rigid_is_refused(tmp_path):
    text = json.dumps({"T_base_tool": {"a": (2 * POSES[0]).tolist()}})
    with pytest.raises(GraycastError, match="pose a is not a rigid transform"):
        read_poses(written(tmp_path, text, "poses.yaml"))
