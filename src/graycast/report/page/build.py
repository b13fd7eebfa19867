"""Builds the page: only scenes that are new or changed, each whole or not at all."""

import hashlib
import secrets
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import resources
from multiprocessing import get_context
from pathlib import Path

from ...dataset.stored import StoredDataset, StoredScene, open_dataset
from ...errors import GraycastError
from ...evaluate import Evaluation
from ...folder import write_whole
from ...stats import SceneFigures, scene_figures
from .found import FOUND, found_index, found_scripts, judged
from .index import index_script
from .scene_files import scene_page_files

WIDTH_PX = 1300  # maps of wider cameras are thinned; one of 1032 px keeps every pixel
_ASIDE = ".tmp-"
_FORM = "3"  # of a scene's files; a change builds them anew
_MARK = "graycast-report"
_STAMPED = (
    "manifest.json",
    "scene_gt_coco.json",
    "depth_sl/000000.png",
    "rgb/000000.png",
    "frames/0000.png",
    "column_sl/000000.tiff",
    "row_sl/000000.tiff",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSummary:
    """What a build did; `page` is what a browser opens."""

    page: Path
    built: int
    kept: int
    removed: int


def write_report(
    dataset: Path,
    out: Path,
    *,
    workers: int = 1,
    width_px: int = WIDTH_PX,
    detections: Path | None = None,
    on_start: Callable[[int, int], None] | None = None,
    on_scene: Callable[[str], None] | None = None,
) -> ReportSummary:
    """Write a dataset's page, or bring it up to date.

    A scene whose files are as they were when its page was made is not made again, so a stopped
    build goes on where it was. Pages of scenes that are gone are removed.

    Args:
        out: folder of the page; new, empty or that of an earlier report.
        workers: processes that make scenes' pages.
        width_px: maps wider than this are thinned; see `scene_page_files`.
        detections: results to show over the scenes: a file of COCO results, or a folder that
            `graycast detect` wrote. Without them those of an earlier build are taken away.
        on_start: called with (scenes in all, scenes already there).
        on_scene: called with the key of every scene made.

    Raises:
        DatasetError: no scene, or one that cannot be read.
        GraycastError: `out` holds something else, or cannot be written; the results are of
            another dataset.
    """
    stored = open_dataset(dataset)
    evaluation = None if detections is None else judged(dataset, detections)
    held = stored.scenes
    _open_folder(out, dataset)
    try:
        scenes = out / "scenes"
        scenes.mkdir(exist_ok=True)
        for left in scenes.glob(f"{_ASIDE}*"):
            shutil.rmtree(left)
        todo = [one for one in held if not _is_current(scenes / one.key, one, width_px)]
        if on_start is not None:
            on_start(len(held), len(held) - len(todo))
        for key in _made(todo, scenes, width_px, workers):
            if on_scene is not None:
                on_scene(key)
        gone = {entry.name for entry in scenes.iterdir()} - {one.key for one in held}
        for key in gone:
            shutil.rmtree(scenes / key)
        _write_detections(scenes, evaluation)
        _write_page(stored, out, evaluation)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{out}: cannot be written ({why}): free space or choose another folder and run the "
            "same command again; finished scenes are kept"
        ) from error
    page = out / "index.html"
    kept = len(held) - len(todo)
    return ReportSummary(page=page, built=len(todo), kept=kept, removed=len(gone))


def _open_folder(out: Path, dataset: Path) -> None:
    if out.resolve() == dataset.resolve():
        raise GraycastError(f"{out} is the dataset itself: give the page a folder of its own")
    try:
        out.mkdir(parents=True, exist_ok=True)
        entries = [entry.name for entry in out.iterdir()]
        if entries and _MARK not in entries:
            raise GraycastError(
                f"{out} is not empty and holds no report (it has {min(entries)}): choose another "
                "folder"
            )
        (out / _MARK).write_text("made by graycast report; safe to remove with its folder\n")
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(f"{out}: cannot be written ({why}): choose another folder") from error


def _stamp(scene: StoredScene, width_px: int) -> str:
    """Changes when the scene, the form of its page or the wanted width does."""
    digest = hashlib.sha256(f"{_FORM} {width_px}".encode())
    for name in _STAMPED:
        path = scene.folder / name
        if path.exists():
            state = path.stat()
            digest.update(f"{name} {state.st_size} {state.st_mtime_ns}".encode())
    return digest.hexdigest()


def _is_current(page: Path, scene: StoredScene, width_px: int) -> bool:
    stamp = page / "stamp"
    return stamp.exists() and stamp.read_text() == _stamp(scene, width_px)


def _made(todo: list[StoredScene], scenes: Path, width_px: int, workers: int) -> Iterator[str]:
    make = partial(_make, scenes=scenes, width_px=width_px)
    if workers == 1 or len(todo) < 2:
        yield from map(make, todo)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(make, todo, chunksize=2)


def _make(scene: StoredScene, *, scenes: Path, width_px: int) -> str:
    stamp = _stamp(scene, width_px)  # before reading: a scene changed meanwhile is made again
    content = scene.content()
    aside = scenes / f"{_ASIDE}{scene.key}-{secrets.token_hex(4)}"
    try:
        aside.mkdir()
        for name, data in scene_page_files(content, scene_figures(content), width_px=width_px):
            (aside / name).write_bytes(data)
        (aside / "stamp").write_text(stamp)
        shutil.rmtree(scenes / scene.key, ignore_errors=True)
        aside.rename(scenes / scene.key)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return scene.key


def _write_detections(scenes: Path, evaluation: Evaluation | None) -> None:
    """A script of every scene that was looked at; none of an earlier build stays."""
    held = {} if evaluation is None else dict(found_scripts(evaluation))
    for scene in scenes.iterdir():
        if scene.name in held:
            write_whole(scene / FOUND, held[scene.name])
        else:
            (scene / FOUND).unlink(missing_ok=True)


def _write_page(stored: StoredDataset, out: Path, evaluation: Evaluation | None) -> None:
    def figures() -> Iterator[SceneFigures]:
        for scene in stored.scenes:
            yield SceneFigures.model_validate_json(
                (out / "scenes" / scene.key / "figures.json").read_bytes()
            )

    found = None if evaluation is None else found_index(evaluation)
    script, _ = index_script(stored, figures(), found)
    write_whole(out / "index.js", script.encode())
    for source in sorted(resources.files(__package__).joinpath("web").iterdir(), key=_name):
        write_whole(out / source.name, source.read_bytes())


def _name(entry) -> str:
    return entry.name
