import numpy as np
import pytest
import trimesh

from graycast.world.drop.settle import start_poses
from graycast.world.scene import Bin

BOX = np.array(trimesh.creation.box((0.06, 0.03, 0.02)).vertices) + np.array([0.1, 0.0, -0.05])
ROD = np.array(trimesh.creation.box((0.02, 0.02, 0.12)).vertices)
BIN = Bin(inner_m=(0.4, 0.3, 0.2))


def test_falling_parts_start_in_separate_cells_above_the_rim():
    T, kind = start_poses(BIN, (BOX, ROD), (150, 60), np.random.default_rng(1))
    middle = np.array([BOX.mean(axis=0), ROD.mean(axis=0)])[kind]
    center = np.einsum("nij,nj->ni", T[:, :3, :3], middle) + T[:, :3, 3]
    gap = np.linalg.norm(center[:, None] - center[None], axis=-1) + np.eye(len(center))
    assert gap.min() >= np.linalg.norm([0.02, 0.02, 0.12])  # bounding spheres of the larger part
    for pose, k in zip(T, kind, strict=True):
        corner = (BOX, ROD)[k] @ pose[:3, :3].T + pose[:3, 3]
        assert (np.abs(corner[:, :2]) < [0.2, 0.15]).all() and corner[:, 2].min() > 0.2
    assert np.bincount(kind).tolist() == [150, 60]
    # In a mix, the two kinds have the same mean position within 4 standard errors per axis.
    shift = center[kind == 1].mean(axis=0) - center[kind == 0].mean(axis=0)
    assert (np.abs(shift) < 4 * center.std(axis=0) * np.sqrt(1 / 150 + 1 / 60)).all()


def test_parts_fall_over_the_set_share_of_the_opening_but_over_at_least_one_cell():
    """The same number of parts then needs more layers; the centre is still the bin's."""
    T, _ = start_poses(BIN, (BOX,), (60,), np.random.default_rng(1), opening_share=0.5)
    center = T[:, :3, :3] @ BOX.mean(axis=0) + T[:, :3, 3]
    assert (np.abs(center[:, :2]) < [0.1, 0.075]).all() and np.abs(center[:, 0]).max() > 0.04
    corner = np.einsum("nij,kj->nki", T[:, :3, :3], BOX) + T[:, None, :3, 3]
    assert (np.abs(corner[..., :2]) <= [0.1, 0.075]).all()
    everywhere, _ = start_poses(BIN, (BOX,), (60,), np.random.default_rng(1))
    assert T[:, 2, 3].max() > everywhere[:, 2, 3].max()
    T, _ = start_poses(BIN, (ROD,), (3,), np.random.default_rng(1), opening_share=1e-3)
    assert np.abs(T[:, :2, 3]).max() == 0.0  # The parts are one above the other.


@pytest.mark.slow
def test_starting_orientations_are_uniform():
    """In uniform rotations, each entry has mean 0 and mean square 1/3 (variance 4/45)."""
    T, _ = start_poses(BIN, (BOX,), (4000,), np.random.default_rng(2))
    entry = T[:, :3, :3].reshape(-1, 9)
    assert np.abs(entry.mean(axis=0)).max() < 4 * np.sqrt(1 / 3 / 4000)
    assert np.abs((entry**2).mean(axis=0) - 1 / 3).max() < 4 * np.sqrt(4 / 45 / 4000)


def test_a_part_longer_than_the_bin_is_wide_starts_between_the_walls():
    narrow = Bin(inner_m=(0.1, 0.1, 0.2))
    T, _ = start_poses(narrow, (ROD,), (20,), np.random.default_rng(3))
    corner = np.einsum("nij,kj->nki", T[:, :3, :3], ROD) + T[:, None, :3, 3]
    assert np.abs(corner[..., :2]).max() <= 0.05
    with pytest.raises(ValueError, match="larger bin"):
        start_poses(Bin(inner_m=(0.02, 0.02, 0.2)), (ROD,), (1,), np.random.default_rng(3))
