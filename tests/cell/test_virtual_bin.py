"""The parts in a bin of virtual scanners are lifted, jolted and replaced."""

import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.errors import ArgumentError
from graycast.base.streams import scene_seeds
from graycast.cell.resolve import load_cell
from graycast.cell.virtual_bin import JOLT_M, VirtualBin
from graycast.world.drop import DropLimits, drop
from graycast.world.scene import Layout

HALF_M = np.array([0.06, 0.04, 0.03]) / 2  # half the sides of the boxes of `small_cell`


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return load_cell(write_cell(tmp_path_factory.mktemp("cell")))


@pytest.fixture
def bin_of_three(cell):
    return VirtualBin(cell, seed=5)


@pytest.mark.slow
def test_parts_keep_their_numbers_until_the_bin_is_refilled(cell, bin_of_three):
    poses = bin_of_three.layout.T_world_part
    bin_of_three.lift(0)
    assert bin_of_three.numbers.tolist() == [1, 2]
    np.testing.assert_allclose(bin_of_three.layout.T_world_part, poses[1:], atol=2e-3)
    for part in (0, 3):
        with pytest.raises(ArgumentError, match=rf"part {part} is not in the bin, .* 1, 2$"):
            bin_of_three.lift(part)
    bin_of_three.lift(2)
    bin_of_three.lift(1)
    assert not len(bin_of_three.layout.part_index)
    with pytest.raises(ArgumentError, match="holds no part"):
        bin_of_three.lift(1)
    bin_of_three.nudge()
    bin_of_three.refill(6, scene_id=2)
    expected = drop(cell.scene, (3,), seed=scene_seeds(6, 2)["drop"], limits=DropLimits())
    np.testing.assert_array_equal(bin_of_three.layout.T_world_part, expected.T_world_part)
    assert bin_of_three.numbers.tolist() == [0, 1, 2]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("beside_m", "lifts"), [(-0.004, True), (0.004, True), (0.006, False)])
def test_a_gripper_lifts_the_part_within_5_mm_of_its_point(bin_of_three, axis, beside_m, lifts):
    """The point is above or below the middle of a face whose place is known."""
    T = bin_of_three.layout.T_world_part[1]
    bin_of_three.layout = Layout(T_world_part=T[None], part_index=np.zeros(1, int))
    bin_of_three.numbers = np.array([1])
    point_m = np.zeros(3)
    point_m[axis] = HALF_M[axis] + beside_m
    assert bin_of_three.lift_at(T[:3, :3] @ point_m + T[:3, 3]) == (1 if lifts else None)
    assert bin_of_three.numbers.tolist() == ([] if lifts else [1])


def test_a_nudge_moves_the_parts_and_no_two_nudges_are_equal(cell, bin_of_three):
    """The bin moves by 3 cm, so no part slides farther than that; parts may tumble, though."""
    again = VirtualBin(cell, seed=5)
    before = bin_of_three.layout.T_world_part[:, :2, 3]
    steps = []
    for _ in range(2):
        bin_of_three.nudge()
        again.nudge()
        after = bin_of_three.layout.T_world_part[:, :2, 3]
        steps.append(after - before)
        before = after
        np.testing.assert_array_equal(after, again.layout.T_world_part[:, :2, 3])
    assert bin_of_three.layout.at_rest and bin_of_three.numbers.tolist() == [0, 1, 2]
    for step in steps:
        length_m = np.linalg.norm(step, axis=1)
        assert length_m.max() > 1e-3 and (length_m < JOLT_M + HALF_M.max()).all()
    first, second = (step.mean(axis=0) / np.linalg.norm(step.mean(axis=0)) for step in steps)
    assert first @ second < 0.99
