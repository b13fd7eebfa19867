"""Test which points of a plate in a bin are visible to devices, against closed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from stage import centred, lambert, make_rig

from graycast.base.frames import look_at, rigid
from graycast.camera.decode import DepthMap, Reason
from graycast.rendering import GroundTruth
from graycast.rig.pair import Rig
from graycast.score.design.heap_surface import LEAST_PX, HeapSurface, Visibility, spread_surface
from graycast.score.design.point_fates import (
    FATES,
    Fate,
    PointFates,
    SurfaceView,
    figures,
    judge,
    view_of,
)
from graycast.world.parts import Mesh, Part
from graycast.world.scene import Bin, Layout, Scene

LENGTH_M, WIDTH_M, THICK_M = 0.30, 0.20, 0.004
POINTS = 20_000


def plate(length_m: float, width_m: float, thick_m: float) -> Part:
    """Return a box on the plane z = 0 with a unique name."""
    x, y = length_m / 2, width_m / 2
    corners = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (0.0, thick_m)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    mesh = Mesh(vertices_m=corners, faces=faces)
    return Part(name="plate", mesh=mesh, material=lambert(0.5), density_kg_m3=1e3, friction=0.5)


ON_THE_FLOOR = Layout(T_world_part=np.eye(4)[None], part_index=np.array([0]))


def plate_in_bin(rig: Rig, camera_m, *, rim_m: float) -> Scene:
    """Return a plate that covers a bin's floor, under a camera that looks straight down."""
    eye = np.array(camera_m, dtype=np.float64)
    return Scene(
        rig=rig,
        T_world_cam=look_at(eye, eye - [0, 0, 1.0], np.array([0.0, -1.0, 0.0])),
        parts=(plate(LENGTH_M, WIDTH_M, THICK_M),),
        bin=Bin(inner_m=(LENGTH_M, WIDTH_M, THICK_M + rim_m), wall_m=0.005),
    )


def share_of(kinds, surface, which) -> float:
    """Return the share of the upper side's open surface that is of one kind."""
    top = surface.normal[:, 2] > 0.9
    return float(surface.weight[top & (kinds == which)].sum() / surface.weight[top].sum())


@pytest.mark.parametrize(
    ("rim_m", "baseline_m", "height_m"),
    [(0.03, 0.25, 0.6), (0.08, 0.5, 0.6), (0.03, 0.5, 1.2), (0.08, 0.25, 1.2)],  # all combinations
)
def test_the_shadow_of_a_wall_follows_similar_triangles(rim_m, baseline_m, height_m):
    """Oracle: a projector at x = b and H above the plate, and a rim of height h at x = l / 2,
    leave a strip of width h (b - l / 2) / (H - h) along this wall dark."""
    rig = make_rig(centred(600, 500, 400), centred(900, 700, 500), baseline_m=(baseline_m, 0, 0))
    scene = plate_in_bin(rig, (0.0, 0.0, THICK_M + height_m), rim_m=rim_m)
    surface = spread_surface(scene, ON_THE_FLOOR, points=POINTS, cone_deg=0.0)
    view = view_of(scene, ON_THE_FLOOR, surface)
    dark_m = rim_m * (baseline_m - LENGTH_M / 2) / (height_m - rim_m)
    half_pixel_m = 0.5 * height_m / 500
    assert share_of(view.projector, surface, Visibility.BY_BIN) == pytest.approx(
        dark_m / LENGTH_M,
        abs=(half_pixel_m + 1e-3) / LENGTH_M,  # half a pixel and the spacing of the points
    )
    assert share_of(view.camera, surface, Visibility.VISIBLE) == 1.0


def test_a_place_that_a_wall_hides_from_the_camera_is_not_a_shadow():
    """The triangle is the same, but camera and projector are exchanged."""
    rig = make_rig(centred(900, 700, 500), centred(600, 500, 400), baseline_m=(0.4, 0, 0))
    scene = plate_in_bin(rig, (-0.4, 0.0, THICK_M + 0.8), rim_m=0.06)
    surface = spread_surface(scene, ON_THE_FLOOR, points=POINTS, cone_deg=0.0)
    view = view_of(scene, ON_THE_FLOOR, surface)
    dark_m = 0.06 * (0.4 - LENGTH_M / 2) / (0.8 - 0.06)
    assert share_of(view.camera, surface, Visibility.BY_BIN) == pytest.approx(
        dark_m / LENGTH_M, abs=2e-3 / LENGTH_M
    )
    assert share_of(view.projector, surface, Visibility.VISIBLE) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("height_m", [0.42, 0.55])
