"""The steady motion of a scene, estimated from its pictures: exact pictures of a moving wall."""

import numpy as np
import pytest
from camera.stack.simulated import describe, save
from moving_wall import WALL_M, motions, pictures_of_wall, spots, wall_depth, window_rig

from graycast.base.errors import DecodeError
from graycast.camera.decode import steady_motion, steady_transforms
from graycast.camera.stack import decode_stack, describe_result
from graycast.rig.pattern import CodeSpec

STEP_M = np.array([0.0006, -0.0003, 0.0004])


@pytest.fixture(scope="module")
def rig():
    return window_rig(240, 160)


class Counts:
    """A `ProgressMeter` that stores all counts by their kind."""

    def __init__(self):
        self.counts = {}

    def stage(self, text): ...

    def count(self, what, done, total):
        self.counts.setdefault(what, []).append((done, total))

    def note(self, text): ...


def code_of(rig, codec="gray_phase"):
    return CodeSpec(codec=codec, axes=("column",)).code(
        rig.projector.width_px, rig.projector.height_px
    )


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["gray_phase", "multi_frequency"])
@pytest.mark.parametrize("share", [0.8, 1.2])
def test_an_assumed_motion_is_corrected(rig, codec, share):
    code = code_of(rig, codec)
    count = len(code.frames)
    frames = pictures_of_wall(rig, code, motions(count, STEP_M, 0.0), spots)
    time = np.arange(count) - float(count // 2)
    motion_m = steady_motion(frames, code, rig, time, start_m=share * STEP_M)
    assert np.linalg.norm(motion_m - STEP_M) < 0.03 * np.linalg.norm(STEP_M)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.25])
def test_small_motions_need_no_assumption(rig, share):
    """A quarter of the motion moves the picture by about 3 px in the whole stack."""
    code = code_of(rig)
    count = len(code.frames)
    frames = pictures_of_wall(rig, code, motions(count, share * STEP_M, 0.0), spots)
    time = np.arange(count) - float(count // 2)
    motion_m = steady_motion(frames, code, rig, time, start_m=np.zeros(3))
    error_m = count * np.linalg.norm(motion_m - share * STEP_M)
    assert error_m < 0.5 * WALL_M[1] / rig.camera.fx_px  # Half a pixel over the whole stack


@pytest.mark.slow
def test_a_stack_of_a_moving_wall_gives_the_depth_of_its_middle_picture(rig, tmp_path):
    """The folder has only pictures; the motion is a quarter greater than assumed."""
    code = code_of(rig)
    frames = pictures_of_wall(rig, code, motions(len(code.frames), STEP_M, 0.0), spots)
    path = save(tmp_path, describe(code), frames)
    meter = Counts()
    taken, back = (
        decode_stack(path, rig, motion_m=start_m, progress=meter)
        for start_m in (None, (0.00048, -0.00024, 0.00032))
    )
    for what in ("trials of the motion", "depths of moving pixels"):
        done, total = zip(*meter.counts[what], strict=True)
        assert len(done) > 20 and list(done) == sorted(done)
        assert done[0] == 0 and done[-1] == total[0] and len(set(total)) == 1
    truth_m = wall_depth(rig.camera, *WALL_M)
    good = [(np.abs(result.depth.depth_m - truth_m) < 5e-4).mean() for result in (taken, back)]
    assert good[0] < 0.3 and good[1] > 0.8
    assert back.motion_m == pytest.approx(tuple(STEP_M), abs=2e-5)
    assert taken.motion_m is None
    words = describe_result(back)
    assert "depth is that of picture 9" in words and "set max_p_wrong" in words


def test_frames_of_one_time_are_refused(rig):
    code = code_of(rig)
    frames = np.zeros((len(code.frames), 160, 240), dtype=np.uint16)
    with pytest.raises(DecodeError, match="different times"):
        steady_motion(frames, code, rig, np.zeros(len(frames)), start_m=np.zeros(3))


@pytest.mark.slow
def test_a_motion_that_leaves_the_picture_is_refused(rig):
    code = code_of(rig)
    count = len(code.frames)
    frames = pictures_of_wall(rig, code, motions(count, np.zeros(3), 0.0), spots)
    with pytest.raises(DecodeError, match="smaller motion"):
        steady_motion(frames, code, rig, np.arange(float(count)), start_m=np.array([0.1, 0, 0]))


def test_the_motion_is_proportional_to_time():
    T = steady_transforms(STEP_M, np.array([-1.0, 0.0, 2.0]))
    assert np.array_equal(T[1], np.eye(4))
    assert np.allclose(T[:, :3, 3], np.multiply.outer([-1, 0, 2], STEP_M))
    assert np.array_equal(T[:, :3, :3], np.repeat(np.eye(3)[None], 3, axis=0))


def test_motion_without_a_rig_is_refused(rig, tmp_path):
    code = code_of(rig)
    path = save(tmp_path, describe(code), np.zeros((len(code.frames), 8, 8), dtype=np.uint8))
    with pytest.raises(DecodeError, match="give --rig"):
        decode_stack(path, motion_m=(0.0, 0.0, 0.0))
