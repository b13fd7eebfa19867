"""Figures of settings after rendering, sensor and decoder, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from stage import centred, make_rig
from test_surface import LENGTH_M, ON_THE_FLOOR, THICK_M, plate, plate_in_bin

from graycast.base.frames import rigid
from graycast.camera.decode import DecodeSpec
from graycast.camera.scanner import Scanner, measure, take
from graycast.rendering import Quality
from graycast.rig.pattern import CodeSpec
from graycast.score.design.heap_surface import spread_surface
from graycast.score.design.point_fates import figures, judge, view_of
from graycast.world.scene import Environment, Layout

PHASE = CodeSpec(codec="gray_phase", axes=("column",), period_px=16.0, steps=4)


def scanned(renderer, scene, layout=ON_THE_FLOOR, *, samples=16, depth=1):
    """Return the figures of a scene for a scanner with phase codes and without filters."""
    scanner = Scanner(rig=scene.rig, code=PHASE, decode=DecodeSpec(max_epipolar_px=0.0))
    dark = replace(scene, environment=Environment(radiance=(0.0, 0.0, 0.0)))
    pattern = scanner.light_code().render(lambda share: np.rint(255 * share).astype(np.uint8))
    rendering = renderer.render(
        dark, layout, pattern, quality=Quality(samples=samples, depth=depth), seed=3
    )
    capture = take(scanner, rendering.radiance, seed=4)
    _, depth_map = measure(scanner, capture, path_noise=rendering.radiance.path_noise)
    surface = spread_surface(scene, layout, points=20_000, cone_deg=0.0)
    view = view_of(scene, layout, surface)
    fates = judge(view, surface, rendering.truth, depth_map, wrong_m=0.005)
    return figures(scene, view, surface, fates, seconds=1.0), depth_map, rendering.truth


@pytest.mark.slow
def test_sigma_grows_with_the_square_of_the_distance(mitsuba_renderer):
    """Oracle: for parallel axes, z = f b / d, so sigma_z = z^2 / (f b) sigma_d. The automatic
    exposure keeps the brightness, so sigma_d (shot noise) is the same at all distances."""
    sigma_m = []
    distances_m = (0.5, 0.7, 1.0)
    for z_m in distances_m:
        rig = make_rig(centred(320, 240, 500), centred(800, 600, 700), baseline_m=(0.1, 0, 0))
        scene = plate_in_bin(rig, (-0.05, 0.0, THICK_M + z_m), rim_m=0.0065)
        sigma_m.append(scanned(mitsuba_renderer, scene, samples=64)[0]["sigma_m"])
    slope = np.polyfit(np.log(distances_m), np.log(sigma_m), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_only_surfaces_in_the_shadow_of_a_wall_are_not_measured(mitsuba_renderer):
    """Oracle: the same triangle as without rendering; here, the decoder finds the shadow's end."""
    baseline_m, height_m, rim_m = 0.4, 0.8, 0.06
    rig = make_rig(centred(400, 300, 500), centred(900, 700, 600), baseline_m=(baseline_m, 0, 0))
    scene = plate_in_bin(rig, (0.0, 0.0, THICK_M + height_m), rim_m=rim_m)
    record, *_ = scanned(mitsuba_renderer, scene)
    dark = rim_m * (baseline_m - LENGTH_M / 2) / (height_m - rim_m) / LENGTH_M
    pixel = height_m / 500 / LENGTH_M
    assert record["share"]["wall_shadow"] == pytest.approx(dark, abs=pixel)
    assert record["measured"] == pytest.approx(1 - dark, abs=2 * pixel)
    assert record["of_seen"] == pytest.approx(1 - dark, abs=2 * pixel)


@pytest.mark.slow
def test_the_smallest_feature_is_resolved_and_a_third_of_its_size_is_not(mitsuba_renderer):
    """A cube is resolved if at least 4 pixels are more than 3 sigma above the plate: 4 pixels are
    entirely inside its top. A third of the side covers at most one pixel."""
    height_m = 0.6
    rig = make_rig(centred(320, 240, 400), centred(800, 600, 700), baseline_m=(0.1, 0, 0))
    bare = plate_in_bin(rig, (-0.05, 0.0, THICK_M + height_m), rim_m=0.0065)
    record, *_ = scanned(mitsuba_renderer, bare)
    raised = {}
    for share in (1.0, 1 / 3):
        side_m = share * record["feature_m"]
        cube = replace(plate(side_m, side_m, side_m), name="cube")
        scene = replace(bare, parts=(*bare.parts, cube))
        poses = np.stack([np.eye(4), rigid(np.eye(3), np.array([0.004, 0.003, THICK_M]))])
        layout = Layout(T_world_part=poses, part_index=np.array([0, 1]))
        _, depth, truth = scanned(mitsuba_renderer, scene, layout)
        above_m = height_m - depth.depth_m
        raised[share] = int((above_m[truth.instance == 1] > 3 * record["sigma_m"]).sum())
        flat = above_m[truth.instance == 0]
        assert (flat > 3 * record["sigma_m"]).mean() < 0.01  # The higher points are the cube.
    assert raised[1.0] >= 4
    assert raised[1 / 3] <= 2
