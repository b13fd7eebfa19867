"""Make the scenes of one task in a worker, from their seeds to the bytes of their files."""

import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ...base.errors import DecodeError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.usage import rss_bytes
from ...camera.decode import pooled_shares, reason_counts
from ...dataset.files.sample import LEAST_DECODED, Sample
from ...dataset.write.bop import scene_files
from ...world.parts import Part
from ..resolve import Cell
from ..simulate import Shot, compile_kernels, make_images, on_part
from .job import Job, TaskResult, WorkerRenderer

GPU_DEVICES = ("cuda", "optix")


class SceneMaker:
    """A maker of a task's scenes; it opens a renderer for the first scene and keeps it."""

    def __init__(
        self,
        task: "SceneTask",
        *,
        threads: int | None = None,
        progress: ProgressMeter = UNWATCHED,
    ) -> None:
        self.task = task
        self._progress = progress
        self._renderer = WorkerRenderer(device=task.device, threads=threads, progress=progress)

    def make(self, scene_id: int) -> TaskResult:
        """Make one scene.

        Raises:
            DropError, DecodeError, ValueError: this scene cannot be made; others may succeed.
            Exception: an unforeseen error; the next scene opens a new renderer.
        """
        start = time.perf_counter()
        task = self.task
        counts: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
        images: tuple[Shot, ...] = ()
        files: tuple[tuple[str, bytes], ...] = ()
        with self._renderer.of(task.cell.config.render) as renderer:
            shots = make_images(
                task.cell, scene_id, seed=task.seed, renderer=renderer, progress=self._progress
            )
            if task.keep_shots:
                images = tuple(shots)
                for shot in images:
                    _count(shot.sample, *counts)
            else:
                files = tuple(scene_files(_decoded(shots, *counts), task.depth_scale_mm))
        return TaskResult(
            scene_id=scene_id,
            files=files,
            seconds=time.perf_counter() - start,
            reasons=pooled_shares(counts[:1]),
            reason_px=dict(counts[0]),
            part_reason_px=dict(counts[1]),
            rss_bytes=rss_bytes(),
            shots=images,
        )

    def close(self) -> None:
        self._renderer.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneTask(Job):
    """All data that a worker needs to make any scene of a dataset.

    With `keep_shots`, results have the images themselves instead of files.
    """

    RUNNER = SceneMaker

    cell: Cell
    depth_scale_mm: float
    keep_shots: bool = False

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.cell.kinds

    def compile_kernels(self) -> None:
        compile_kernels(self.cell)


def _count(sample: Sample, reason_px: Counter[str], part_reason_px: Counter[str]) -> None:
    """Add an image's reasons to the counts for all pixels and for the parts' pixels."""
    reason = sample.scanner_depth.reason
    reason_px.update(reason_counts(reason))
    of_parts = on_part(sample.scene, sample.layout, sample.truth)
    part_reason_px.update(reason_counts(reason[of_parts]))


def _decoded(
    shots: Iterable[Shot], reason_px: Counter[str], part_reason_px: Counter[str]
) -> Iterator[Sample]:
    """Add the pixels of each image to the counts, and yield its sample.

    Raises:
        DecodeError: almost no pixel of an image has scanner depth, which `validate` would report;
            the error has the most frequent reason and the remedy.
    """
    for shot in shots:
        sample = shot.sample
        reasons = sample.manifest["reasons"]
        if reasons["decoded"] < LEAST_DECODED:
            image = " ".join(filter(None, ("image", str(sample.image), sample.sensor)))
            most = max(reasons, key=lambda name: reasons[name])
            raise DecodeError(
                f"{image}: the scanner finds a depth in {reasons['decoded']:.2%} of the pixels, "
                f"so in none: {reasons[most]:.0%} are {most}: "
                f"{_REMEDIES.get(most, 'see graycast preview')}"
            )
        _count(sample, reason_px, part_reason_px)
        yield sample


_LIGHT = "give a longer exposure.exposure_s, or remove that key, or a nearer view.distance_m"
_REMEDIES = {
    "shadow": _LIGHT,
    "low_modulation": _LIGHT,
    "saturated": "give a shorter exposure.exposure_s, or remove that key",
    "out_of_range": "change view.distance_m so that the bin is between the rig's near_m and far_m",
    "outside_projector": "change view.distance_m so that the projector lights the bin",
}
