"""Parts in a mesh bin: the same laws as in a box, with inclined walls."""

import numpy as np
import pytest

from graycast.base.frames import axis_rotation, rigid
from graycast.rig.pair import preset_rig
from graycast.world.drop import DropLimits, drop
from graycast.world.drop.body import body_of
from graycast.world.drop.decomposition import hull_of
from graycast.world.drop.rest import simulate
from graycast.world.scene import Bin, Scene, bin_mesh
from studies.crates import Crate

from .conftest import box_part

CRATE = Crate(inner_m=(0.16, 0.12, 0.08), lean=0.3)  # 17 degrees
BOX = Bin(inner_m=(0.16, 0.12, 0.08))
AS_MESH = Bin(inner_m=BOX.inner_m, mesh=bin_mesh(BOX))


def body_of_box(size_m, friction=0.4):
    part = box_part(size_m, friction)
    return body_of(part, (hull_of(part.mesh.vertices_m),))


def at(*xyz_m, turn=None):
    return rigid(np.eye(3) if turn is None else turn, np.array(xyz_m, dtype=float))[None]


def test_a_cube_rests_on_a_floor_of_triangles_as_on_a_block():
    turn = axis_rotation("x", 0.1) @ axis_rotation("y", 0.2)
    start = at(0.02, 0.0, 0.15, turn=turn)  # over the floor's diagonal, which is no real edge
    ends = [
        simulate(box, (body_of_box((0.04,) * 3),), start, np.zeros(1, int), simulated_s=5.0)
        for box in (BOX, AS_MESH)
    ]
    for end in ends:
        assert end.at_rest
        assert end.outside == 0
        assert end.deepest_penetration_m < 1e-5
        assert end.T_world_part[0, 2, 3] == pytest.approx(0.0202, abs=2e-5)


def test_the_overlap_of_a_cube_jammed_between_two_walls_is_measured():
    """A cube of 40 mm is between two walls 36 mm apart, so one of them overlaps by 2 mm or more."""
    narrow = Bin(inner_m=(0.16, 0.036, 0.08))
    narrow = Bin(inner_m=narrow.inner_m, mesh=bin_mesh(narrow))
    body = body_of_box((0.04,) * 3)
    layout = simulate(narrow, (body,), at(0.0, 0.0, 0.04), np.zeros(1, int), simulated_s=0.03)
    R, place = layout.T_world_part[0, :3, :3], layout.T_world_part[0, :3, 3]
    reach_m = 0.02 * np.abs(R[1]).sum()
    assert layout.deepest_penetration_m == pytest.approx(abs(place[1]) + reach_m - 0.018, abs=2e-4)
    assert layout.deepest_penetration_m > 1.5e-3


@pytest.mark.slow
def test_a_heap_stays_between_inclined_walls(tmp_path, angle_part, hull_folder):
    """Oracle: the planes of floor and walls, from which the crate was made."""
    scene = Scene(
        rig=preset_rig("paper"), T_world_cam=np.eye(4), parts=(angle_part,), bin=CRATE.bin(tmp_path)
    )
    layout = drop(scene, (10,), seed=0, limits=DropLimits(), hull_folder=hull_folder)
    corner = angle_part.mesh.vertices_m
    point = np.concatenate([corner @ T[:3, :3].T + T[:3, 3] for T in layout.T_world_part])
    assert 0.0 < point[:, 2].min() < 0.5e-3  # the lowest part is on the floor
    inside = point[point[:, 2] < CRATE.inner_m[2] - CRATE.rim_m]
    beyond_m = np.stack(
        [np.abs(inside[:, k]) - CRATE.half_m(0)[k] - CRATE.lean * inside[:, 2] for k in (0, 1)]
    )
    assert beyond_m.max() < 0.1e-3
    assert beyond_m.max() > -1e-3  # one part leans on a wall
    assert layout.outside == 0
