"""Splits: a scene is always in the same set, sizes fit the shares, new scenes move no others."""

import pytest

from graycast.base.errors import GraycastError
from graycast.dataset.export import Split, parse_shares


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("count", [40, 500, 5000])
def test_set_sizes_agree_with_the_shares_and_no_scene_is_in_two_sets(count, seed):
    shares = (0.7, 0.2, 0.1)
    sets = Split(shares=shares, seed=seed).assign(range(40, 40 + count))
    assert sorted(i for ids in sets.values() for i in ids) == list(range(40, 40 + count))
    for ids, share in zip(sets.values(), shares, strict=True):
        # The golden ratio's discrepancy grows with the logarithm; a random draw would be off by 32
        # of 5000 scenes on average.
        assert abs(len(ids) - share * count) < 4


def test_a_scene_stays_in_its_set_when_others_are_added_or_removed():
    split = Split(shares=(0.6, 0.2, 0.2), seed=3)
    few, many = split.assign(range(0, 90, 3)), split.assign(range(1000))
    for name, ids in few.items():
        assert set(ids) <= set(many[name])


def test_each_seed_gives_its_own_split():
    sets = [Split(shares=(0.5, 0.5, 0.0), seed=s).assign(range(100)) for s in (0, 0, 1)]
    assert sets[0] == sets[1] != sets[2]


def test_a_set_without_a_share_does_not_exist_and_an_empty_set_is_refused():
    assert set(Split(shares=(0.5, 0.0, 0.5)).assign(range(10))) == {"train", "test"}
    with pytest.raises(GraycastError, match=r"gets none of the 2 scenes: the first \d+ scenes"):
        Split(shares=(0.4, 0.3, 0.3)).assign([1, 2])


@pytest.mark.parametrize("text", ["0.8,0.3", "a", "", "1,0,0,0", "-0.5,1.5"])
def test_impossible_shares_are_refused(text):
    with pytest.raises(GraycastError, match=r"(split is|shares are) .*0\.8,0\.1,0\.1"):
        Split(shares=parse_shares(text))


@pytest.mark.parametrize("seed", range(20))
def test_the_stated_minimum_number_of_scenes_is_the_first_accepted_number(seed):
    split = Split(shares=(0.8, 0.1, 0.1), seed=seed)
    assert all(split.assign(range(split.least())).values())
    with pytest.raises(GraycastError, match=f"the first {split.least()} scenes"):
        split.assign(range(split.least() - 1))
