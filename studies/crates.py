"""Crates as a CAD system would export them, built from a few known dimensions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from graycast.world.bins import MeshBin, load_bin
from graycast.world.scene import Bin


@dataclass(frozen=True)
class Crate:
    """A crate with leaning walls of constant thickness, a rim at the top and bars under the floor.

    Lengths are in metres. `inner_m` is the length and width of the floor, and the depth.
    """

    inner_m: tuple[float, float, float] = (0.36, 0.26, 0.14)
    lean: float = 0.07  # outward shift of a wall per height: 4 degrees
    wall_m: float = 0.003
    floor_m: float = 0.004
    rim_m: float = 0.012
    bar_m: float = 0.006

    def half_m(self, height_m: float) -> np.ndarray:
        """Return half of the inner length and width at a height above the floor."""
        return np.array(self.inner_m[:2]) / 2 + self.lean * height_m

    @property
    def middle_m(self) -> tuple[float, float, float]:
        """Inner length and width at half the depth, and the depth."""
        x, y = (2 * self.half_m(self.inner_m[2] / 2)).tolist()
        return x, y, self.inner_m[2]

    def solid(self) -> trimesh.Trimesh:
        """Return the crate; the origin is the middle of the inner floor, and z points up."""
        depth = self.inner_m[2]
        outer = _frustum(self.half_m(0) + self.wall_m, self.half_m(depth) + self.wall_m,
                         -self.floor_m, depth)  # fmt: skip
        rim = self.half_m(depth) + self.rim_m
        parts = [outer, _frustum(rim, rim, depth - self.wall_m, depth)]
        for x in (-0.3, 0.3):
            size = (0.03, 1.6 * self.half_m(0)[1], self.bar_m + self.floor_m / 2)
            bar = trimesh.creation.box(size)
            middle_m = -self.floor_m / 2 - size[2] / 2
            bar.apply_translation((x * self.inner_m[0], 0.0, middle_m))
            parts.append(bar)
        above = 1.5 * depth
        room = _frustum(self.half_m(0), self.half_m(above), 0.0, above)
        body = trimesh.boolean.union(parts, engine="manifold")
        return trimesh.boolean.difference([body, room], engine="manifold")

    def write(self, path: Path, *, unit_m: float = 1e-3, turn: np.ndarray | None = None) -> Path:
        """Write the crate in the given unit, with its origin shifted and rotated by `turn`."""
        solid = self.solid()
        solid.apply_translation((0.1, 0.2, 0.05))
        if turn is not None:
            solid.apply_transform(np.block([[turn, np.zeros((3, 1))], [0, 0, 0, 1]]))
        solid.apply_scale(1 / unit_m)
        solid.export(path)
        return path

    def load(self, folder: Path) -> MeshBin:
        return load_bin(self.write(folder / "crate.stl"), unit="mm", up="z")

    def bin(self, folder: Path) -> Bin:
        mesh_bin = self.load(folder)
        return Bin(inner_m=mesh_bin.inner_m, mesh=mesh_bin.mesh, material=mesh_bin.material)


def _frustum(low: np.ndarray, high: np.ndarray, bottom: float, top: float) -> trimesh.Trimesh:
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    points = [
        np.column_stack([corner * half, np.full(4, z)]) for half, z in ((low, bottom), (high, top))
    ]
    return trimesh.convex.convex_hull(np.vstack(points))
