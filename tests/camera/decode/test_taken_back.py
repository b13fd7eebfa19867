"""Pictures of a moving scene, taken back to one time: the result is a stack of a scene at rest."""

import numpy as np
import pytest
from moving_wall import WALL_M, motions, pictures_of_wall, wall_depth, window_rig

from graycast.base.errors import DecodeError
from graycast.base.frames import transform_points
from graycast.camera.decode import DecodeSpec, Levels, decode, take_back, triangulate, without_doubt
from graycast.rig.optics import in_picture, points, project
from graycast.rig.pattern import CodeSpec

LEVELS = Levels(offset_dn=0.0, floor_dn2=400.0, slope_dn=0.0, saturation_dn=65_000.0)


@pytest.fixture(scope="module")
def rig():
    return window_rig(120, 60)


@pytest.mark.parametrize("codec", ["gray_phase", "multi_frequency", "xor_gray"])
def test_pictures_of_a_scene_at_rest_are_not_changed(rig, codec):
    code = CodeSpec(codec=codec).code(rig.projector.width_px, rig.projector.height_px)
    rest = np.repeat(np.eye(4)[None], len(code.frames), axis=0)
    frames = pictures_of_wall(rig, code, rest)
    back = take_back(frames, code, rig, rest, saturation_dn=65_000.0)
    assert np.array_equal(back, frames)


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["gray_phase", "multi_frequency"])
@pytest.mark.parametrize(
    ("velocity_m", "turn_rad"), [((0.001, 0.0005, 0.0), 0.0), ((0.0, 0.0005, 0.001), 0.002)]
)
def test_a_moving_wall_has_the_depth_of_the_reference_time(rig, codec, velocity_m, turn_rad):
    """Many pictures contradict as they are; taken back, they give the depth at rest."""
    code = CodeSpec(codec=codec).code(rig.projector.width_px, rig.projector.height_px)
    T = motions(len(code.frames), velocity_m, turn_rad)
    frames = pictures_of_wall(rig, code, T)
    truth_m = wall_depth(rig.camera, *WALL_M)
    now_m = points(rig.camera, truth_m)
    in_all = np.all(
        [in_picture(rig.camera, project(rig.camera, transform_points(one, now_m))) for one in T],
        axis=0,
    )
    good = {}
    for name, stack in (
        ("taken", frames),
        ("back", take_back(frames, code, rig, T, saturation_dn=65_000.0)),
    ):
        depth = triangulate(decode(stack, code, DecodeSpec(), LEVELS), rig)
        good[name] = (np.abs(depth.depth_m - truth_m) < 5e-4)[in_all].mean()
    assert in_all.mean() > 0.5
    assert good["back"] > 0.9  # Pictures between pixels blur the edges of stripes.
    assert good["taken"] < good["back"] - 0.15


def test_as_many_poses_as_frames_are_needed(rig):
    code = CodeSpec(codec="gray").code(rig.projector.width_px, rig.projector.height_px)
    frames, poses = np.zeros((3, 60, 120), dtype=np.uint16), np.repeat(np.eye(4)[None], 3, axis=0)
    with pytest.raises(DecodeError, match="one pose for each"):
        take_back(frames, code, rig, poses, saturation_dn=65_000.0)


@pytest.mark.slow
def test_bright_pictures_of_a_moving_wall_stay_in_the_range_of_eight_bits(rig):
    """White is saturated and black is dark, so no value wraps around from bright to dark."""
    code = CodeSpec(codec="gray_phase").code(rig.projector.width_px, rig.projector.height_px)
    T = motions(len(code.frames), (0.001, 0.0, 0.0), 0.0)
    frames = np.minimum(pictures_of_wall(rig, code, T) // 100, 255).astype(np.uint8)
    back = take_back(frames, code, rig, T, saturation_dn=255.0)
    white, black = (back[[f.kind for f in code.frames].index(kind)] for kind in ("white", "black"))
    lit = white > 0  # The points of the other pixels leave the picture.
    assert lit.mean() > 0.3
    assert (white[lit] == 255).all() and (black[lit] < 60).all()
    assert (back.max(axis=0)[lit] == 255).all()


@pytest.mark.slow
def test_points_that_are_hidden_in_some_pictures_are_probably_wrong(rig):
    """A black patch that stays in the camera's picture covers the moving wall in some pictures."""
    code = CodeSpec(codec="gray_phase").code(rig.projector.width_px, rig.projector.height_px)
    T = motions(len(code.frames), (0.001, 0.0, 0.0), 0.0)
    frames = pictures_of_wall(rig, code, T)
    frames[::3, 20:40, 50:70] = 2_000
    frames = take_back(frames, code, rig, T, saturation_dn=65_000.0)
    codes = decode(frames, code, DecodeSpec(), LEVELS)
    of_scan = codes, triangulate(codes, rig), rig, frames, code, LEVELS
    depth_m = without_doubt(*of_scan, max_p_wrong=0.05)[1].depth_m
    inside, outside = np.s_[25:35, 55:65], np.s_[:15, 45:75]
    assert np.isfinite(depth_m[outside]).mean() > 0.9 and np.isnan(depth_m[inside]).mean() > 0.95
