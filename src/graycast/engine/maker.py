"""What a worker does, wherever it runs: scenes of one task, from seeds to the bytes of files."""

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType

from ..cell import Cell, open_cell_renderer
from ..dataset import scene_files
from ..dataset.sample import LEAST_DECODED, Sample
from ..errors import DecodeError, DeviceError, GraycastError, WorkerDied
from ..render import OnFrame, Renderer
from ..simulate import OnStage, Shot, make_images
from ..usage import rss_bytes
from .job import Job, Made, keep_to_threads

GPU_DEVICES = ("cuda", "optix")


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneTask(Job):
    """What a worker needs to know to make any scene of a dataset."""

    cell: Cell
    depth_scale_mm: float

    def open(
        self,
        *,
        threads: int | None = None,
        on_frame: OnFrame | None = None,
        on_stage: OnStage = lambda stage: None,
    ) -> "SceneMaker":
        return SceneMaker(self, threads=threads, on_frame=on_frame, on_stage=on_stage)


class SceneMaker:
    """Makes scenes of one task; opens its renderer for the first one and keeps it."""

    def __init__(
        self,
        task: SceneTask,
        *,
        threads: int | None = None,
        on_frame: OnFrame | None = None,
        on_stage: OnStage = lambda stage: None,
    ) -> None:
        self.task = task
        self._threads = threads
        self._on_frame = on_frame
        self._on_stage = on_stage
        self._renderer: Renderer | None = None

    def make(self, scene_id: int) -> Made:
        """One scene.

        Raises:
            DropError, DecodeError, ValueError: this scene cannot be made; the next one may be.
            Exception: what nobody foresaw; the renderer is opened anew for the next scene.
        """
        start = time.perf_counter()
        task = self.task
        try:
            if self._renderer is None:
                self._renderer = self._open()
            shares: list[Mapping[str, float]] = []
            shots = make_images(
                task.cell,
                scene_id,
                seed=task.seed,
                renderer=self._renderer,
                on_stage=self._on_stage,
            )
            files = tuple(scene_files(_decoded(shots, shares), task.depth_scale_mm))
        except BaseException as error:
            if not is_the_scenes_own(error):
                self.close()
            raise
        return Made(
            scene_id=scene_id,
            files=files,
            seconds=time.perf_counter() - start,
            reasons={name: sum(own[name] for own in shares) / len(shares) for name in shares[0]},
            rss_bytes=rss_bytes(),
        )

    def _open(self) -> Renderer:
        keep_to_threads(self._threads)
        return open_cell_renderer(
            self.task.cell,
            device=self.task.device,
            threads=self._threads,
            on_frame=self._on_frame,
        )

    def close(self) -> None:
        renderer, self._renderer = self._renderer, None
        if renderer is not None:
            renderer.close()

    def __enter__(self) -> "SceneMaker":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _decoded(shots: Iterable[Shot], shares: list[Mapping[str, float]]) -> Iterator[Sample]:
    """The sample of each image, its share of pixels per reason noted.

    Raises:
        DecodeError: as of `_refuse_undecoded`.
    """
    for shot in shots:
        sample = shot.sample
        image = " ".join(filter(None, ("image", str(sample.image), sample.sensor)))
        _refuse_undecoded(sample.manifest["reasons"], image)
        shares.append(sample.manifest["reasons"])
        yield sample


def _refuse_undecoded(reasons: Mapping[str, float], image: str) -> None:
    """An image without scanner depth is none, and `validate` would say so.

    Raises:
        DecodeError: hardly a pixel was decoded; says why most were not, and what helps.
    """
    if reasons["decoded"] >= LEAST_DECODED:
        return
    most = max(reasons, key=lambda name: reasons[name])
    raise DecodeError(
        f"{image}: the scanner finds a depth in {reasons['decoded']:.2%} of the pixels, that is "
        "in none: "
        f"{reasons[most]:.0%} are {most}: "
        f"{_REMEDIES.get(most, 'see graycast preview')}"
    )


_LIGHT = "give a longer exposure.exposure_s, or leave it out, or a nearer view.distance_m"
_REMEDIES = {
    "shadow": _LIGHT,
    "low_modulation": _LIGHT,
    "saturated": "give a shorter exposure.exposure_s, or leave it out",
    "out_of_range": "bring the bin into the rig's near_m to far_m (view.distance_m)",
    "outside_projector": "bring the bin to where the projector shines (view.distance_m)",
}


def is_the_scenes_own(error: BaseException) -> bool:
    """Whether an error would come again: parts that find no rest, values out of their range.

    All else (a lost driver, memory, a process that was killed) may be the machine's.
    """
    foreseen = isinstance(error, (GraycastError, ValueError))
    return foreseen and not isinstance(error, (DeviceError, WorkerDied))
