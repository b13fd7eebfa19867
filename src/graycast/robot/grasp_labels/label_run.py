"""Label the scenes of a dataset in worker processes; a stopped run can be continued."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.usage import rss_bytes
from ...cell.engine import Failed, Job, TaskResult, Workers, keep_to_threads, make_missing
from ...dataset.read.stored import StoredDataset, open_dataset
from .label_files import open_labels, scene_json
from .label_options import Labelling
from .scene_labels import label_scene
from .stored_world import GraspWorld, Stock, make_world, read_heap, read_stock


class SceneLabeller:
    """A worker that labels scenes; it searches for grips on the parts only once."""

    def __init__(self, task: "LabelTask", *, threads: int | None, progress: ProgressMeter) -> None:
        self._task, self._threads, self._progress = task, threads, progress
        self._world: GraspWorld | None = None

    def make(self, scene_id: int) -> TaskResult:
        """Label one scene.

        Raises:
            DatasetError: a file of the scene is missing or damaged.
            ConfigError: the jaws do not fit around any of the parts.
        """
        start = time.perf_counter()
        task = self._task
        if self._world is None:
            keep_to_threads(self._threads)
            self._world = make_world(task.stock, task.labelling, progress=self._progress)
        scene = task.dataset.scenes[scene_id]
        self._progress.stage(f"labels of scene {scene.key}")
        heap = read_heap(scene)
        labels = label_scene(
            self._world, heap, task.labelling, seed=task.seed, scene_id=scene.scene_id
        )
        tried = [label.ending for label in labels if label.ending is not None]
        return TaskResult(
            scene_id=scene_id,
            files=((scene.key, scene_json(labels, heap, scene.obj_ids())),),
            seconds=time.perf_counter() - start,
            reasons={
                "grasps": float(len(labels)),
                "simulated": float(len(tried)),
                "held": float(sum(ending.success for ending in tried)),
            },
            rss_bytes=rss_bytes(),
        )

    def close(self) -> None:
        self._world = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelTask(Job):
    """The data that a worker process needs to label any scene of a dataset."""

    RUNNER = SceneLabeller

    dataset: StoredDataset
    stock: Stock
    labelling: Labelling


def label_dataset(
    folder: Path,
    labelling: Labelling,
    *,
    name: str,
    seed: int,
    files: Path = Path(),
    workers: int = 1,
    on_result: Callable[[str, TaskResult], None] = lambda key, result: None,
    on_failed: Callable[[str, Failed], None] = lambda key, failed: None,
    progress: ProgressMeter = UNWATCHED,
) -> tuple[str, ...]:
    """Label the scenes of a dataset that are not labelled yet.

    Args:
        name: name of the set of labels, which is a folder in the dataset's `grasps`.
        seed: seed for the choice of places.
        files: the folder that paths in the dataset's configuration are relative to.
        on_result, on_failed: receive the key of a scene and its result or failure.

    Returns:
        The keys of the scenes that could not be labelled.

    Raises:
        DatasetError: the dataset does not exist, or the folder has labels with other options.
        GraycastError: no scene could be labelled; the error names the reason.
    """
    dataset = open_dataset(folder)
    stock = read_stock(dataset, files)
    scenes = dataset.scenes

    def keep(result: TaskResult) -> None:
        scene = scenes[result.scene_id]
        out.write(scene, result.files[0][1])
        on_result(scene.key, result)

    with open_labels(dataset, name, labelling, seed) as out:
        lost = make_missing(
            LabelTask(dataset=dataset, stock=stock, labelling=labelling, seed=seed, device="cpu"),
            [k for k, scene in enumerate(scenes) if not out.of(scene).exists()],
            what="scenes",
            total=len(scenes),
            workers=Workers(count=workers),
            progress=progress,
            on_result=keep,
            on_failed=lambda failed: on_failed(scenes[failed.scene_id].key, failed),
        )
    return tuple(scenes[one.scene_id].key for one in lost)
