"""BOP's result files: read back as written, and one clear line for any other file."""

import numpy as np
import pytest

from graycast.base.errors import GraycastError
from graycast.base.frames import rigid, rotation_from_quaternion
from graycast.dataset.read.pose_results import (
    HEADER,
    PoseEstimate,
    pose_results_text,
    read_pose_results,
)

ONE = "3,0,1,0.5,1 0 0 0 1 0 0 0 1,10 20 900,0.25"


def estimate(seed):
    rng = np.random.default_rng(seed)
    R = rotation_from_quaternion(rng.standard_normal(4))
    T = rigid(R, rng.uniform(-0.1, 1.0, 3))
    return PoseEstimate(scene_id=seed, im_id=0, obj_id=2, score=0.1 * seed, T_cam_part=T)


def test_written_results_are_read_back(tmp_path):
    estimates = [estimate(seed) for seed in range(5)]
    path = tmp_path / "poses.csv"
    path.write_text(pose_results_text(estimates))
    for mine, its in zip(estimates, read_pose_results(path), strict=True):
        np.testing.assert_allclose(its.T_cam_part, mine.T_cam_part, rtol=0, atol=1e-15)
        ids = [(x.scene_id, x.im_id, x.obj_id, x.score, x.time_s) for x in (mine, its)]
        assert ids[0] == ids[1]


def test_rotations_are_written_by_rows_and_translations_in_millimetres(tmp_path):
    """Computed by hand: a quarter turn about z moves x to y."""
    path = tmp_path / "poses.csv"
    path.write_text(f"{','.join(HEADER)}\n3,0,1,0.5,0 -1 0 1 0 0 0 0 1,10 20 900,-1\n")
    (result,) = read_pose_results(path)
    np.testing.assert_allclose(result.T_cam_part @ [1, 0, 0, 1], [0.01, 1.02, 0.9, 1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ONE.replace("3,0", "3.5,0"), "line 2: scene_id is '3.5'; it must be a whole number"),
        (ONE.replace("3,0", "-3,0"), "line 2: scene_id is '-3'; it must be a whole number"),
        (ONE.replace("0.5", "high"), "line 2: score is 'high'; it must be a finite number"),
        (ONE.replace("0.5", "nan"), "line 2: score is 'nan'; it must be a finite number"),
        (ONE.replace("1 0 0 0 1 0 0 0 1", "1 0 0 1"), "line 2: R is '1 0 0 1'; it must be 9"),
        (ONE.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 2"), "line 2: R is not a rotation"),
        (ONE.replace("1 0 0 0 1 0 0 0 1", "1 0 0 0 1 0 0 0 -1"), "line 2: R is not a rotation"),
        (ONE.replace("10 20 900", "10 20"), "line 2: t is '10 20'; it must be 3 finite numbers"),
        (ONE.replace("0.25", "-2"), "line 2: time is -2.0; give seconds, or -1"),
        (ONE.replace("10 20 900", "10,20,900"), "line 2 has 9 cells, not 7"),
        (f"{ONE}\n{ONE.replace('0.25', '0.5')}", "scene 3, image 0 has the times 0.25 and 0.5"),
    ],
)
def test_a_file_that_contains_no_results_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "poses.csv"
    path.write_text(f"{','.join(HEADER)}\n{text}\n")
    with pytest.raises(GraycastError) as caught:
        read_pose_results(path)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "scene,im\n", ONE])
def test_a_file_without_the_header_is_refused(tmp_path, text):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(GraycastError, match="does not begin with the line scene_id,im_id"):
        read_pose_results(path)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(GraycastError, match=r"none\.csv: cannot be read"):
        read_pose_results(tmp_path / "none.csv")
