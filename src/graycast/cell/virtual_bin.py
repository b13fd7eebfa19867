"""A bin that virtual scanners share, and whose parts are lifted, shaken and replaced."""

import math

import numpy as np
from jaxtyping import Bool, Float

from ..base import array_types as arrays
from ..base.errors import ArgumentError
from ..base.frames import inverse, rigid, transform_points
from ..base.streams import stream
from ..world.drop import Body, Hold, lift, make_bodies, parts_outside, resettle, shake
from ..world.drop.lift import STEP_S
from ..world.scene import Layout, Scene, bin_of
from .resolve import Cell
from .simulate import fill_bin

LIFT_M_S = 0.25
JOLT_M, JOLT_STEPS = 0.03, 30  # A jolt moves the bin by 3 cm in 0.12 s, with 0.85 g.
REACH_M = 0.005  # `lift_at` takes a part at most this far from its point.


class VirtualBin:
    """The parts in a bin, which change only by the methods of this class.

    Every part has a number, which stays the same until the bin is refilled. The attributes are the
    truth: `scene` has the bin, the parts and the lamps, `layout` the poses of the parts that are in
    the bin, and `numbers` their numbers in the same order.
    """

    scene: Scene
    layout: Layout
    numbers: arrays.IntArray_n

    def __init__(self, cell: Cell, *, seed: int) -> None:
        """Fill the bin, like that of scene 0 of a dataset with this seed.

        Raises:
            DropError, ValueError: see `graycast.drop`.
        """
        self._cell = cell
        self.refill(seed)

    @property
    def cell(self) -> Cell:
        """The cell from which the bin, its parts and its lamps come."""
        return self._cell

    def refill(self, seed: int, *, scene_id: int = 0) -> None:
        """Replace the bin by a full one, like that of a scene of a dataset with this seed.

        Raises:
            DropError, ValueError: see `graycast.drop`.
        """
        filling = fill_bin(self._cell, scene_id, seed=seed)
        self.scene, self.layout = filling.variation.scene, filling.layout
        self.numbers = np.arange(len(filling.layout.part_index))
        self._seed, self._nudges = seed, 0
        self._bodies: tuple[Body, ...] = ()

    def lift(self, part: int) -> None:
        """Pull a part straight up and away; the other parts come to rest again.

        The grip never slips. Other parts that come out of the bin with the part are gone, too.

        Args:
            part: number of the part.

        Raises:
            ArgumentError: the part is not in the bin.
        """
        if part not in self.numbers:
            left = ", ".join(map(str, self.numbers)) or "no part"
            raise ArgumentError(f"lift: part {part} is not in the bin, which holds {left}")
        index, box, layout = self.numbers.tolist().index(part), bin_of(self.scene), self.layout
        kind = layout.part_index[index]
        hold = Hold(
            T_part_tool=rigid(np.eye(3), self._physics[kind].center_m),
            factor=lambda force_n, moment_nm: math.inf,
        )
        rise_m = box.inner_m[2] + float(np.linalg.norm(self.scene.parts[kind].mesh.extent_m))
        steps = round(rise_m / LIFT_M_S / STEP_S)
        path = np.tile(layout.T_world_part[index] @ hold.T_part_tool, (steps, 1, 1))
        path[:, 2, 3] += np.linspace(0, rise_m, steps)
        lifted = lift(
            box, self._physics, layout.T_world_part, layout.part_index, index, hold, path
        ).T_world_part
        keep = ~parts_outside(box, self._physics, lifted, layout.part_index)
        keep[index] = False
        self._settle(lifted, keep)

    def lift_at(self, point_m: arrays.FloatArray_3) -> int | None:
        """Lift the part at a point of the world, as a gripper that closes there does.

        Returns:
            The number of the lifted part; None if the nearest part is over 5 mm from the point.
        """
        apart_m = [
            _distance_m(self._physics[kind], transform_points(inverse(T), np.asarray(point_m)))
            for T, kind in zip(self.layout.T_world_part, self.layout.part_index, strict=True)
        ]
        if min(apart_m, default=math.inf) > REACH_M:
            return None
        part = int(self.numbers[np.argmin(apart_m)])
        self.lift(part)
        return part

    def nudge(self) -> None:
        """Jolt the bin sideways by 3 cm, so that the parts lie in other places.

        The direction follows from the seed of the filling and the number of nudges since.
        """
        rng = stream(self._seed, 0, self._nudges)
        self._nudges += 1
        angle = rng.uniform(0, 2 * np.pi)
        poses = shake(
            bin_of(self.scene),
            self._physics,
            self.layout.T_world_part,
            self.layout.part_index,
            stroke_m=JOLT_M * np.array([np.cos(angle), np.sin(angle)]),
            steps=JOLT_STEPS,
        )
        self._settle(poses, np.ones(len(self.numbers), dtype=bool))

    @property
    def _physics(self) -> tuple[Body, ...]:
        """The parts as rigid bodies, which are made when they are first used."""
        self._bodies = self._bodies or make_bodies(self.scene.parts)
        return self._bodies

    def _settle(
        self, T_world_part: Float[np.ndarray, "n 4 4"], keep: Bool[np.ndarray, " n"]
    ) -> None:
        self.layout, left = resettle(
            bin_of(self.scene),
            self._physics,
            T_world_part,
            self.layout.part_index,
            keep=keep,
            simulated_s=self._cell.config.drop.simulated_s,
        )
        self.numbers = self.numbers[left]


def _distance_m(body: Body, point_m: Float[np.ndarray, "3"]) -> float:
    """Return a point's distance from the planes of the nearest hull of a part; below 0 inside."""
    apart_m = []
    for vertices, faces in body.hulls:
        a, b, c = vertices[faces].swapaxes(0, 1)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.maximum(length, 1e-30)  # A face without an area has no direction.
        apart_m.append(float(np.einsum("fi,fi->f", normal, point_m - a).max()))
    return min(apart_m)
