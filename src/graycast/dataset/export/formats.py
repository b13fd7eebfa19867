"""Export a dataset in BOP's form to another format."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from ...base.errors import DatasetError, GraycastError
from ...base.folder import new_folder
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.spawn import in_order
from ..files.records import Record
from ..files.safe_reading import Unreadable, read_json
from ..read.stored import StoredDataset, open_dataset
from .options import FORMATS, Options
from .picture_job import PictureJob
from .record import ExportRecord, write_record

WriteSplit = Callable[[Path, str, Iterable[Any], StoredDataset, Options], None]
_SOME = 3  # An error names at most this many keys.


class Selection(Record):
    """A file of scenes (`train-000003`) and their tags that a user saved on the report's page."""

    kind: Literal["graycast-scenes"]
    dataset: str
    fingerprint: str
    scenes: dict[str, list[str]]


def export(
    dataset: Path,
    out: Path,
    options: Options,
    *,
    selection: Path | None = None,
    workers: int = 1,
    progress: ProgressMeter = UNWATCHED,
) -> ExportRecord:
    """Write a finished dataset in another format, completely or not at all.

    Args:
        dataset: the folder of a dataset, of simulated or of real pictures.
        out: a folder that does not exist or is empty.
        options: the format and its options.
        selection: a file of scenes saved on the report's page; only they are exported.
        workers: number of processes that read and encode pictures; this process alone writes. The
            files do not depend on the number.
        progress: meter that counts the pictures.

    Returns:
        The content of `export.json` in `out`.

    Raises:
        GraycastError: `out` is in use or cannot be written, the dataset is damaged or lacks
            what was requested, `selection` names other scenes, or a set would be empty.
    """
    module_name, _, function = FORMATS[options.format].writer.partition(".")
    writer = import_module(f".{module_name}", __package__)
    write_split: WriteSplit = getattr(writer, function)
    stored = open_dataset(dataset)
    image_ids = stored.image_ids(stored.scene_ids["train"])
    if selection is not None:
        image_ids = selected_pictures(selection, stored)
    settings = options.resolved(stored)
    splits = settings.split.assign(image_ids, images=len(stored.images))
    if out.absolute().is_relative_to(dataset.absolute()):
        raise GraycastError(f"{out}: is inside the dataset: choose a folder outside of it")
    jobs = _jobs(splits, stored, settings)
    with (
        new_folder(out) as folder,
        closing(in_order(writer.content, jobs, workers=workers)) as contents,
    ):
        counted = _counted(contents, len(jobs), progress)
        for split, own_ids in splits.items():
            write_split(folder, split, islice(counted, len(own_ids)), stored, settings)
        if hasattr(writer, "write_rest"):
            writer.write_rest(folder, splits, stored, settings)
        return write_record(folder, stored, settings, splits)


def _jobs(
    splits: Mapping[str, list[int]], stored: StoredDataset, options: Options
) -> list[PictureJob]:
    """Return the pictures of all sets in one list, so that one pool of workers makes them."""
    jobs = []
    for image_ids in splits.values():
        for place, image_id in enumerate(image_ids):
            scene = stored.picture(image_id)
            taker = stored.taker(scene.sensor)
            jobs.append(PictureJob(scene=scene, place=place, taker=taker, options=options))
    return jobs


def _counted(contents: Iterable[Any], total: int, progress: ProgressMeter) -> Iterator[Any]:
    for done, content in enumerate(contents, start=1):
        progress.count("pictures", done, total)
        yield content


def selected_pictures(path: Path, stored: StoredDataset) -> list[int]:
    """Return the numbers of the pictures that a selection names.

    Raises:
        GraycastError: the file cannot be read, names no scene, belongs to another dataset, or
            names scenes that are not in the dataset's `train`.
    """
    try:
        selection = read_json(path, Selection)
    except Unreadable as error:
        raise GraycastError(
            f"{path} is not a selection of scenes ({error}): save one on the page of graycast "
            "report"
        ) from error
    if not selection.scenes:
        raise GraycastError(f"{path} names no scene: select some on the page of graycast report")
    if selection.fingerprint != stored.claim.get("fingerprint", ""):
        raise DatasetError(
            f"{path} names scenes of another dataset ({selection.dataset}), not of "
            f"{stored.folder}: give the dataset of that page"
        )
    images = stored.image_ids(stored.scene_ids["train"])
    known = {stored.picture(image_id).key: image_id for image_id in images}
    foreign = sorted(set(selection.scenes) - set(known))
    if foreign:
        more = f" and {len(foreign) - _SOME} more" if len(foreign) > _SOME else ""
        raise DatasetError(
            f"{path} names {', '.join(foreign[:_SOME])}{more}, which {stored.folder}/train lacks: "
            "make the page again and save the selection again"
        )
    return sorted(known[key] for key in selection.scenes)