def test_a_camera_sees_only_points_in_its_field_of_view(height_m):
    """Oracle: a picture of w x h pixels covers (w z / f) (h z / f) of a plane at z."""
    camera = centred(150, 90, 300)
    rig = make_rig(camera, centred(900, 700, 300), baseline_m=(0.05, 0, 0))
    scene = plate_in_bin(rig, (0.0, 0.0, THICK_M + height_m), rim_m=0.01)
    surface = spread_surface(scene, ON_THE_FLOOR, points=POINTS, cone_deg=0.0)
    share = share_of(view_of(scene, ON_THE_FLOOR, surface).camera, surface, Visibility.VISIBLE)
    field_m2 = (150 * height_m / 300) * (90 * height_m / 300)
    assert share == pytest.approx(field_m2 / (LENGTH_M * WIDTH_M), rel=0.01)


@pytest.mark.slow
def test_points_are_weighted_by_their_area_from_above():
    """Oracle: for a cone of 0 degrees, the sum of weights times the area is the plate's silhouette;
    its sides and underside have no weight. A wider cone weights the top by the mean cosine."""
    rig = make_rig(centred(600, 500, 400), centred(900, 700, 500))
    scene = plate_in_bin(rig, (0.0, 0.0, 0.8), rim_m=0.0065)
    area_m2 = scene.parts[0].mesh.face_area_m2.sum()
    straight = spread_surface(scene, ON_THE_FLOOR, points=POINTS, cone_deg=0.0)
    assert straight.weight.mean() * area_m2 == pytest.approx(LENGTH_M * WIDTH_M, rel=2e-3)
    assert not straight.weight[straight.normal[:, 2] < 0.9].any()
    cone = spread_surface(scene, ON_THE_FLOOR, points=2000, cone_deg=30.0)
    top = np.median(cone.weight[cone.normal[:, 2] > 0.9])
    assert top == pytest.approx((1 + 6 * np.cos(np.pi / 12) + 12 * np.cos(np.pi / 6)) / 19)


def test_occlusion_by_a_part_a_bin_and_the_own_back_side_is_distinguished():
    """A block above the plate casts a shadow of its own size times H / (H - h)."""
    height_m, lift_m = 0.9, 0.09
    rig = make_rig(centred(600, 500, 500), centred(900, 700, 500), baseline_m=(0.2, 0, 0))
    scene = plate_in_bin(rig, (0.0, 0.0, THICK_M + height_m), rim_m=0.0065)
    block = replace(plate(0.04, 0.03, 0.001), name="block")
    scene = replace(scene, parts=(*scene.parts, block))
    lifted = rigid(np.eye(3), np.array([0.0, 0.0, THICK_M + lift_m - 0.001]))
    layout = Layout(T_world_part=np.stack([np.eye(4), lifted]), part_index=np.array([0, 1]))
    surface = spread_surface(scene, layout, points=POINTS, cone_deg=0.0)
    view = view_of(scene, layout, surface)
    on_plate = (surface.instance == 0) & (surface.normal[:, 2] > 0.9)
    for kinds in (view.camera, view.projector):
        share = float((kinds[on_plate] == Visibility.BY_PARTS).mean())
        grown = height_m / (height_m - lift_m)
        assert share == pytest.approx(0.04 * 0.03 * grown**2 / (LENGTH_M * WIDTH_M), rel=0.05)
    underside = surface.normal[:, 2] < -0.9
    assert (view.camera[underside] == Visibility.BY_PARTS).all()


@pytest.mark.parametrize("lean_rad", [0.0, 0.7, 1.3, 1.5])
def test_a_convex_part_does_not_hide_faces_towards_the_camera(lean_rad):
    """A convex body does not hide faces that point to the eye, even very steep faces."""
    rig = make_rig(centred(300, 250, 150), centred(900, 700, 500))
    scene = plate_in_bin(rig, (0.1, 0.05, 0.9), rim_m=0.0065)
    turn = np.array([[np.cos(lean_rad), 0, np.sin(lean_rad)], [0, 1, 0]])
    turn = np.vstack([turn, np.cross(turn[0], turn[1])])
    layout = Layout(
        T_world_part=rigid(turn, np.array([0.0, 0.0, 0.4]))[None], part_index=np.array([0])
    )
    surface = spread_surface(scene, layout, points=POINTS, cone_deg=0.0)
    visible = view_of(scene, layout, surface).camera == Visibility.VISIBLE
    towards = ((scene.T_world_cam[:3, 3] - surface.point_m) * surface.normal).sum(axis=-1) > 0
    assert (visible == towards).mean() > 0.999


