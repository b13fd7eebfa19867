"""Builds the page: only scenes that are new or changed, each whole or not at all."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ....base.folder import write_whole
from ....base.progress import UNWATCHED, ProgressMeter
from ....dataset.raw import frames_folder
from ....dataset.scene_content import scene_content
from ....dataset.scene_folder import of_sensor, picture_name
from ....dataset.stats import SceneFigures, scene_figures
from ....dataset.stored import StoredDataset, StoredScene, open_dataset
from ....score.evaluate import Evaluation
from .found import FOUND, evaluation_of, found_index, found_scripts
from .fused import FUSED, fused_script
from .index import index_script
from .pieces import PIECES, ReportSummary, Web, stamp_of, write_pieces, write_web, writing_page
from .scene_files import scene_page_files

WIDTH_PX = 1300  # Maps of wider cameras are thinned; one of 1032 px keeps every pixel.
_FORM = "5"  # A change of this number builds a scene's files anew.
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
    """The files whose change makes a picture's page anew; the manifest knows all of a scene."""
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
    progress: ProgressMeter = UNWATCHED,
) -> ReportSummary:
    """Write a dataset's page, or bring it up to date.

    A scene whose files are as they were when its page was made is not made again, so a stopped
    build goes on where it was. Pages of scenes that are gone are removed.

    Args:
        out: folder of the page; new, empty or that of an earlier report.
        workers: processes that make scenes' pages.
        width_px: maps wider than this are thinned; see `scene_page_files`.
        detections: results to show over the scenes: a file of COCO results, or a folder that
            `graycast detector find` wrote. Without them those of an earlier build are taken away.
        progress: counts scenes.

    Raises:
        DatasetError: no scene, or one that cannot be read.
        GraycastError: `out` holds something else, or cannot be written; the results are of
            another dataset.
    """
    stored = open_dataset(dataset)
    evaluation = None if detections is None else evaluation_of(dataset, detections)
    pieces = [
        _ScenePiece(stored=stored, scene=scene, width_px=width_px) for scene in stored.pictures
    ]
    with writing_page(out, dataset):
        summary = write_pieces(out, pieces, workers=workers, what="scenes", progress=progress)
        _write_detections(out / PIECES, evaluation, stored)
        _write_page(stored, out, evaluation)
    return summary


def _write_detections(scenes: Path, evaluation: Evaluation | None, stored: StoredDataset) -> None:
    """A script of every scene that was looked at; none of an earlier build stays."""
    scripts = {} if evaluation is None else dict(found_scripts(evaluation, stored))
    for scene in scenes.iterdir():
        if scene.name in scripts:
            write_whole(scene / FOUND, scripts[scene.name])
        else:
            (scene / FOUND).unlink(missing_ok=True)


def _write_page(stored: StoredDataset, out: Path, evaluation: Evaluation | None) -> None:
    def figures() -> Iterator[SceneFigures]:
        for scene in stored.pictures:
            yield SceneFigures.model_validate_json(
                (out / PIECES / scene.key / "figures.json").read_bytes()
            )

    found = None if evaluation is None else found_index(evaluation, stored)
    script, _ = index_script(stored, figures(), found)
    write_whole(out / "index.js", script.encode())
    write_web(out, _WEB)
