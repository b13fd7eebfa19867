"""Drop a scene's parts, and repeat with the next sub-seed until a layout is acceptable.

Parts start in random cells of a voxel grid above the bin, in random orientations. Source: Bai et
al., "Close the Sim2real Gap via Physically-based Structured Light Synthetic Data Simulation", 2024
(the grid; the paper does not state its cell size and fill).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from ...base.errors import DropError
from ...base.frames import random_quaternions, rotation_from_quaternion
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...base.streams import stream
from ..parts import Part
from ..scene import EMPTY_LAYOUT, Bin, Layout, Scene
from .body import Body, body_of
from .decomposition import Decomposition, prepare
from .rest import simulate

PARTS_MAX = 255  # Instance ids of a scene fit into eight bits.
PACKING = 0.5  # A random heap fills this share of its box, on a generous estimate.
FILL = 0.75  # This share of the cells gets a part.
CLEARANCE = 1.02  # A cell is wider than the part by this factor.
ORIENTATION_TRIES = 1000
HEAP_ABOVE_RIM = 1.5  # No heap has a larger volume than this many bins.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class DropLimits:
    """The area where parts start to fall, and the limits of an accepted layout.

    A layout must also be at rest, with all parts inside the bin. `simulated_s` is how long one
    attempt may fall and settle, in simulated time. Parts start over the middle of the bin, over
    `opening_share` of its inner length and inner width; a small share makes a heap in the middle.
    """

    penetration_m: Annotated[
        float,
        Field(
            gt=0,
            le=0.1,
            description="The deepest overlap between parts that is accepted, in metres.",
        ),
    ] = 0.5e-3
    attempts: Annotated[
        int, Field(ge=1, description="The largest number of attempts to drop the parts.")
    ] = 5
    simulated_s: Annotated[
        float,
        Field(
            gt=0,
            le=600,
            description="The simulated time in which the parts of one attempt must come to "
            "rest, in seconds.",
        ),
    ] = 20.0
    opening_share: Annotated[
        float,
        Field(
            gt=0,
            le=1,
            description="The share of the bin's inner length and width, about its middle, over "
            "which the parts fall.",
        ),
    ] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)


def flaws(layout: Layout, limits: DropLimits) -> tuple[str, ...]:
    """Return the defects of a layout in words with numbers; empty if it is acceptable."""
    defects = []
    if layout.outside:
        defects.append(f"{layout.outside} of {len(layout.part_index)} parts lie outside the bin")
    if not layout.at_rest:
        defects.append(
            f"not at rest after {layout.simulated_s:.1f} s "
            f"(a part still moved by {1e3 * layout.last_motion_m:.2f} mm)"
        )
    if not layout.deepest_penetration_m <= limits.penetration_m:  # NaN fails, too.
        defects.append(
            f"parts press {1e3 * layout.deepest_penetration_m:.2f} mm into each other or into the "
            f"bin, and the limit is {1e3 * limits.penetration_m:.2f} mm"
        )
    return tuple(defects)


def drop(
    scene: Scene,
    counts: tuple[int, ...],
    *,
    seed: int,
    limits: DropLimits,
    hull_folder: Path | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> Layout:
    """Drop `counts[i]` of `scene.parts[i]` into the bin until a layout is within the limits.

    Attempt k starts from `stream(seed, k)`; the first layout without `flaws` is returned, with its
    attempt number. Equal seeds give equal layouts, bit for bit.

    Args:
        counts: number of parts of each kind, 0 to 255 in total; a total of 0 leaves the bin empty.
        seed: seed for the drop, 0 or greater.
        hull_folder: cache of `prepare`; the user's cache folder if None.
        progress: called at the start of each stage; a stage may take seconds.

    Raises:
        ValueError: there is no bin, counts are wrong, or the parts cannot fit into the bin.
        DropError: no attempt was within the limits; the text describes the best attempt.
    """
    if scene.bin is None:
        raise ValueError(
            "the scene has no bin into which parts can be dropped: give Scene(bin=...)"
        )
    if len(counts) != len(scene.parts) or min(counts, default=0) < 0:
        names = ", ".join(part.name for part in scene.parts)
        raise ValueError(f"counts is {counts}; give a number, 0 or more, for each of: {names}")
    if sum(counts) > PARTS_MAX:
        raise ValueError(f"counts is {counts}, {sum(counts)} in all; 0 to {PARTS_MAX} parts")
    if not sum(counts):
        return EMPTY_LAYOUT
    kinds = np.flatnonzero(counts)  # Kinds that are not dropped are not decomposed.
    parts = tuple(scene.parts[kind] for kind in kinds)
    number = tuple(counts[kind] for kind in kinds)
    _check_sizes(scene.bin, parts)
    bodies = make_bodies(parts, hull_folder=hull_folder, progress=progress)
    _check_volume(scene.bin, bodies, number)
    corners_m = tuple(np.vstack([vertices for vertices, _ in body.hulls]) for body in bodies)

    tried = []
    for attempt in range(limits.attempts):
        progress.stage(f"parts fall, attempt {attempt + 1} of {limits.attempts}")
        rng = stream(seed, attempt)
        start, index = start_poses(
            scene.bin, corners_m, number, rng, opening_share=limits.opening_share
        )
        layout = simulate(scene.bin, bodies, start, index, simulated_s=limits.simulated_s)
        if not flaws(layout, limits):
            return replace(layout, part_index=kinds[index], attempt=attempt)
        tried.append(layout)
    raise DropError(_failure(scene.bin, sum(counts), tried, limits))


def make_bodies(
    parts: Sequence[Part], *, hull_folder: Path | None = None, progress: ProgressMeter = UNWATCHED
) -> tuple[Body, ...]:
    """Return each kind of part as a rigid body of the physics engine.

    Raises:
        ValueError, GraycastError: as in `prepare` and `body_of`.
    """
    prepared = prepare(parts, hull_folder=hull_folder, progress=progress)
    return tuple(body_of(part, hulls.hulls) for part, hulls in zip(parts, prepared, strict=True))


def hull_notes(parts: Iterable[Part], prepared: Iterable[Decomposition]) -> tuple[str, ...]:
    """Return notes on parts whose collision hulls exceed their tolerance."""
    return tuple(
        f"{part.name}: its collision hulls are too coarse: they are up to "
        f"{1e3 * hulls.worst_m:.2f} mm from its surface, and the bound is "
        f"{1e3 * hulls.tolerance_m:.2f} mm. Resting parts may be this far apart or inside each "
        "other. A simpler mesh without the inside of the part helps"
        for part, hulls in zip(parts, prepared, strict=True)
        if hulls.coarse
    )


def _failure(box: Bin, count: int, tried: list[Layout], limits: DropLimits) -> str:
    """Return a text on all failed attempts, with remedies for the best attempt's defects."""
    best = min(tried, key=lambda one: (one.outside, not one.at_rest, one.deepest_penetration_m))
    what = f"{count} part{'s' if count > 1 else ''} in a bin of {_mm(box.inner_m)}"
    remedies = []
    if best.outside:
        remedies.append("take a larger bin" + (" or fewer parts" if count > 1 else ""))
    if not best.at_rest:
        remedies.append(
            f"give them more time (drop.simulated_s, now {limits.simulated_s:g} s) or more friction"
        )
    if not best.deepest_penetration_m <= limits.penetration_m:
        remedies.append(
            f"accept more overlap (drop.penetration_m, now {limits.penetration_m:g} m) or check "
            "the unit of the parts with graycast parts"
        )
    if (
        best.at_rest or count > 1
    ):  # A single restless part would not rest after another start either.
        remedies.append(f"allow more attempts (drop.attempts, now {limits.attempts})")
    return (
        f"{what} came to no acceptable rest in {limits.attempts} attempts; the best: "
        f"{'; '.join(flaws(best, limits))}. What may help: {'; '.join(remedies)}"
    )


