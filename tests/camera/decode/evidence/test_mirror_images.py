"""Mirrored positions and rivals, on pictures whose positions are known."""

import numpy as np
import pytest
from stage import centred, make_rig

from graycast.base.frames import pixel_grid, transform_points
from graycast.camera.decode import CodeMap, triangulate
from graycast.camera.decode.evidence.mirror_images import orientation, rivals
from graycast.rig.optics import project, rays

SIZE = (40, 60)  # rows and columns of the camera's picture
WALL_M = 1.0


def rig_of(axis):
    baseline_m = (0.1, 0.0, 0.0) if axis == "column" else (0.0, 0.1, 0.0)
    return make_rig(
        centred(SIZE[1], SIZE[0], 80.0), centred(300, 300, 240.0), baseline_m=baseline_m
    )


def wall_code(rig, tilt=0.0):
    """Return projector columns and rows of a wall that is nearer to the right by `tilt` per m."""
    ray = rays(rig.camera, pixel_grid(*SIZE))
    z_m = WALL_M / (1 + tilt * ray[..., 0])
    place = project(rig.projector, transform_points(rig.T_proj_cam, ray * z_m[..., None]))
    return [place[..., i].astype(np.float32) for i in (0, 1)]


def by_axis(axis, column, row):
    return (column, row) if axis == "column" else (row, column)


@pytest.mark.parametrize("axis", ["column", "row"])
def test_a_facing_wall_has_a_slope_and_a_handedness_of_one(axis):
    rig = rig_of(axis)
    cues = orientation(*by_axis(axis, *wall_code(rig)), rig, axis)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(cues["slope forward"][inner], 1, atol=1e-3)
    np.testing.assert_allclose(cues["slope aside"][inner], 0, atol=1e-3)
    np.testing.assert_allclose(cues["handedness"][inner], 1, atol=1e-3)


@pytest.mark.parametrize("axis", ["column", "row"])
@pytest.mark.parametrize("flip", [0, 1], ids=["upside down", "left and right"])
def test_one_mirror_reverses_the_handedness_and_two_do_not(axis, flip):
    rig = rig_of(axis)
    mirrored = [np.flip(place, flip).copy() for place in wall_code(rig)]
    inner = np.s_[1:-1, 1:-1]
    once = orientation(*by_axis(axis, *mirrored), rig, axis)["handedness"]
    np.testing.assert_allclose(once[inner], -1, atol=1e-3)
    turned = [np.flip(place, 1 - flip).copy() for place in mirrored]
    twice = orientation(*by_axis(axis, *turned), rig, axis)["handedness"]
    np.testing.assert_allclose(twice[inner], 1, atol=1e-3)


def test_exchanged_axes_of_the_picture_are_a_mirror_too():
    """Then each position changes only along the other axis of the picture."""
    rig = rig_of("column")
    side = SIZE[0]
    column, row = (place[:side, :side].T.copy() for place in wall_code(rig))
    cues = orientation(column, row, rig, "column")
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(cues["slope forward"][inner], 0, atol=1e-3)
    np.testing.assert_allclose(cues["handedness"][inner], -1, atol=1e-3)


def test_the_slope_of_a_tilted_wall_is_the_closed_form():
    """Oracle: with u = f (x - b / z) and 1 / z = 1 + t x, the slope is 1 - b t."""
    rig = rig_of("column")
    cues = orientation(*wall_code(rig, tilt=0.8), rig, "column")
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(cues["slope forward"][inner], 1 - 0.1 * 0.8, atol=1e-3)


def depth_of(rig, column, row):
    nothing = np.full(SIZE, 0.05, dtype=np.float32)
    codes = CodeMap(
        column=column.copy(),
        row=row.copy(),
        sigma_column=nothing,
        sigma_row=nothing.copy(),
        modulation=nothing.copy(),
        reason=np.zeros(SIZE, np.uint8),
    )
    return triangulate(codes, rig)


def with_image(rig, dim):
    """Return positions and contrasts of a wall with a patch that shows the place of another one."""
    column, row = wall_code(rig)
    contrast_dn = np.full(SIZE, 1000, dtype=np.float32)
    image, spot = np.s_[10:14, 10:14], np.s_[10:14, 40:44]
    column[image], row[image] = column[spot], row[spot]
    contrast_dn[image] *= dim
    return column, row, contrast_dn, image


def test_the_dimmer_of_two_pixels_with_one_position_has_a_rival():
    rig = rig_of("column")
    column, row, contrast_dn, image = with_image(rig, 0.25)
    cues = rivals(column, row, contrast_dn, depth_of(rig, column, row), rig, "column")
    distance, ratio = cues["distance of a brighter rival"], cues["contrast over that of a rival"]
    # The rival may be a neighbour of the spot, because the cells around one are searched, too.
    np.testing.assert_allclose(distance[image], 30, atol=2)
    np.testing.assert_allclose(ratio[image], 0.25)
    alone = np.ones(SIZE, bool)
    alone[image] = False
    assert (distance[alone] == 0).all()
    assert (ratio[alone] == 1).all()


def test_of_equal_contrasts_none_is_a_brighter_rival():
    rig = rig_of("column")
    column, row, contrast_dn, _ = with_image(rig, 1.0)
    cues = rivals(column, row, contrast_dn, depth_of(rig, column, row), rig, "column")
    assert (cues["distance of a brighter rival"] == 0).all()


def test_without_rows_the_measured_points_give_the_rows():
    """Oracle: the decoded rows of the same wall."""
    rig = rig_of("column")
    column, row = wall_code(rig)
    nothing = np.full(SIZE, np.nan, dtype=np.float32)
    contrast_dn = np.linspace(500, 900, column.size, dtype=np.float32).reshape(SIZE)
    depth = depth_of(rig, column, row)
    alone = rivals(column, nothing, contrast_dn, depth, rig, "column")
    both = rivals(column, row, contrast_dn, depth, rig, "column")
    for name, values in both.items():
        np.testing.assert_array_equal(alone[name], values)
    assert (alone["distance of a brighter rival"] == 0).all()
