"""Shares of the surface and the best order of views, against counting and brute force."""

from itertools import combinations

import numpy as np
import pytest
import trimesh
from seen import FINE, from_above, plane_depth, view, world_rays

from graycast.score.merge.adding import WRONG, ViewTruth, best_order, surface_of, why_not
from graycast.score.merge.fuse import HIDDEN, OUTSIDE
from graycast.score.merge.view import points_of
from graycast.score.merge.view_figures import SurfaceCoverage, surface_figures
from graycast.world.parts import Mesh

UP = np.array([0.0, 0.0, 1.0])
SIDE_M = 0.1


def cube():
    box = trimesh.creation.box((SIDE_M, SIDE_M, SIDE_M))
    return Mesh(vertices_m=np.array(box.vertices, np.float32), faces=np.array(box.faces, np.int32))


def cube_depth(T):
    """Return z of a cube about the origin: the last entry into its slabs, before the first exit."""
    ray, eye = world_rays(T, FINE), T[:3, 3]
    with np.errstate(divide="ignore"):
        ends = np.sort((np.array([[-SIDE_M / 2], [SIDE_M / 2]]) - eye) / ray[..., None, :], axis=-2)
    enter, leave = ends[..., 0, :].max(axis=-1), ends[..., 1, :].min(axis=-1)
    return np.where(enter < leave, enter, np.nan)


def reasons(T, depth_m, true_m, reason=None):
    measured = view(depth_m, T, 0.1e-3, reason=reason, camera=FINE)
    truth = ViewTruth(depth_m=true_m, instance=np.where(np.isfinite(cube_depth(T)), 0, -1))
    surface = surface_of([cube()], [np.eye(4)], points=6000)
    return surface, why_not(surface, measured, points_of(measured), truth)


def test_a_camera_above_an_edge_measures_the_two_visible_faces():
    """Oracle: the camera sees two of the six faces of a cube."""
    T = from_above(-0.5, 0.0, 0.5)
    true_m = cube_depth(T)
    surface, why = reasons(T, true_m, true_m)
    up, left = surface.normal[:, 2] > 0.5, surface.normal[:, 0] < -0.5
    assert set(why.tolist()) == {0, HIDDEN}
    assert (why[~(up | left)] == HIDDEN).all()
    # The outer half pixel of a face of 57 x 40 pixels may belong to the neighbouring face.
    assert (why[up | left] == 0).mean() > 0.96
    assert len(why) == pytest.approx(6000, abs=6) and up.mean() == pytest.approx(1 / 6, abs=0.01)


def test_points_outside_the_view_or_hidden_are_not_losses_of_the_scanner():
    T = from_above(0.0, 0.0, 0.3)
    T[0, 3] = 0.11  # next to the cube, so that a part of it is outside the picture
    plane_m = plane_depth(T, UP, 0.1, FINE)  # a sheet above the cube
    _, why = reasons(T, plane_m, plane_m)
    assert set(why.tolist()) == {HIDDEN, OUTSIDE}


def test_a_hole_has_the_reason_of_the_scanner_and_a_wrong_depth_is_marked_as_wrong():
    T = from_above(0.0)
    true_m = cube_depth(T)
    depth_m = true_m.copy()
    depth_m[:, :160] = np.nan
    depth_m[:120, 160:] += 5e-3
    surface, why = reasons(T, depth_m, true_m, reason=5)
    up = surface.normal[:, 2] > 0.5
    x, y = surface.point_m[up, 0], surface.point_m[up, 1]
    # This camera looks down, and its y axis points along the world's -y.
    inner = (
        (np.abs(surface.point_m[up]).min(axis=1) > 3e-3) & (np.abs(x) < 0.047) & (np.abs(y) < 0.047)
    )
    reason = why[up][inner]
    assert (reason[x[inner] < 0] == 5).all()
    assert (reason[(x[inner] > 0) & (y[inner] > 0)] == WRONG).all()
    assert (reason[(x[inner] > 0) & (y[inner] < 0)] == 0).all()


@pytest.mark.parametrize("seed", range(20))
def test_each_next_view_adds_the_largest_possible_share(seed):
    """Oracle: sets and brute force. All views together have the points of their union."""
    rng = np.random.default_rng(seed)
    has = rng.random((5, 40)) < rng.uniform(0.1, 0.6, (5, 1))
    order, gains = best_order(has)
    sets = [set(np.flatnonzero(row).tolist()) for row in has]
    assert sorted(order) == list(range(5))
    covered: set[int] = set()
    for k, (i, gain) in enumerate(zip(order, gains, strict=True)):
        rest = set(range(5)) - set(order[:k])
        assert gain == len(sets[i] - covered) == max(len(sets[j] - covered) for j in rest)
        covered |= sets[i]
        best = max(len(set().union(*views)) for views in combinations(sets, k + 1))
        assert len(covered) >= (1 - 1 / np.e) * best
    assert len(covered) == len(set().union(*sets)) >= max(map(len, sets))
    assert gains[0] == max(map(len, sets))


def test_equal_views_keep_their_order():
    assert best_order(np.ones((3, 4), dtype=bool)) == ((0, 1, 2), (4, 0, 0))


def test_shares_of_the_surface_are_counted_for_each_view():
    """Five of eight points are visible; no view measures one of these five."""
    why = np.array([[0, 0, 0, 2, 2], [0, 2, HIDDEN, 0, WRONG]], dtype=np.uint8)
    record = surface_figures(SurfaceCoverage(why=why, of=8), ["left", "right"], {2: "saturated"})
    assert record["visible"] == 5 / 8 and record["measured"] == 4 / 5
    left, right = record["views"]
    assert (left["measured"], left["only_this_view"]) == (3 / 5, 2 / 5)
    assert (right["measured"], right["only_this_view"]) == (2 / 5, 1 / 5)
    assert left["filled_by_others"] == {"saturated": 1 / 5}
    assert left["missing"] == {"saturated": 2 / 5}
    assert right["filled_by_others"] == {"saturated": 1 / 5, "hidden": 1 / 5}
    assert right["missing"] == {"saturated": 1 / 5, "wrong": 1 / 5, "hidden": 1 / 5}
    assert [one["together"] for one in record["best_order"]] == [3 / 5, 4 / 5]
