"""Triangulation in three other ways: a full linear system, similar triangles, OpenCV's lenses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from lenses import BEAM, LENS, opencv_rays
from stage import centred, make_rig, optics, turned

from graycast.camera.decode import (
    CodeMap,
    Reason,
    epipolar_residual_px,
    triangulate,
    triangulation_axis,
)


def code_map(column, row, *, sigma_px=0.25):
    known = np.isfinite(column) | np.isfinite(row)
    sigma = np.full(column.shape, sigma_px, dtype=np.float32)
    return CodeMap(
        column=column.astype(np.float32),
        row=row.astype(np.float32),
        sigma_column=sigma,
        sigma_row=sigma.copy(),
        modulation=np.ones(column.shape, dtype=np.float32),
        reason=np.where(known, 0, 1).astype(np.uint8),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("vertical", [False, True])
def test_triangulated_depth_solves_the_published_linear_equations(seed, vertical):
    """Two rows of Mc and one of Mp, solved as a full 3 x 3 system in world coordinates (X, Y, Z)
    of a third frame: (M0 - u M2) . (X, 1) = 0. The code under test reduces them by hand.
    """
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.05, 0.05, 3) + ([0.0, -0.3, 0.0] if vertical else [0.3, 0.0, 0.0])
    toe = (-0.25, 0.0) if vertical else (0.0, -0.25)
    rotation = turned(toe[0], toe[1], 0.0) @ turned(*rng.uniform(-0.08, 0.08, 3))
    if vertical:
        rotation = turned(0.25, 0.0, 0.0).T @ turned(*rng.uniform(-0.08, 0.08, 3))
    rig = make_rig(
        optics(24, 18, 30), optics(64, 48, 60), baseline_m=tuple(place.tolist()), rotation=rotation
    )
    axis = "row" if vertical else "column"
    assert triangulation_axis(rig) == axis
    size = 48 if vertical else 64
    code = rng.integers(0, size, (18, 24)).astype(float)
    nothing = np.full(code.shape, np.nan)
    depth = triangulate(code_map(nothing, code) if vertical else code_map(code, nothing), rig)
    T_cam_world = np.linalg.inv(
        np.vstack([np.column_stack([turned(0.3, -0.5, 1.0), [0.4, -2.0, 1.0]]), [0, 0, 0, 1]])
    )
    Mc = rig.camera.K @ T_cam_world[:3]
    Mp = rig.projector.K @ (np.linalg.inv(rig.T_cam_proj) @ T_cam_world)[:3]
    i = int(vertical)
    decoded = 0
    for y in range(18):
        for x in range(24):
            rows = np.stack([Mc[0] - x * Mc[2], Mc[1] - y * Mc[2], Mp[i] - code[y, x] * Mp[2]])
            point = np.linalg.solve(rows[:, :3], -rows[:, 3])
            z = T_cam_world[2] @ [*point, 1.0]
            if rig.near_m <= z <= rig.far_m:
                decoded += 1
                assert abs(depth.depth_m[y, x] / z - 1) < 1e-5
                assert depth.reason[y, x] == Reason.DECODED
            else:
                assert np.isnan(depth.depth_m[y, x])
                assert depth.reason[y, x] == Reason.OUT_OF_RANGE
    assert decoded > 50


@pytest.mark.parametrize("wall_m", [0.4, 0.9, 2.0])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("vertical", [False, True])
def test_depth_of_a_parallel_rig_follows_similar_triangles(wall_m, side, vertical):
    """x_cam - x_proj = side f b / z, with fractional columns, so nothing is rounded."""
    f_px, b_m = 400.0, 0.1
    baseline = (0.0, side * b_m, 0.0) if vertical else (side * b_m, 0.0, 0.0)
    rig = make_rig(centred(64, 48, f_px), centred(1000, 1000, f_px), baseline_m=baseline)
    place = np.arange(48 if vertical else 64) - (23.5 if vertical else 31.5)
    code = place - side * f_px * b_m / wall_m + 499.5
    code = np.broadcast_to(code[:, None] if vertical else code[None], (48, 64)).astype(float)
    nothing = np.full(code.shape, np.nan)
    depth = triangulate(
        code_map(nothing, code) if vertical else code_map(code, nothing), rig
    ).depth_m
    assert np.abs(depth / wall_m - 1).max() < 1e-5  # columns are float32


@pytest.mark.parametrize("known", ["both", "across"])
@pytest.mark.parametrize("vertical", [False, True])
def test_points_projected_by_opencv_through_two_distorted_lenses_are_triangulated(known, vertical):
    """Oracle: cv2.projectPoints. Each camera pixel gets a point on its ray, and the projector pixel
    in which OpenCV sees it; its depth must be found to a micrometre.
    """
    camera, projector = (
        optics(40, 30, 44, distortion=LENS),
        optics(64, 48, 46, distortion=BEAM),
    )
    rotation = turned(0.2, 0.02, 0.03) if vertical else turned(0.03, -0.2, 0.02)
    baseline = (0.02, 0.25, 0.01) if vertical else (0.25, 0.02, 0.01)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    ray = opencv_rays(camera).reshape(-1, 3)
    z = np.random.default_rng(2).uniform(0.9, 1.4, 1200)
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)
    uv = cv2.projectPoints(
        ray * z[:, None],
        cv2.Rodrigues(T_proj_cam[:3, :3])[0],
        T_proj_cam[:3, 3],
        projector.K,
        np.array(BEAM),
    )[0][:, 0]
    inside = ((uv > -0.5) & (uv < [63.5, 47.5])).all(axis=1)
    assert inside.sum() > 600
    uv[~inside] = np.nan
    column, row = uv[:, 0].reshape(30, 40), uv[:, 1].reshape(30, 40)
    nothing = np.full((30, 40), np.nan)
    if known == "across":
        column, row = (nothing, row) if vertical else (column, nothing)
    exact = CodeMap(
        column=column,
        row=row,
        sigma_column=np.ones((30, 40)),
        sigma_row=np.ones((30, 40)),
        modulation=np.ones((30, 40)),
        reason=np.where(inside.reshape(30, 40), 0, 1).astype(np.uint8),
    )
    depth = triangulate(exact, rig)
    error = np.abs(depth.depth_m.ravel() - z)[inside]
    assert error.max() < 1e-6


def test_wrong_columns_of_a_distorted_projector_are_out_of_range_without_an_error():
    """Wrong codes move the search for the row far out of the picture, where the lens folds over;
    one such pixel must not stop the decoding. 29 of 200 such rigs once did.
    """
    for seed in range(3, 30):
        rng = np.random.default_rng(seed)
        k1 = rng.uniform(-0.16, -0.05)
        projector = optics(64, 48, 46, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
        camera = optics(48, 36, rng.uniform(15, 60))
        rotation = turned(rng.uniform(-0.1, 0.1), -0.3, rng.uniform(-0.2, 0.2))
        baseline = (0.3, rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
        rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
        column = rng.integers(0, 64, (36, 48)).astype(float)
        depth = triangulate(code_map(column, np.full(column.shape, np.nan)), rig)
        assert set(np.unique(depth.reason)) == {Reason.DECODED, Reason.OUT_OF_RANGE}


def test_a_pixel_beyond_the_working_range_is_out_of_range():
    rig = make_rig(centred(64, 48, 400), centred(1000, 1000, 400))
    rig = replace(rig, near_m=0.5, far_m=1.0)
    x = np.arange(64) - 31.5
    wall_m = np.array([0.49, 0.51, 0.99, 1.01, -0.8])
    code = x[None] - 400 * 0.1 / wall_m[:, None] + 499.5
    column = np.full((48, 64), np.nan)
    column[:5] = code
    depth = triangulate(code_map(column, np.full((48, 64), np.nan)), rig)
    assert (depth.reason[[0, 3, 4]] == Reason.OUT_OF_RANGE).all()
    assert np.isnan(depth.depth_m[[0, 3, 4]]).all()
    assert np.abs(depth.depth_m[1:3] - wall_m[1:3, None]).max() < 1e-4
    assert (depth.reason[5:] == 1).all()  # an earlier reason is kept


def test_a_code_along_the_wrong_axis_or_of_another_size_is_refused():
    rig = make_rig(centred(64, 48, 400), centred(100, 100, 400))
    row = np.full((48, 64), 3.0)
    with pytest.raises(ValueError, match="needs the column code"):
        triangulate(code_map(np.full((48, 64), np.nan), row), rig)
    with pytest.raises(ValueError, match="64 x 47 px, the rig's camera 64 x 48"):
        triangulate(code_map(row[1:], row[1:]), rig)


@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("lens", [(0.0,) * 5, BEAM])
def test_sigma_of_depth_equals_the_change_from_a_small_step_of_the_code(vertical, lens):
    """Oracle: a difference quotient. Distortion scales (u, v) locally, which the slope ignores."""
    rotation = turned(0.2, 0.02, 0.03) if vertical else turned(0.03, -0.2, 0.02)
    baseline = (0.02, 0.25, 0.01) if vertical else (0.25, 0.02, 0.01)
    camera, projector = optics(40, 30, 60), optics(64, 48, 70, distortion=lens)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    code = np.random.default_rng(5).uniform(8, 40, (30, 40))
    nothing = np.full(code.shape, np.nan)
    step = 1 / 16  # exact in float32
    near, far, here = (
        triangulate(
            code_map(nothing, code + d, sigma_px=0.5)
            if vertical
            else code_map(code + d, nothing, sigma_px=0.5),
            rig,
        )
        for d in (-step, step, 0)
    )
    slope_m = np.abs(far.depth_m - near.depth_m) / (2 * step)
    known = (here.reason == 0) & (near.reason == 0) & (far.reason == 0) & (here.depth_m < 3)
    assert known.sum() > 200
    ratio = here.sigma_m[known] / (0.5 * slope_m[known])
    assert np.abs(ratio - 1).max() < (0.02 if lens[0] == 0 else 0.25)


def epipolar_case(off_px, sigma_px=0.25):
    """Return a wall seen through distorted lenses, with columns and with rows that are off."""
    camera, projector = optics(40, 30, 44), optics(64, 48, 46, distortion=BEAM)
    rotation, baseline = turned(0.03, -0.2, 0.02), (0.25, 0.02, 0.01)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    ray = opencv_rays(camera).reshape(-1, 3)
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)
    turn = cv2.Rodrigues(T_proj_cam[:3, :3])[0]
    uv = cv2.projectPoints(1.1 * ray, turn, T_proj_cam[:3, 3], projector.K, np.array(BEAM))[0]
    uv = uv[:, 0].reshape(30, 40, 2)
    uv[~((uv > -0.5) & (uv < [63.5, 47.5])).all(axis=-1)] = np.nan
    return rig, code_map(uv[..., 0], uv[..., 1] + off_px, sigma_px=sigma_px)


def test_the_epipolar_residual_equals_the_error_of_the_redundant_coordinate():
    """With a distorted projector, a wrong row also bends the column's plane a little."""
    rig, codes = epipolar_case(0.0)
    residual = epipolar_residual_px(codes, triangulate(codes, rig), rig)
    assert np.nanmax(np.abs(residual)) < 1e-4
    rig, codes = epipolar_case(0.8)
    residual = epipolar_residual_px(codes, triangulate(codes, rig), rig)
    assert np.isfinite(residual).sum() > 300
    assert np.nanmax(np.abs(residual - 0.8)) < 0.1


def test_only_a_point_beyond_the_noise_off_its_epipolar_line_is_an_outlier():
    """The bound is max_epipolar_px and three sigma: 2 + 0.75 px here."""
    for off_px, expected in ((0.0, 0), (2.4, 0), (3.2, Reason.OUTLIER), (-3.2, Reason.OUTLIER)):
        rig, codes = epipolar_case(off_px)
        decoded = codes.reason == 0
        depth = triangulate(codes, rig, max_epipolar_px=2.0)
        assert (depth.reason[decoded] == expected).mean() > 0.97
        assert np.isnan(depth.depth_m[depth.reason != 0]).all()
        assert (triangulate(codes, rig).reason[decoded] == 0).all()  # off by default
