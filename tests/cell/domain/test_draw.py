"""Drawn values have the stated distributions, and each section has its own random stream."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cells import cell, domain
from scipy import stats

from graycast.base.errors import ConfigError
from graycast.base.frames import inverse, transform_points
from graycast.cell.domain import draw
from graycast.cell.domain.draw import in_the_way, views
from graycast.cell.domain.vary import lamp_of
from graycast.world.scene import Lamp

DRAWS = 150
WIDE = {
    "kind": "randomized",
    "camera": {
        "distance_factor": [0.8, 2.0],
        "tilt_deg": [-20, 40],
        "roll_deg": [-10, 30],
        "shift_m": [-0.1, 0.3],
    },
    "environment": {"radiance": [0.01, 1.0], "color_temperature_k": [2000, 10000]},
    "lamps": {
        "count": [2, 4],
        "distance_m": [2.5, 4.0],
        "elevation_deg": [10, 70],
        "size_m": [0.05, 0.5],
        "irradiance": [0.01, 10.0],
    },
    "bin": {"size_factor": [0.7, 1.4], "metal_share": 0.3, "color": {"hue_deg": [90, 200]}},
    "parts": {"brightness": [0.2, 2.0], "tint": [0.5, 2.0], "repainted_share": 0.25},
    "distractors": {"count": [0, 4]},
}
P = 1e-3  # probability that a correct program fails one of these tests, if its seed were not fixed


@pytest.fixture(scope="module")
def records():
    scene = cell()
    wide = domain(scene, WIDE)
    return [draw(wide, scene, (10, 0), np.random.default_rng(seed)) for seed in range(DRAWS)]


def is_uniform(values, low, high):
    values = np.array(values)
    assert low <= values.min() and values.max() <= high
    return stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > P


def is_log_uniform(values, low, high):
    return is_uniform(np.log(values), math.log(low), math.log(high))


def test_the_drawn_pose_of_the_rig_has_the_stated_distributions(records):
    cameras = [record["camera"] for record in records]
    assert is_log_uniform([d["distance_factor"] for d in cameras], 0.8, 2.0)
    assert is_uniform(np.degrees([d["tilt_rad"] for d in cameras]), -20, 40)
    assert is_uniform(np.degrees([d["azimuth_rad"] for d in cameras]), -180, 180)
    assert is_uniform(np.degrees([d["roll_rad"] for d in cameras]), -10, 30)
    shift = np.array([d["shift_m"] for d in cameras])
    assert all(is_uniform(along, -0.1, 0.3) for along in shift.T)
    assert np.abs(np.corrcoef(shift.T) - np.eye(3)).max() < 4 / math.sqrt(DRAWS)


def test_drawn_lamps_have_the_stated_number_and_are_uniform_over_the_sky(records):
    numbers = np.bincount([len(record["lamps"]) for record in records], minlength=5)
    assert stats.chisquare(numbers[2:], np.full(3, DRAWS / 3)).pvalue > P
    assert numbers[:2].sum() == 0
    lamps = [lamp for record in records for lamp in record["lamps"]]
    low, high = np.sin(np.radians([10, 70]))
    # Equal areas of the sphere are between equal steps of height (Archimedes).
    assert is_uniform(np.sin([lamp["elevation_rad"] for lamp in lamps]), low, high)
    assert not is_uniform(np.degrees([lamp["elevation_rad"] for lamp in lamps]), 10, 70)
    assert is_uniform(np.degrees([lamp["azimuth_rad"] for lamp in lamps]), -180, 180)
    assert is_uniform([lamp["distance_m"] for lamp in lamps], 2.5, 4.0)
    assert is_log_uniform([lamp["size_m"] for lamp in lamps], 0.05, 0.5)
    assert is_log_uniform([lamp["irradiance"] for lamp in lamps], 0.01, 10.0)
    assert not is_uniform([lamp["irradiance"] for lamp in lamps], 0.01, 10.0)
    assert is_uniform([lamp["color_temperature_k"] for lamp in lamps], 2700, 6500)


def test_drawn_light_colours_sizes_and_counts_have_the_stated_distributions(records):
    assert is_log_uniform([r["environment"]["radiance"] for r in records], 0.01, 1.0)
    assert is_uniform([r["environment"]["color_temperature_k"] for r in records], 2000, 10000)
    assert is_log_uniform([r["bin"]["size_factor"] for r in records], 0.7, 1.4)
    assert is_uniform([r["bin"]["color"]["hue_deg"] for r in records], 90, 200)
    assert is_uniform([r["table"]["color"]["hue_deg"] for r in records], 0, 360)
    assert is_uniform([r["table"]["color"]["value"] for r in records], 0.1, 0.9)
    assert is_uniform([r["bin"]["roughness"] for r in records], 0.3, 1.0)
    assert is_uniform([r["count_share"] for r in records], 0.5, 1.0)
    assert {r["table"]["metallic"] for r in records} == {0.0}
    metal = sum(r["bin"]["metallic"] for r in records)
    assert stats.binomtest(int(metal), DRAWS, 0.3).pvalue > P
    parts = [part for r in records for part in r["parts"].values()]
    assert is_log_uniform([part["brightness"] for part in parts], 0.2, 2.0)
    assert is_log_uniform([tint for part in parts for tint in part["tint"]], 0.5, 2.0)
    repainted = sum(part["color"] is not None for part in parts)
    assert stats.binomtest(repainted, len(parts), 0.25).pvalue > P


def test_every_number_of_distractors_is_equally_likely(records):
    numbers = np.bincount([sum(record["distractors"].values()) for record in records])
    assert stats.chisquare(numbers, np.full(5, DRAWS / 5)).pvalue > P
    each = np.sum([list(record["distractors"].values()) for record in records], axis=0)
    assert stats.binomtest(int(each[0]), int(each.sum()), 0.5).pvalue > P


def test_distractors_leave_enough_room_for_the_parts():
    scene = cell()
    many = domain(scene, {"kind": "randomized", "count_share": [1, 1],
                          "distractors": {"count": [200, 200]}})  # fmt: skip
    record = draw(many, scene, (150, 100), np.random.default_rng(0))
    assert sum(record["distractors"].values()) == 5


def test_drawn_tolerances_are_independent_and_uniform_in_each_direction():
    scene = cell()
    settings = {"kind": "adapted", "camera": {"position_m": 0.02, "rotation_deg": 3}}
    settings |= {"bin": {"position_m": 0.05, "rotation_deg": 7}}
    settings |= {"lamps": {"position_m": 0.1, "level": 0.2, "environment_level": 0.5}}
    settings |= {"parts": {"reflectance": 0.3, "roughness": 0.2}}
    own = domain(scene, settings)
    draws = [draw(own, scene, (1, 1), np.random.default_rng(seed)) for seed in range(DRAWS)]
    table = np.array(
        [
            [
                *np.array(d["camera"]["offset_m"]) / 0.02,
                *np.degrees(d["camera"]["rotation_rad"]) / 3,
                *np.array(d["bin"]["offset_m"]) / 0.05,
                np.degrees(d["bin"]["turn_rad"]) / 7,
                *np.array([lamp["offset_m"] for lamp in d["lamps"]]).ravel() / 0.1,
                *[(lamp["level"] - 1) / 0.2 for lamp in d["lamps"]],
                (d["environment"]["level"] - 1) / 0.5,
                *[(part["brightness"] - 1) / 0.3 for part in d["parts"].values()],
                *[part["roughness"] / 0.2 for part in d["parts"].values()],
            ]
            for d in draws
        ]
    )
    assert table.shape == (DRAWS, 22)
    assert all(is_uniform(column, -1, 1) for column in table.T)
    assert np.abs(np.corrcoef(table.T) - np.eye(22)).max() < 4.5 / math.sqrt(DRAWS)


def test_changing_one_domain_section_does_not_change_values_drawn_for_others():
    scene = cell()
    own = domain(scene, WIDE)
    ours = draw(own, scene, (5, 5), np.random.default_rng(4))
    for name in ("camera", "environment", "bin", "lamps", "table", "parts", "distractors"):
        other = replace(own, section=own.section.model_copy(update={name: None}))
        theirs = draw(other, scene, (5, 5), np.random.default_rng(4))
        assert theirs.get(name, {}) != ours[name]
        rest = {key: value for key, value in theirs.items() if key != name}
        assert rest == {key: value for key, value in ours.items() if key != name}


def test_no_drawn_lamp_is_in_the_bin_or_in_the_rig_s_view():
    scene = cell()
    T, depth_m, cones = scene.T_world_cam, 0.5, views(scene)
    in_view = tuple((T[:3, 3] + depth_m * T[:3, 2]).tolist())
    proj = T @ scene.rig.T_cam_proj
    in_beam = tuple((proj[:3, 3] + depth_m * proj[:3, 2]).tolist())
    behind = tuple((T[:3, 3] - 1.0 * T[:3, 2]).tolist())
    for center, is_in_the_way in (
        (in_view, True),
        (in_beam, True),
        (behind, False),
        ((0.0, 0.0, 0.2), True),
        ((1.0, 0.0, 0.5), False),
    ):
        assert in_the_way(Lamp(center_m=center, size_m=0.1), scene, cones) == is_in_the_way, center
    assert in_the_way(Lamp(center_m=behind, size_m=3.0), scene, cones)  # as large as its distance
    near = {"distance_m": [0.4, 1.5], "elevation_deg": [5, 90], "size_m": [0.1, 0.3]}
    own = domain(scene, {"kind": "randomized", "camera": None, "lamps": {**near, "count": [9, 9]}})
    for seed in range(5):
        record = draw(own, scene, (1, 1), np.random.default_rng(seed))
        assert not any(in_the_way(lamp_of(lamp, scene), scene, cones) for lamp in record["lamps"])


def ball(center_m, radius_m):
    """Return points all over the surface of a ball."""
    direction = np.random.default_rng(1).normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return center_m + radius_m * direction


def is_visible(point_m, T_world_lens, lens):
    """Return the points that an undistorted lens sees inside its picture."""
    x, y, z = transform_points(inverse(T_world_lens), point_m).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = lens.fx_px * x / z + lens.cx_px, lens.fy_px * y / z + lens.cy_px
    inside = (np.abs(u - (lens.width_px - 1) / 2) < lens.width_px / 2) & (
        np.abs(v - (lens.height_px - 1) / 2) < lens.height_px / 2
    )
    return inside & (z > 0)


def test_no_point_of_a_drawn_lamp_is_visible_or_inside_the_bin():
    """Oracle: the ball of all rotations of the lamp's square, projected by an explicit formula."""
    scene = cell()
    near = {"distance_m": [0.4, 1.5], "elevation_deg": [5, 90], "size_m": [0.1, 0.5]}
    own = domain(scene, {"kind": "randomized", "camera": None, "lamps": {**near, "count": [9, 9]}})
    T_world_proj = scene.T_world_cam @ scene.rig.T_cam_proj
    low_m, high_m = scene.bin.bounds_m
    for seed in range(10):
        record = draw(own, scene, (1, 1), np.random.default_rng(seed))
        for lamp in (lamp_of(lamp_record, scene) for lamp_record in record["lamps"]):
            point_m = ball(np.array(lamp.center_m), lamp.size_m / math.sqrt(2))
            assert not is_visible(point_m, scene.T_world_cam, scene.rig.camera).any()
            assert not is_visible(point_m, T_world_proj, scene.rig.projector).any()
            assert not ((point_m > low_m) & (point_m < high_m)).all(axis=-1).any()


