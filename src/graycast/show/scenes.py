"""Scenes for a script or a notebook, which can be made one by one, displayed and saved."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageShow

from ..base import array_types as arrays
from ..base.errors import GraycastError
from ..base.progress import UNWATCHED, ProgressMeter
from ..base.public_value import public_value
from ..camera.decode import CodeMap, DepthMap
from ..camera.sensor import Capture
from ..cell.engine import ALONE, Failed, Pool, SceneTask, TaskResult, Workers, open_pool
from ..cell.generate import depth_step_mm, save_scene
from ..cell.resolve import Cell
from ..cell.simulate import Shot
from ..rendering import GroundTruth
from ..world.drop import prepare
from ..world.scene import Layout
from .report.preview import preview


@public_value
@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SceneResult:
    """A finished scene. `shots` are its images; the properties refer to the first image."""

    cell: Cell
    shots: tuple[Shot, ...]

    @property
    def scene_id(self) -> int:
        return int(self.shots[0].sample.manifest["scene_id"])

    @property
    def layout(self) -> Layout:
        """Poses of the parts at rest."""
        return self.shots[0].sample.layout

    @property
    def rgb(self) -> arrays.UInt8Array_h_w_3:
        """Colour picture in sRGB."""
        return self.shots[0].sample.rgb

    @property
    def truth(self) -> GroundTruth:
        """Perfect depth, normals and instances."""
        return self.shots[0].sample.truth

    @property
    def capture(self) -> Capture:
        """Captured frames, as the sensor stored them."""
        return self.shots[0].capture

    @property
    def codes(self) -> CodeMap:
        """Projector position of each pixel."""
        return self.shots[0].codes

    @property
    def depth(self) -> DepthMap:
        """Measured depth; `depth.points()` is the point cloud."""
        return self.shots[0].sample.scanner_depth

    def sheet(self) -> Image.Image:
        """Return pictures and depth of the scene on one sheet, as `graycast preview` does."""
        return preview(self.shots[0], self.cell.code)

    def show(self) -> None:
        """Show the sheet in the notebook, or in this machine's image viewer.

        Raises:
            GraycastError: the machine has no image viewer.
        """
        if not ImageShow.show(self.sheet(), title=f"scene {self.scene_id}"):
            raise GraycastError(
                "this machine has no viewer of pictures: write the picture with "
                "scene.sheet().save('sheet.png')"
            )

    def save(self, out: Path | str) -> Path:
        """Write the scene into a dataset, as `graycast generate` does; see `save_scene`."""
        return save_scene(self.cell, self.shots, out)

    def __repr__(self) -> str:
        return f"SceneResult({', '.join(map(repr, self.shots))})"


def scenes(
    cell: Cell,
    count: int,
    *,
    seed: int | None = None,
    device: str = "auto",
    workers: Workers = ALONE,
    progress: ProgressMeter = UNWATCHED,
) -> Iterator[SceneResult]:
    """Make the scenes 0 .. count-1 of a cell, in this order, without writing files.

    The renderer stays open until the last scene or the end of the loop. A worker process may be up
    to two scenes ahead of the loop. For datasets of many scenes, use `generate`, which writes each
    scene at once and retries failed scenes.

    Args:
        seed: seed of all random numbers; None uses the seed of the configuration.
        device: 'auto', 'cpu', 'cuda' or, for Cycles, 'optix'.

    Raises:
        DropError, ValueError, DeviceError: see `make_scene` and `open_renderer`.
    """
    task = SceneTask(
        cell=cell,
        seed=cell.config.seed if seed is None else seed,
        device=workers.device(cell.config.render.backend, device),
        depth_scale_mm=depth_step_mm(cell),
        keep_shots=True,
    )
    prepare(task.parts, progress=progress)
    with closing(open_pool(task, workers, scenes=max(count, 1), progress=progress)) as pool:
        progress.stage("the first scene takes up to a minute longer, since programs are compiled")
        for done, shots in enumerate(_in_order(pool, count)):
            progress.count("scenes", done + 1, count)
            yield SceneResult(cell=cell, shots=shots)


def _in_order(pool: Pool, count: int) -> Iterator[tuple[Shot, ...]]:
    finished: dict[int, TaskResult | Failed] = {}
    submitted, ahead = 0, 2 * max(pool.free, 1)  # This limits the lead if one scene is slow.
    for scene_id in range(count):
        while scene_id not in finished:
            while pool.free and submitted < min(count, scene_id + ahead):
                pool.submit(submitted)
                submitted += 1
            outcome = pool.gather()
            finished[outcome.scene_id] = outcome
        outcome = finished.pop(scene_id)
        if isinstance(outcome, Failed):
            raise outcome.error
        yield outcome.shots
