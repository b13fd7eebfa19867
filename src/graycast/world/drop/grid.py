"""Where the parts start: random cells of a voxel grid above the bin, random orientations.

Source: Bai et al., "Close the Sim2real Gap via Physically-based Structured Light Synthetic Data
Simulation", 2024 (the grid; its cell size and fill are not given there).
"""

import numpy as np
from jaxtyping import Float, Int

from ...base.frames import random_quaternions, rotation_from_quaternion
from ..scene import Bin

FILL = 0.75  # This share of the cells gets a part.
CLEARANCE = 1.02  # A cell is wider than the part by this factor.
ORIENTATION_TRIES = 1000


def start_poses(
    box: Bin,
    corners_m: tuple[Float[np.ndarray, "_ 3"], ...],
    counts: tuple[int, ...],
    rng: np.random.Generator,
    *,
    opening_share: float = 1.0,
) -> tuple[Float[np.ndarray, "n 4 4"], Int[np.ndarray, " n"]]:
    """Start poses that touch neither each other nor the bin's walls carried upwards.

    A cell is as large as the largest part's bounding sphere, about the middle of its box. Cells
    are stacked in layers from the rim up; a part may have any orientation in its cell. In a bin
    narrower than the sphere a cell is as wide as the bin, and orientations that do not fit
    between the walls are drawn again.

    Args:
        box: the bin; the grid stands on its inner rectangle.
        corners_m: per kind of part, points whose hull holds it, in the part's frame.
        counts: how many of each kind.
        rng: the only source of randomness.
        opening_share: the grid is so many times as long and as wide as the bin, about its middle,
            and at least a cell.

    Returns:
        `T_world_part`, and the kind of each; the kinds are mixed at random.

    Raises:
        ValueError: a part found no orientation in which it fits between the walls.
    """
    middle = [(points.min(axis=0) + points.max(axis=0)) / 2 for points in corners_m]
    reach_m = max(
        float(np.linalg.norm(points - center, axis=1).max())
        for points, center, count in zip(corners_m, middle, counts, strict=True)
        if count
    )
    side_m = 2 * CLEARANCE * reach_m
    inner_m = np.array(box.inner_m[:2])
    opening_m = np.minimum(inner_m, np.maximum(opening_share * inner_m, side_m))
    cells_xy = np.maximum(1, np.floor(opening_m / side_m)).astype(int)
    cell_m = np.array([*(opening_m / cells_xy), side_m])
    kind = np.repeat(np.arange(len(counts)), counts)
    layers = int(np.ceil(len(kind) / FILL / cells_xy.prod()))
    cell = rng.choice(cells_xy.prod() * layers, len(kind), replace=False)  # in random order
    index = np.stack(np.unravel_index(cell, (*cells_xy, layers)), axis=1)
    center_m = (index + 0.5) * cell_m - [*(opening_m / 2), -box.inner_m[2]]

    T_world_part = np.tile(np.eye(4), (len(kind), 1, 1))
    for T, part, where_m in zip(T_world_part, kind, center_m, strict=True):
        points = corners_m[part] - middle[part]
        T[:3, :3] = _orientation(points, cell_m[:2], rng)
        T[:3, 3] = where_m - T[:3, :3] @ middle[part]
    return T_world_part, kind


def _orientation(
    points: Float[np.ndarray, "k 3"], width_m: Float[np.ndarray, "2"], rng: np.random.Generator
) -> Float[np.ndarray, "3 3"]:
    """A uniformly random rotation that keeps the points inside a cell of this width."""
    for _ in range(ORIENTATION_TRIES):
        rotation = rotation_from_quaternion(random_quaternions(1, rng)[0])
        if (np.abs(points @ rotation[:2].T).max(axis=0) * 2 <= width_m).all():
            return rotation
    size = " x ".join(f"{1e3 * s:.0f}" for s in np.ptp(points, axis=0))
    opening = " x ".join(f"{1e3 * w:.0f}" for w in width_m)
    raise ValueError(
        f"a part of {size} mm found no orientation between walls {opening} mm apart: check its "
        "unit, or use a larger bin"
    )
