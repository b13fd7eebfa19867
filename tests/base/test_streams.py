"""Seeds of stages do not change between versions, and no two of them are related."""

from itertools import product

import numpy as np

from graycast.base.streams import (
    SCENE,
    device_seed,
    image_seeds,
    rescan_seeds,
    scene_seeds,
    station_stream,
)


def test_seeds_equal_their_recorded_values_so_that_old_datasets_can_continue():
    """Stored result: seeds of seed 7, scene 3, in the first datasets. New streams come last."""
    assert scene_seeds(7, 3, domain=True) == {
        "counts": 6823953754371609207,
        "drop": 15549341456297449710,
        "render": 3339733183317086903,
        "noise": 10544173666503687913,
        "picture": 14910759306530374275,
        "domain": 4888982819758279453,
    }


def test_every_stage_scene_and_dataset_has_a_different_seed():
    every = [
        value
        for seed, scene_id in product(range(20), range(20))
        for value in scene_seeds(seed, scene_id, domain=True, views=True).values()
    ]
    assert len(set(every)) == len(every) == 400 * len(SCENE)


def test_omitting_the_domain_changes_no_other_seed():
    seeds = scene_seeds(7, 3, domain=True)
    assert scene_seeds(7, 3, domain=False) == {k: v for k, v in seeds.items() if k != "domain"}


def test_a_rescan_shares_no_seed_with_its_source_or_with_another_scanner():
    """A dataset and its rescan have the same seed by default, which gave them the same noise."""
    images = [
        image_seeds(0, scene, station=station, image=image)
        for scene, station, image in product(range(5), range(3), range(3))
    ]
    rescans = [
        rescan_seeds(0, scene, scanner=name, image=image)
        for scene, name, image in product(range(5), ("paper", "like-phoxi-m"), range(3))
    ]
    every = [seed for seeds in images + rescans for seed in seeds.values()]
    assert len(set(every)) == len(every)


def test_each_scanner_and_each_device_has_its_own_random_stream():
    streams = [np.random.default_rng(5), *(station_stream(5, k) for k in range(1, 4))]
    first = station_stream(5, 0).uniform(size=3).tolist()
    draws = [stream.uniform(size=3).tolist() for stream in streams]
    assert draws[0] == first
    assert len({tuple(each) for each in draws}) == len(draws)
    names = ("a", "b", "aa", "left", "right")
    assert len({device_seed(seed, name) for seed in range(3) for name in names}) == 15
