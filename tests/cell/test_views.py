"""Poses from which scanners take their images: valid sections, and poses drawn from them."""

import numpy as np
import pytest
import yaml

from graycast.base.errors import ConfigError, GraycastError
from graycast.base.frames import axis_rotation, inverse, is_rigid, rigid
from graycast.base.streams import OF_IMAGE, image_seeds, scene_seeds
from graycast.cell.config import load_config
from graycast.cell.resolve import eyes, reach_m, require_one_still_image, resolve_cell
from graycast.rig.pair import frame_in_camera
from graycast.world.scene import bin_of

PARTS = {"parts": [{"builtin": "metal_workpiece_1"}], "resolution": "small"}
ASIDE = [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def resolved(folder, **sections):
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(PARTS | sections), encoding="utf-8")
    return resolve_cell(load_config(path), folder)


def poses(cell, seed=0, sensor=""):
    return np.stack([eye.T_world_cam for eye in eyes(cell, seed) if eye.sensor == sensor])


def middles(cell, T_world_cam):
    """Return the middles of the baselines, and the directions of the axes."""
    T = T_world_cam @ frame_in_camera(cell.scene.rig)
    return T[:, :3, 3], T[:, :3, 2]


@pytest.mark.slow
def test_each_view_in_a_list_has_the_pose_of_an_equal_single_view(tmp_path):
    one = {"tilt_deg": 20.0, "azimuth_deg": 50.0}
    cell = resolved(tmp_path, views=[{}, one])
    assert cell.images == (("", 0), ("", 1))
    assert not cell.draws_views
    alone = resolved(tmp_path, view=one)
    np.testing.assert_array_equal(poses(cell)[1], alone.scene.T_world_cam)
    np.testing.assert_array_equal(cell.scene.T_world_cam, resolved(tmp_path).scene.T_world_cam)


@pytest.mark.slow
def test_dome_views_are_uniform_over_their_solid_angle_and_look_at_the_target(tmp_path):
    """Oracle: equal heights of a sphere have equal areas (Archimedes), so cos(tilt) is uniform."""
    views = {"kind": "dome", "count": 400, "distance_m": [0.8, 1.1], "tilt_deg": [10, 50]}
    cell = resolved(tmp_path, views=views, view={"target_m": [0.01, 0.02, 0.03]})
    assert cell.draws_views
    middle, axis = middles(cell, poses(cell, seed=3))
    away = middle - np.array([0.01, 0.02, 0.03])
    distance = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(axis, -away / distance[:, None], atol=1e-12)
    assert 0.8 <= distance.min() < 0.81 and 1.09 < distance.max() <= 1.1
    height = away[:, 2] / distance
    low, high = np.cos(np.radians([50, 10]))
    assert low <= height.min() and height.max() <= high
    sigma = (high - low) / np.sqrt(12 * len(height))
    assert abs(height.mean() - (low + high) / 2) < 4 * sigma
    around = np.exp(1j * np.arctan2(away[:, 1], away[:, 0]))
    assert abs(around.mean()) < 4 / np.sqrt(2 * len(around))


def test_view_poses_are_drawn_from_the_seed_of_their_scene(tmp_path):
    cell = resolved(tmp_path, views={"kind": "dome", "count": 3})
    np.testing.assert_array_equal(poses(cell, seed=7), poses(cell, seed=7))
    assert np.abs(poses(cell, seed=7) - poses(cell, seed=8)).max(axis=(1, 2)).min() > 1e-3


def test_views_on_a_path_are_evenly_spaced_from_the_first_waypoint_to_the_last(tmp_path):
    """A rotation of 90 degrees in 9 steps: 10 degrees and a ninth of the distance each."""
    start = rigid(np.diag([1.0, -1.0, -1.0]), np.array([-0.3, 0.0, 0.9]))
    end = rigid(axis_rotation("z", np.pi / 2) @ start[:3, :3], np.array([0.3, 0.0, 0.9]))
    waypoints = [{"T_world_cam": T.ravel().tolist()} for T in (start, end)]
    cell = resolved(tmp_path, views={"kind": "path", "count": 10, "waypoints": waypoints})
    T = poses(cell)
    np.testing.assert_allclose(T[[0, -1]], [start, end], atol=1e-12)
    step = inverse(T[:-1]) @ T[1:]
    turned = np.degrees(np.arccos((np.trace(step[:, :3, :3], axis1=1, axis2=2) - 1) / 2))
    np.testing.assert_allclose(turned, 10.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(T[:, :3, 3], axis=0), [[0.6 / 9, 0, 0]] * 9, atol=1e-12)