@pytest.mark.slow
def test_a_small_picture_and_a_large_one_show_the_same_surface():
    """A camera with 30 pixels sees the same surface as one with 300 pixels."""
    for times in (1, 10):
        camera = centred(30 * times, 24 * times, 40 * times)
        rig = make_rig(camera, centred(900, 700, 500), baseline_m=(0.05, 0, 0))
        scene = plate_in_bin(rig, (0.06, 0.0, THICK_M + 0.4), rim_m=0.05)
        surface = spread_surface(scene, ON_THE_FLOOR, points=5000, cone_deg=0.0)
        visibility = view_of(scene, ON_THE_FLOOR, surface).camera
        if times == 1:
            first = visibility
    assert LEAST_PX > 300
    assert (first == visibility).mean() > 0.998


# --- fates of points ---------------------------------------------------------------------------


@cache
def plate_in_view(projector_px: int):
    """Return a plate that both devices see completely, with its surface and its visibility."""
    projector = centred(300, 250, projector_px)
    rig = make_rig(centred(120, 100, 200), projector, baseline_m=(0.05, 0, 0))
    scene = plate_in_bin(rig, (0.0, 0.0, THICK_M + 0.7), rim_m=0.0065)
    surface = spread_surface(scene, ON_THE_FLOOR, points=POINTS, cone_deg=0.0)
    return scene, surface, view_of(scene, ON_THE_FLOOR, surface)


def plate_figures(
    error_m: float = 0.0, reason=Reason.DECODED, *, noise_m: float = 0.0, projector_px: int = 400
):
    """Return the figures of a flat plate, fully visible, with the given depth errors."""
    scene, surface, view = plate_in_view(projector_px)
    shape = (100, 120)
    true_m = np.full(shape, 0.7)
    nan = np.full(shape, np.nan)
    depth_m = true_m + error_m + noise_m * np.random.default_rng(1).normal(size=shape)
    depth = DepthMap(
        depth_m=depth_m if reason is Reason.DECODED else nan,
        sigma_m=nan.copy(),
        reason=np.full(shape, int(reason), dtype=np.uint8),
        camera=scene.rig.camera,
    )
    truth = GroundTruth(
        depth_m=true_m,
        normal=np.zeros((*shape, 3)),
        instance=np.zeros(shape, dtype=np.int64),
        amodal=(),
    )
    point_fates = judge(view, surface, truth, depth, wrong_m=0.005)
    return figures(scene, view, surface, point_fates, seconds=1.0)


@pytest.mark.parametrize(
    ("error_m", "reason", "fate"),
    [
        (0.0, Reason.DECODED, Fate.MEASURED),
        (0.0049, Reason.DECODED, Fate.MEASURED),
        (-0.0051, Reason.DECODED, Fate.WRONG),
        (0.0, Reason.SHADOW, Fate.DARK),  # The projector lights this point.
        (0.0, Reason.LOW_MODULATION, Fate.DARK),
        (0.0, Reason.SATURATED, Fate.GLARE),
        (0.0, Reason.CONTRADICTORY, Fate.INTERREFLECTION),
        (0.0, Reason.INTERREFLECTION, Fate.INTERREFLECTION),
        (0.0, Reason.OUTLIER, Fate.FILTERED),
        (0.0, Reason.OUT_OF_RANGE, Fate.OUT_OF_RANGE),
    ],
)
def test_every_surface_point_has_exactly_one_fate(error_m, reason, fate):
    record = plate_figures(error_m, reason)
    assert record["share"][fate] == pytest.approx(1.0)
    assert sum(record["share"].values()) == pytest.approx(1.0)
    assert list(record["share"]) == list(FATES)
    if fate is Fate.MEASURED:
        assert record["bias_m"] == pytest.approx(error_m)
        assert record["of_seen"] == pytest.approx(1.0)
    else:
        assert record["sigma_m"] is None and record["feature_m"] is None