def _check_sizes(box: Bin, parts: tuple[Part, ...]) -> None:
    opening_m = min(box.inner_m[:2])
    for part in parts:
        if part.mesh.extent_m.min() > opening_m:
            raise ValueError(
                f"part {part.name} measures {_mm(part.mesh.extent_m)} and does not fit into a bin "
                f"of {_mm(box.inner_m)}: check its unit, or use a larger bin"
            )


def _check_volume(box: Bin, bodies: tuple[Body, ...], number: tuple[int, ...]) -> None:
    """Refuse parts whose total volume cannot fit, before any simulation."""
    volume_m3 = sum(n * body.volume_m3 for n, body in zip(number, bodies, strict=True))
    bin_m3 = float(np.prod(box.inner_m))
    if volume_m3 / PACKING > HEAP_ABOVE_RIM * bin_m3:
        most = int(sum(number) * HEAP_ABOVE_RIM * bin_m3 * PACKING / volume_m3)
        raise ValueError(
            f"{sum(number)} parts of {1e3 * volume_m3:.3g} litres in total, in a loose heap, do "
            f"not fit into a bin of {1e3 * bin_m3:.3g} litres: drop {most} at most, or enlarge "
            "the bin"
        )


def _mm(size_m: Iterable[float]) -> str:
    return " x ".join(f"{1e3 * size:.0f}" for size in size_m) + " mm"


def start_poses(
    box: Bin,
    corners_m: tuple[Float[np.ndarray, "_ 3"], ...],
    counts: tuple[int, ...],
    rng: np.random.Generator,
    *,
    opening_share: float = 1.0,
) -> tuple[Float[np.ndarray, "n 4 4"], Int[np.ndarray, " n"]]:
    """Draw start poses in which parts touch neither each other nor the bin's walls extended
    upwards.

    A cell is as large as the largest part's bounding sphere, which is centred on the part's box.
    Cells are stacked in layers from the rim up; a part may have any orientation in its cell. In a
    bin narrower than the sphere a cell is as wide as the bin, and orientations that do not fit
    between the walls are replaced by new random ones.

    Args:
        box: the bin; the grid is above its inner rectangle.
        corners_m: for each kind of part, points whose hull contains it, in the part's frame.
        opening_share: length and width of the grid as a share of the bin's; the grid is centred and
            has at least one cell.

    Returns:
        `T_world_part`, and the kind of each part; the kinds are mixed at random.

    Raises:
        ValueError: no orientation in which a part fits between the walls was found.
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
    """Return a uniformly random rotation that keeps the points inside a cell of this width."""
    for _ in range(ORIENTATION_TRIES):
        rotation = rotation_from_quaternion(random_quaternions(1, rng)[0])
        if (np.abs(points @ rotation[:2].T).max(axis=0) * 2 <= width_m).all():
            return rotation
    raise ValueError(
        f"a part of {_mm(np.ptp(points, axis=0))} found no orientation between walls "
        f"{_mm(width_m)} apart: check its unit, or use a larger bin"
    )
