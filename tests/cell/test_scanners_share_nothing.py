"""Scanners of a cell share no random numbers; the first has the same ones as a single scanner."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from graycast.base.streams import device_seed
from graycast.camera.faults import line_amplitude, places
from graycast.camera.sensor import expose
from graycast.cell.config import load_config
from graycast.cell.resolve import eyes, resolve_cell
from graycast.cell.simulate import cell_seeds, images_of, varied

PARTS = {"parts": [{"builtin": "metal_workpiece_1"}], "resolution": "small"}
UNEVEN = {"sensor": {"prnu": 0.01, "dsnu_e": 20.0}}
MOUNTED = {"T_first_cam": [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}


def resolved(folder, **sections):
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(PARTS | sections), encoding="utf-8")
    return resolve_cell(load_config(path), folder)


def two(*sections):
    return [{"name": "abc"[i], "rig": "paper"} | more for i, more in enumerate(sections)]


def correlation(a, b):
    """Return the correlation of two sets, in standard errors of that of independent sets."""
    a, b = np.ravel(a), np.ravel(b)
    return float(np.corrcoef(a, b)[0, 1] * np.sqrt(len(a)))


def positions(cell, sensor, scenes=12):
    """Return the position of a scanner in each scene."""
    every = [eyes(cell, seed) for seed in range(scenes)]
    return np.array([[e.T_world_cam[:3, 3] for e in each if e.sensor == sensor] for each in every])


@pytest.mark.slow
@pytest.mark.parametrize(
    "views",
    [
        {"kind": "jitter", "count": 5, "position_m": 0.02},
        {"kind": "dome", "count": 5, "distance_m": [0.9, 1.2]},
    ],
)
@pytest.mark.parametrize("of_each", [True, False])
def test_positions_of_two_scanners_are_drawn_independently(tmp_path, views, of_each):
    """This holds if each scanner has its own section or both have that of the configuration."""
    own = {"views": views} if of_each else {}
    scanners = two(own, own)
    cell = resolved(tmp_path, scanners=scanners, **({} if of_each else {"views": views}))
    a, b = positions(cell, "a"), positions(cell, "b")
    for axis in range(3):
        assert abs(correlation(a[..., axis], b[..., axis])) < 4
    alone = resolved(tmp_path, rig="paper", views=views)
    np.testing.assert_array_equal(a, positions(alone, ""))


def flat_field(scanner, seed):
    """Return the mean of evenly lit frames with little noise compared with the fixed pattern."""
    light = np.ones((16, 30, 40), np.float32)
    exposure_s = 4000 / scanner.sensor.responsivity
    frames = expose(light, None, scanner.sensor, exposure_s=exposure_s, seed=seed).frames
    return frames.mean(axis=0)


def test_each_scanner_has_a_constant_fixed_pattern_independent_of_other_scanners(tmp_path):
    cell = resolved(tmp_path, scanners=two(UNEVEN, UNEVEN))
    (_, a), (_, b) = cell.scanners
    assert abs(correlation(flat_field(a, 1), flat_field(b, 2))) < 4
    assert np.corrcoef(flat_field(b, 1).ravel(), flat_field(b, 2).ravel())[0, 1] > 0.8
    assert a.sensor == resolved(tmp_path, rig="paper", **UNEVEN).scanner.sensor
    assert b.sensor == replace(a.sensor, fpn_seed=device_seed(a.sensor.fpn_seed, "b"))


def test_one_device_with_two_settings_has_a_single_fixed_pattern(tmp_path):
    """Two scanners with the same stated seed are the same sensor."""
    same = {"sensor": UNEVEN["sensor"] | {"fpn_seed": 7}}
    cell = resolved(tmp_path, scanners=two(same, same | {"exposure": {"factors": [1, 4]}}))
    (_, a), (_, b) = cell.scanners
    assert a.sensor == b.sensor and a.sensor.fpn_seed == 7


def test_error_rasters_of_two_scanners_are_independent(tmp_path):
    """The preset of a laser scanner has a raster and no other fixed pattern."""
    cell = resolved(tmp_path, scanners=[{"name": n, "rig": "like-phoxi-m"} for n in "ab"])
    seeds = [scanner.sensor.fpn_seed for _, scanner in cell.scanners]
    assert seeds[0] == 0 != seeds[1]
    a, b = (places((50, 60), seed=seed) for seed in seeds)
    assert abs(correlation(a, b)) < 4
    a, b = (line_amplitude((50, 60), 0.5, seed=seed) for seed in seeds)
    assert abs(correlation(np.log(a[::6]), np.log(b[::6]))) < 4


def test_scanners_without_a_fixed_pattern_keep_their_sensor_seed(tmp_path):
    cell = resolved(tmp_path, scanners=two({}, {}))
    assert [scanner.sensor.fpn_seed for _, scanner in cell.scanners] == [0, 0]


def test_seed_0_gives_the_error_raster_of_earlier_versions():
    """So stored data of a single scanner remain comparable."""
    first = np.sqrt(3) * np.random.default_rng(15).uniform(-1, 1, (2, 4, 5))
    np.testing.assert_array_equal(places((4, 5), seed=0), first)


DOMAINS = {
    "adapted": {"kind": "adapted", "camera": {"position_m": 0.02, "rotation_deg": 3}},
    "randomized": {"kind": "randomized", "camera": {"tilt_deg": [0, 25]}, "lamps": None},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", DOMAINS)
def test_a_domain_moves_scanners_independently_except_for_mounted_scanners(tmp_path, kind):
    views = [{"distance_m": 1.0}, {"distance_m": 1.0, "tilt_deg": 10}]
    scanners = two({}, {}, MOUNTED)
    cell = resolved(tmp_path, domain=DOMAINS[kind], views=views, scanners=scanners)
    alone = resolved(tmp_path, domain=DOMAINS[kind], views=views, rig="paper")
    moved = []
    for scene_id in range(25):
        seeds = cell_seeds(cell, scene_id, seed=1)
        variation = varied(cell, scene_id, seeds)
        T = [scene.T_world_cam for _, scene in images_of(cell, variation, seeds)]
        one = varied(alone, scene_id, seeds)
        np.testing.assert_array_equal(
            T[:2], [s.T_world_cam for _, s in images_of(alone, one, seeds)]
        )
        np.testing.assert_allclose(T[4], T[0] @ np.reshape(MOUNTED["T_first_cam"], (4, 4)))
        assert {k: v for k, v in variation.record.items() if k != "cameras"} == one.record
        moved.append([T[0][:3, 3], T[2][:3, 3]])
    a, b = np.moveaxis(moved, 1, 0)
    for axis in range(3):
        assert abs(correlation(a[:, axis], b[:, axis])) < 4
