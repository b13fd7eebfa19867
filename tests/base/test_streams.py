"""Seeds of stages: datasets that were begun go on with the same ones, and no two are related."""

from itertools import product

from graycast.base.streams import SCENE, scene_seeds


def test_a_dataset_that_was_begun_goes_on_with_its_seeds():
    """Stored: what the first datasets' manifests hold of seed 7, scene 3. New streams go last."""
    assert scene_seeds(7, 3, domain=True) == {
        "counts": 6823953754371609207,
        "drop": 15549341456297449710,
        "render": 3339733183317086903,
        "noise": 10544173666503687913,
        "picture": 14910759306530374275,
        "domain": 4888982819758279453,
    }


def test_no_two_stages_scenes_or_datasets_share_a_seed():
    every = [
        value
        for seed, scene_id in product(range(20), range(20))
        for value in scene_seeds(seed, scene_id, domain=True, views=True).values()
    ]
    assert len(set(every)) == len(every) == 400 * len(SCENE)


def test_without_a_domain_the_other_seeds_stay():
    seeds = scene_seeds(7, 3, domain=True)
    assert scene_seeds(7, 3, domain=False) == {k: v for k, v in seeds.items() if k != "domain"}