@pytest.mark.slow
def test_view_jitter_has_the_stated_sigma_and_is_cut_at_three_sigma(tmp_path):
    """A normal distribution cut at 3 sigma keeps 0.9866 of its standard deviation."""
    views = {"kind": "jitter", "count": 400, "position_m": 0.02, "rotation_deg": 1.5}
    cell = resolved(tmp_path, views=views, view={"tilt_deg": 10})
    nominal = resolved(tmp_path, view={"tilt_deg": 10}).scene.T_world_cam
    T = poses(cell, seed=5)
    assert all(is_rigid(one) for one in T)
    moved = T[:, :3, 3] - nominal[:3, 3]
    assert np.abs(moved).max() <= 0.06
    assert moved.std() == pytest.approx(0.02 * 0.9866, rel=4 / np.sqrt(2 * moved.size))
    turn = nominal[:3, :3].T @ T[:, :3, :3]
    about = np.degrees([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])  # for small rotations
    assert about.std() == pytest.approx(1.5 * 0.9866, rel=4 / np.sqrt(2 * about.size))


def test_a_mounted_scanner_keeps_its_pose_relative_to_the_first_scanner(tmp_path):
    cell = resolved(
        tmp_path,
        views={"kind": "dome", "count": 4},
        scanners=[
            {"name": "hand", "rig": "like-phoxi-s"},
            {"name": "by-it", "rig": "paper", "T_first_cam": ASIDE},
            {"name": "fixed", "rig": "paper", "views": [{}]},
        ],
    )
    names = [name for name, _ in cell.images]
    assert names == ["hand"] * 4 + ["by-it"] * 4 + ["fixed"]
    first, mounted = poses(cell, 9, "hand"), poses(cell, 9, "by-it")
    np.testing.assert_allclose(
        inverse(first) @ mounted, [np.reshape(ASIDE, (4, 4))] * 4, atol=1e-12
    )
    np.testing.assert_array_equal(
        poses(cell, 9, "fixed")[0], resolved(tmp_path, rig="paper").scene.T_world_cam
    )


def test_scanners_of_the_shelf_can_be_moved_together_to_several_poses(tmp_path):
    """Each scanner has its own camera and takes the pose of the first, as on a robot's hand."""
    names = ("like-zivid-2-m70", "like-mech-eye-pro-s")
    views = [{"distance_m": 0.7}, {"distance_m": 0.7, "tilt_deg": 20}]
    scanners = [{"name": name, "rig": name} for name in names]
    cell = resolved(tmp_path, views=views, scanners=scanners)
    assert [scanner.rig.name for _, scanner in cell.scanners] == list(names)
    assert [scanner.rig.camera.width_px for _, scanner in cell.scanners] == [486, 480]
    assert len(cell.images) == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "views",
    [
        {"kind": "dome", "count": 50, "distance_m": [0.7, 1.4], "tilt_deg": [0, 60]},
        {"kind": "jitter", "count": 50, "position_m": 0.05, "rotation_deg": 5},
        [{}, {"distance_m": 1.5, "tilt_deg": 45}],
    ],
)
def test_the_depth_range_of_files_includes_the_bin_from_every_drawn_pose(tmp_path, views):
    cell = resolved(tmp_path, views=views)
    corners = np.stack(np.meshgrid(*bin_of(cell.scene).bounds_m.T), axis=-1).reshape(-1, 3)
    reach = reach_m(cell)
    for seed in range(10):
        for T in poses(cell, seed):
            deepest = ((corners - T[:3, 3]) @ T[:3, 2]).max()
            assert deepest <= reach + 1e-9


def test_the_first_image_uses_the_scene_s_seeds_and_other_images_use_new_seeds():
    scene = scene_seeds(5, 2)
    assert image_seeds(5, 2, station=0, image=0) == {name: scene[name] for name in OF_IMAGE}
    seeds = [
        seed
        for station in range(3)
        for image in range(4)
        for seed in image_seeds(5, 2, station=station, image=image).values()
    ]
    assert len(set(seeds)) == 3 * 4 * len(OF_IMAGE)
    assert not set(seeds) & set(image_seeds(5, 3, station=1, image=1).values())


def inside(x_m, y_m, z_m):
    return {"T_world_cam": [1, 0, 0, x_m, 0, -1, 0, y_m, 0, 0, -1, z_m, 0, 0, 0, 1]}