@pytest.mark.parametrize("size_m", [0.1, 1.0])
def test_a_lamp_is_in_the_way_if_its_bounding_ball_overlaps_that_around_the_bin(size_m):
    """Bin and lamp touch if the distance of their centres is the sum of their half diagonals."""
    scene = cell()
    low_m, high_m = scene.bin.bounds_m
    touching_m = (math.dist(low_m, high_m) + size_m * math.sqrt(2)) / 2
    for gap_m, is_in_the_way in ((-1e-6, True), (1e-6, False)):
        center_m = (low_m + high_m) / 2 + (touching_m + gap_m) * np.array([0.6, 0.0, 0.8])
        lamp = Lamp(center_m=tuple(center_m.tolist()), size_m=size_m)
        assert in_the_way(lamp, scene, ()) == is_in_the_way


def test_a_cone_around_the_whole_picture_decides_if_a_ball_is_in_view():
    """Oracle: the angles of points of balls; balls that almost touch are left out."""
    rig = cell().rig
    scene = cell(rig=replace(rig, camera=replace(rig.camera, cx_px=300.0, cy_px=450.0)))
    rng, met = np.random.default_rng(2), []
    for cone, lens in zip(views(scene), (scene.rig.camera, scene.rig.projector), strict=True):
        aside = max(lens.cx_px + 0.5, lens.width_px - 0.5 - lens.cx_px) / lens.fx_px
        above = max(lens.cy_px + 0.5, lens.height_px - 0.5 - lens.cy_px) / lens.fy_px
        corner = math.hypot(aside, above)
        assert math.tan(cone.half_angle_rad) == pytest.approx(corner, rel=1e-9)
        for _ in range(100):
            center_m, radius_m = cone.apex_m + rng.uniform(-1, 1, 3), rng.uniform(0.05, 0.4)
            center_m += 0.5 * cone.axis
            away_m = ball(center_m, radius_m) - cone.apex_m
            angle = np.arccos(away_m @ cone.axis / np.linalg.norm(away_m, axis=-1))
            least = float(angle.min())
            if abs(least - cone.half_angle_rad) < 0.02:
                continue  # nearer than the distance of points on the ball
            met.append(cone.meets(center_m, radius_m))
            inside = np.linalg.norm(center_m - cone.apex_m) <= radius_m
            assert met[-1] == (inside or least < cone.half_angle_rad)
    assert 0.2 < np.mean(met) < 0.8


@pytest.mark.slow
def test_lamps_for_which_no_place_is_free_are_refused():
    scene = cell()
    settings = {"kind": "randomized", "lamps": {"distance_m": [0.1, 0.1], "count": [1, 1]}}
    with pytest.raises(
        ConfigError, match=r"domain\.lamps: 1000 consecutive lamps were inside the bin"
    ):
        draw(domain(scene, settings), scene, (1, 1), np.random.default_rng(0))


def test_a_domain_that_could_put_the_rig_below_the_rim_is_refused():
    scene = cell()
    settings = {"kind": "randomized", "camera": {"tilt_deg": [80, 80]}}
    with pytest.raises(ConfigError, match=r"domain\.camera: camera or projector comes to z = "):
        draw(domain(scene, settings), scene, (1, 1), np.random.default_rng(0))