def test_sigma_bias_and_feature_follow_from_the_errors():
    """Oracle: normal errors. Over 12 000 pixels, the standard error of sigma from quantiles is
    1.2 %, and that of the median is 0.0125 sigma."""
    record = plate_figures(0.0003, noise_m=0.0004)
    assert record["sigma_m"] == pytest.approx(0.0004, rel=0.05)
    assert record["bias_m"] == pytest.approx(0.0003, abs=2e-5)
    assert record["pixel_m"] == pytest.approx(0.7 / 200)  # of the camera, coarser than 0.7 / 400
    assert record["feature_m"] == pytest.approx(3 * 0.7 / 200)
    assert plate_figures(projector_px=100)["pixel_m"] == pytest.approx(0.7 / 100)


VISIBLE, OUTSIDE, BY_PARTS, BY_BIN = (
    Visibility.VISIBLE,
    Visibility.OUTSIDE,
    Visibility.BY_PARTS,
    Visibility.BY_BIN,
)


@pytest.mark.parametrize(
    ("camera", "projector", "own", "reason", "fate"),
    [
        (OUTSIDE, VISIBLE, True, Reason.DECODED, Fate.OUTSIDE_PICTURE),
        (BY_BIN, VISIBLE, True, Reason.DECODED, Fate.HIDDEN_BY_WALL),
        (BY_PARTS, BY_BIN, False, Reason.DECODED, Fate.HIDDEN_BY_PARTS),
        (VISIBLE, BY_PARTS, True, Reason.DECODED, Fate.MEASURED),
        (VISIBLE, OUTSIDE, True, Reason.SHADOW, Fate.OUTSIDE_PROJECTOR),
        (VISIBLE, BY_BIN, True, Reason.LOW_MODULATION, Fate.WALL_SHADOW),
        (VISIBLE, BY_PARTS, False, Reason.DECODED, Fate.PART_SHADOW),
        (VISIBLE, VISIBLE, False, Reason.DECODED, Fate.EDGE),
        (VISIBLE, VISIBLE, False, Reason.SATURATED, Fate.EDGE),
    ],
)
def test_geometry_takes_precedence_over_the_decoder_s_reason(camera, projector, own, reason, fate):
    surface, view = one_point(camera, projector)
    decoded = reason is Reason.DECODED
    truth = GroundTruth(
        depth_m=np.ones((1, 1)), normal=np.zeros((1, 1, 3)),
        instance=np.array([[0 if own else 1]]), amodal=(),
    )  # fmt: skip
    depth = DepthMap(
        depth_m=np.where(decoded, 1.0, np.full((1, 1), np.nan)), sigma_m=np.ones((1, 1)),
        reason=np.array([[int(reason)]], np.uint8), camera=centred(1, 1, 1.0),
    )  # fmt: skip
    point_fates = judge(view, surface, truth, depth, wrong_m=0.005)
    assert FATES[point_fates.fate[0]] is fate


def one_point(camera, projector, *, weight=(1.0,)):
    """Return one point for each weight; all are at the same pixel."""
    many = np.ones(len(weight))
    surface = HeapSurface(
        point_m=np.zeros((len(weight), 3)), normal=np.zeros((len(weight), 3)),
        instance=np.zeros(len(weight), int), weight=np.array(weight),
    )  # fmt: skip
    view = SurfaceView(
        camera=many.astype(int) * camera, projector=many.astype(int) * projector,
        row=np.zeros(len(weight), int), column=np.zeros(len(weight), int),
        z_m=many.copy(), z_projector_m=many.copy(),
    )  # fmt: skip
    return surface, view


def test_figures_weight_points_by_their_area_from_above():
    """The visible weight is 0.7 and the measured weight 0.5, of which 0.4 is 0.2 mm too far."""
    surface, view = one_point(VISIBLE, VISIBLE, weight=(4.0, 1.0, 2.0, 3.0, 0.0))
    fates = (Fate.MEASURED, Fate.MEASURED, Fate.DARK, Fate.HIDDEN_BY_PARTS, Fate.MEASURED)
    point_fates = PointFates(
        fate=np.array([FATES.index(fate) for fate in fates]),
        error_m=np.array([2e-4, 9e-4, np.nan, np.nan, 1.0]),
    )
    scene = plate_in_bin(
        make_rig(centred(120, 100, 200), centred(300, 250, 400)), (0.0, 0.0, 0.7), rim_m=0.01
    )
    record = figures(scene, view, surface, point_fates, seconds=1.0)
    assert record["points"] == 4
    assert record["measured"] == pytest.approx(0.5)
    assert record["of_seen"] == pytest.approx(0.5 / 0.7)
    assert record["share"][Fate.DARK] == pytest.approx(0.2)
    assert record["bias_m"] == 2e-4 and record["sigma_m"] == pytest.approx(0.7e-3 / 2)