BAD = {
    "an empty list": ({"views": []}, "views"),
    "no list": ({"views": "many"}, "give a list of places, or a mapping whose kind is dome"),
    "no such sampler": ({"views": {"kind": "spiral", "count": 3}}, "dome, path or jitter"),
    "a sampler without a kind": ({"views": {"count": 3}}, "dome, path or jitter"),
    "a key that a sampler lacks": (
        {"views": {"kind": "dome", "count": 3, "tilt": [0, 10]}},
        "unknown key views.tilt: did you mean tilt_deg?",
    ),
    "a key that a place lacks": (
        {"views": [{}, {"tilt": 3}]},
        "unknown key views.1.tilt: did you mean tilt_deg?",
    ),
    "no count": ({"views": {"kind": "jitter"}}, "views.count is missing: add it"),
    "a count of none": ({"views": {"kind": "dome", "count": 0}}, "views.count is 0"),
    "a path of one waypoint": (
        {"views": {"kind": "path", "count": 3, "waypoints": [{}]}},
        "views.waypoints",
    ),
    "a span upside down": (
        {"views": {"kind": "dome", "count": 3, "tilt_deg": [30, 10]}},
        "[lowest, highest] in this order",
    ),
    "view beside a list": (
        {"view": {"tilt_deg": 5}, "views": [{}]},
        "view and views both say where the rig hangs",
    ),
    "a tilted view beside a dome": (
        {"view": {"tilt_deg": 5}, "views": {"kind": "dome", "count": 3}},
        "view and views both say where the rig hangs",
    ),
    "a camera in the bin": ({"views": [{}, inside(0, 0, 0.1)]}, "image 1: the camera is at (0.000"),
    "a camera under the floor": ({"views": [inside(0.5, 0, -0.1)]}, "inside the bin or under"),
    "a camera that looks up": (
        {"view": {"T_world_cam": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.9, 0, 0, 0, 1]}},
        "image 0: no part of the bin is in the camera's picture, because the camera looks along "
        "(0.00, 0.00, 1.00)",
    ),
    "a camera that looks past the bin": (
        {"views": [{}, inside(2.5, 0, 0.9)]},
        "image 1: no part of the bin is in the camera's picture",
    ),
    "a dome in the bin": (
        {"views": {"kind": "dome", "count": 3, "distance_m": [0.05, 0.06]}},
        "bring it above the rim",
    ),
    "no scanner": ({"scanners": []}, "scanners"),
    "two scanners of a name": (
        {"scanners": [{"name": "a"}, {"name": "A"}]},
        "two scanners are called a: give one another name",
    ),
    "a name with a slash": ({"scanners": [{"name": "a/b"}]}, "letters, digits and hyphens"),
    "a name with a line": ({"scanners": [{"name": "a_sl"}]}, "letters, digits and hyphens"),
    "a name of another meaning": ({"scanners": [{"name": "visib"}]}, "choose another"),
    "a scanner without a name": ({"scanners": [{"rig": "paper"}]}, "name is missing"),
    "an unknown rig": (
        {"scanners": [{"name": "a", "rig": "phoxi"}]},
        "scanner a: rig: no rig 'phoxi'",
    ),
    "a rig beside scanners": (
        {"rig": "like-phoxi-m", "scanners": [{"name": "a"}]},
        "rig and scanners are both given",
    ),
    "a section beside scanners": (
        {"code": {"axes": ["column", "row"]}, "scanners": [{"name": "a"}]},
        "code and scanners are both given",
    ),
    "a first scanner mounted on itself": (
        {"scanners": [{"name": "a", "T_first_cam": ASIDE}]},
        "scanner a is the first",
    ),
    "two mountings": (
        {"scanners": [{"name": "a"}, {"name": "b", "T_first_cam": ASIDE, "views": [{}]}]},
        "remove it, or views",
    ),
    "no pose": ({"scanners": [{"name": "a"}, {"name": "b", "T_first_cam": [1]}]}, "give 16"),
}


@pytest.mark.parametrize("name", BAD)
def test_the_error_for_a_wrong_view_is_one_line_that_names_the_view(tmp_path, name):
    sections, must = BAD[name]
    with pytest.raises((ConfigError, GraycastError)) as error:
        resolved(tmp_path, **sections)
    text = str(error.value)
    assert must in text, text
    assert "\n" not in text


def test_functions_for_one_image_refuse_a_cell_with_several_images(tmp_path):
    one, two = resolved(tmp_path), resolved(tmp_path, views=[{}, {"tilt_deg": 10}])
    require_one_still_image(one, "graycast rig design")
    with pytest.raises(ConfigError, match="graycast rig design takes one image of a scene: remove"):
        require_one_still_image(two, "graycast rig design")
