"""Build the page of a dataset; only new or changed scenes are written, each completely or not."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....base.folder import write_whole
from ....base.progress import UNWATCHED, ProgressMeter
from ....dataset.files.scene_folder import of_sensor, picture_name
from ....dataset.read.scene_content import scene_content
from ....dataset.read.stored import StoredDataset, StoredScene, open_dataset
from ....dataset.stats import SceneFigures, scene_figures
from ....dataset.write.raw import frames_folder
from ....score.evaluate import Evaluation, Task, evaluate
from ....score.merge import FusedCloud, fuse, read_view
from .detection_scripts import DETECTIONS, detection_index, detection_scripts
from .index import index_script
from .packing import plain_text, receiving
from .pieces import PIECES, ReportSummary, Web, stamp_of, write_pieces, write_web, writing_page
from .scene_files import scene_page_files
from .walls import dataset_walls

WIDTH_PX = 1300  # Wider maps are thinned; a camera with 1032 columns keeps all of them.
_FORM = "5"  # version of the page's files; a change makes all scenes outdated
FUSED = "fused.js"
_STEPS = 65535  # number of 16-bit steps along the longest side of a cloud
_MOST = 400000  # largest number of points that a browser draws smoothly
_SIGMA_STEP_MM = 0.002  # With 8 bits, sigma is limited to half a millimetre.
_PICTURES, _MAPS = ("depth_sl", "rgb"), ("column_sl", "row_sl")
_WEB = Web(
    package=__package__,
    title="Graycast report",
    home="all scenes (Esc)",
    scripts=(
        "plots.js",
        "geometry.js",
        "tags.js",
        "overview.js",
        "found.js",
        "filters.js",
        "grid.js",
        "paint.js",
        "viewer.js",
        "shapes.js",
        "cloud.js",
        "walls.js",
        "side.js",
        "toolbar.js",
        "scene.js",
        "keys.js",
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _ScenePiece:
    stored: StoredDataset
    scene: StoredScene
    width_px: int

    @property
    def key(self) -> str:
        return self.scene.key

    def stamp(self) -> str:
        return stamp_of(f"{_FORM} {self.width_px}", self.scene.folder, _stamped(self.scene))

    def files(self) -> Iterator[tuple[str, bytes]]:
        content = scene_content(self.scene)
        yield from scene_page_files(content, scene_figures(content), width_px=self.width_px)
        if self.scene.place == 0 and self.scene.of > 1 and not self.scene.real:
            yield FUSED, fused_script(self.stored, self.scene)


def _stamped(scene: StoredScene) -> list[str]:
    """Return the files of a picture whose changes make its page outdated, with the manifest."""
    frames = frames_folder(scene.sensor, scene.image)
    pictures = (picture_name(kind, scene.image, scene.sensor) for kind in _PICTURES)
    maps = (Path(picture_name(kind, scene.image, scene.sensor)) for kind in _MAPS)
    return [
        "manifest.json",
        f"{of_sensor('scene_gt_coco', scene.sensor)}.json",
        *pictures,
        f"{frames}/0000.png",
        *(str(path.with_suffix(".tiff")) for path in maps),
    ]


def write_report(
    dataset: Path,
    out: Path,
    *,
    workers: int = 1,
    width_px: int = WIDTH_PX,
    detections: Path | None = None,
    files: Path = Path(),
    progress: ProgressMeter = UNWATCHED,
) -> ReportSummary:
    """Write the page of a dataset, or update it.

    Scenes whose files have not changed since their pages were made are skipped, so that a stopped
    build can be continued. Pages of removed scenes are removed.

    Args:
        out: folder for the page; it must be new, empty or hold an earlier report.
        workers: number of processes.
        width_px: wider maps are thinned; see `scene_page_files`.
        detections: results to show in the scenes: a file of COCO results, or a folder of
            `graycast detector find`. None removes the results of an earlier build.
        files: the folder that the path of the bin's mesh is relative to. Without that file, the 3D
            view has no bin.
        progress: meter that counts the scenes.

    Raises:
        DatasetError: the dataset has no scene, or a scene cannot be read.
        GraycastError: `out` holds something else or cannot be written, or the results belong to a
            different dataset.
    """
    stored = open_dataset(dataset)
    evaluation = None
    if detections is not None:
        evaluation = evaluate(Task(results=detections, dataset=dataset))[0]
    pieces = [
        _ScenePiece(stored=stored, scene=scene, width_px=width_px) for scene in stored.pictures
    ]
    with writing_page(out, dataset):
        summary = write_pieces(out, pieces, workers=workers, what="scenes", progress=progress)
        _write_detections(out / PIECES, evaluation, stored)
        _write_page(stored, out, evaluation, dataset_walls(stored, files))
    return summary


def _write_detections(scenes: Path, evaluation: Evaluation | None, stored: StoredDataset) -> None:
    """Write a script for each scene with detections, and remove scripts of an earlier build."""
    scripts = {} if evaluation is None else dict(detection_scripts(evaluation, stored))
    for scene in scenes.iterdir():
        if scene.name in scripts:
            write_whole(scene / DETECTIONS, scripts[scene.name])
        else:
            (scene / DETECTIONS).unlink(missing_ok=True)


def _write_page(
    stored: StoredDataset, out: Path, evaluation: Evaluation | None, walls: dict[str, Any] | None
) -> None:
    def figures() -> Iterator[SceneFigures]:
        for scene in stored.pictures:
            yield SceneFigures.model_validate_json(
                (out / PIECES / scene.key / "figures.json").read_bytes()
            )

    detections = None if evaluation is None else detection_index(evaluation, stored)
    write_whole(out / "index.js", index_script(stored, figures(), detections, walls))
    write_web(out, _WEB)


# --- the fused cloud of a scene ------------------------------------------------------------------


def fused_script(stored: StoredDataset, first: StoredScene) -> bytes:
    """Return the script of a scene's fused cloud, stored with the first picture's key.

    Raises:
        DatasetError: a file is missing or damaged.
    """
    shots = stored.images_of(first)
    fused = fuse([read_view(stored, shot).view for shot in shots])
    stride = -(-len(fused.cloud.views) // _MOST)
    content = {"key": f"{first.key}/{FUSED}", "names": [shot.image_name for shot in shots]}
    return receiving(content | _packed(fused.cloud, max(stride, 1)))


def _packed(cloud: FusedCloud, stride: int) -> dict[str, Any]:
    """Return points [mm, world frame] as 16-bit steps from a corner, and other data as bytes."""
    place_mm = 1000 * cloud.point_m[::stride]
    low = place_mm.min(axis=0) if len(place_mm) else np.zeros(3)
    step = float(max((place_mm - low).max(initial=0.0), 1.0) / _STEPS)
    sigma = np.rint(1000 * cloud.sigma_m[::stride] / _SIGMA_STEP_MM).clip(0, 255)
    normal = np.rint(127 * cloud.normal[::stride]).astype(np.int8)
    return {
        "count": len(place_mm),
        "low": low.tolist(),
        "step": step,
        "sigma_step_mm": _SIGMA_STEP_MM,
        "place": plain_text(np.rint((place_mm - low) / step).astype("<u2")),
        "normal": plain_text(normal),
        "color": plain_text(cloud.color[::stride]),
        "sigma": plain_text(sigma.astype(np.uint8)),
        "views": plain_text(cloud.views[::stride]),
        "view": plain_text(cloud.view[::stride]),
        "first": plain_text(cloud.first_reason[::stride]),
    }
