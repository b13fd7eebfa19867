"""What a worker does, wherever it runs: scenes of one task, from seeds to the bytes of files."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType

from ..cell import Cell
from ..dataset import scene_files
from ..dataset.sample import LEAST_DECODED
from ..errors import DecodeError
from ..render import OnFrame
from ..simulate import OnStage, make_scene
from ..usage import rss_bytes
from .job import Job, Made
from .kept import KeptRenderer

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
        self._on_stage = on_stage
        self._kept = KeptRenderer(device=task.device, threads=threads, on_frame=on_frame)

    def make(self, scene_id: int) -> Made:
        """One scene.

        Raises:
            DropError, DecodeError, ValueError: this scene cannot be made; the next one may be.
            Exception: what nobody foresaw; the renderer is opened anew for the next scene.
        """
        start = time.perf_counter()
        task = self.task
        with self._kept.of(task.cell) as renderer:
            shot = make_scene(
                task.cell,
                scene_id,
                seed=task.seed,
                renderer=renderer,
                on_stage=self._on_stage,
            )
            _refuse_undecoded(shot.sample.manifest["reasons"])
            files = tuple(scene_files(shot.sample, task.depth_scale_mm))
        return Made(
            scene_id=scene_id,
            files=files,
            seconds=time.perf_counter() - start,
            reasons=dict(shot.sample.manifest["reasons"]),
            rss_bytes=rss_bytes(),
        )

    def close(self) -> None:
        self._kept.close()

    def __enter__(self) -> "SceneMaker":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _refuse_undecoded(reasons: Mapping[str, float]) -> None:
    """A scene without scanner depth is none, and `validate` would say so.

    Raises:
        DecodeError: hardly a pixel was decoded; says why most were not, and what helps.
    """
    if reasons["decoded"] >= LEAST_DECODED:
        return
    most = max(reasons, key=lambda name: reasons[name])
    raise DecodeError(
        f"the scanner finds a depth in {reasons['decoded']:.2%} of the pixels, that is in none: "
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
