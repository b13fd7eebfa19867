"""A jolt of the bin moves the parts as the laws of friction say; a heap without a part settles."""

import numpy as np
import pytest
import trimesh

from graycast.base.frames import rigid
from graycast.world.drop import resettle, shake
from graycast.world.drop.body import body_of
from graycast.world.drop.rapier import GRAVITY_M_S2, SKIN_M, STEP_S
from graycast.world.scene import Bin

from .conftest import as_part

PLATE_M = (0.08, 0.06, 0.02)
STROKE_M = np.array([0.018, -0.024])


def plate(friction, origin_m=(0.0, 0.0, 0.0)):
    """Return a plate whose centre of mass is at `origin_m` in its own frame."""
    shape = trimesh.creation.box(PLATE_M)
    shape.apply_translation(origin_m)
    part = as_part(shape, "plate", friction)
    return body_of(part, ((np.array(shape.vertices), np.array(shape.faces)),))


def lying(z_m=0.0):
    return rigid(np.eye(3), np.array([0.01, 0.02, z_m + PLATE_M[2] / 2 + SKIN_M]))


@pytest.mark.parametrize("origin_m", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.0)])
def test_a_part_without_friction_stays_where_it_is_while_the_bin_moves(origin_m):
    """So its place in the bin changes by the stroke, and it does not turn about its origin."""
    box = Bin(inner_m=(0.4, 0.3, 0.15), friction=0.0)
    start = lying() @ rigid(np.eye(3), -np.array(origin_m))
    body = plate(0.0, origin_m)
    end = shake(box, (body,), start[None], np.zeros(1, int), stroke_m=STROKE_M, steps=30)[0]
    np.testing.assert_allclose(end[:2, 3] - start[:2, 3], -STROKE_M, atol=2e-4)
    np.testing.assert_allclose(end[:3, :3], np.eye(3), atol=2e-3)


@pytest.mark.parametrize(("share", "slides"), [(0.8, True), (1.3, False)])
def test_a_part_slides_only_if_the_bin_accelerates_more_than_friction_can(share, slides):
    """The limit is `mu g`; the engine's cone gives 86 to 100 % of it, by direction."""
    steps = 30
    acceleration = np.linalg.norm(STROKE_M) / (steps // 2 * STEP_S) ** 2
    friction = share * acceleration / GRAVITY_M_S2
    box = Bin(inner_m=(0.4, 0.3, 0.15), friction=friction)
    start = lying()[None]
    end = shake(box, (plate(friction),), start, np.zeros(1, int), stroke_m=STROKE_M, steps=steps)
    moved_m = float(np.linalg.norm(end[0, :2, 3] - start[0, :2, 3]))
    assert moved_m > 1e-3 if slides else moved_m < 0.5e-3


def test_a_plate_falls_by_its_thickness_if_the_plate_below_it_is_gone():
    box, body = Bin(inner_m=(0.4, 0.3, 0.15)), plate(0.5)
    above = lying(PLATE_M[2] + 2 * SKIN_M)
    layout, left = resettle(
        box, (body,), np.stack([lying(), above]), np.zeros(2, int),
        keep=np.array([False, True]), simulated_s=5.0,
    )  # fmt: skip
    assert left.tolist() == [False, True] and layout.at_rest
    np.testing.assert_allclose(layout.T_world_part[0], lying(), atol=5e-4)


def test_a_part_that_falls_over_the_rim_is_no_longer_in_the_bin():
    box, body = Bin(inner_m=(0.4, 0.3, 0.15)), plate(0.5)
    beyond = rigid(np.eye(3), np.array([0.4, 0.0, 0.2]))
    layout, left = resettle(
        box, (body,), np.stack([beyond, lying()]), np.zeros(2, int),
        keep=np.ones(2, bool), simulated_s=5.0,
    )  # fmt: skip
    assert left.tolist() == [False, True] and len(layout.part_index) == 1 and not layout.outside
