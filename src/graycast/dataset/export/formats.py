"""From a dataset in BOP's form to any other form."""

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from pathlib import Path

from ...base.errors import GraycastError
from ...base.folder import new_folder
from ...base.progress import UNWATCHED, ProgressMeter
from ..stored import StoredDataset, StoredScene, open_dataset
from .options import FORMATS, Options
from .record import ExportRecord, write_record
from .selection import chosen_pictures

WriteSplit = Callable[[Path, str, Iterable[StoredScene], StoredDataset, Options], None]
WriteRest = Callable[[Path, Iterable[str], StoredDataset, Options], None]


def export(
    dataset: Path,
    out: Path,
    options: Options,
    *,
    selection: Path | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> ExportRecord:
    """Write a finished dataset in another format, whole or not at all.

    Args:
        dataset: the folder of a dataset, of simulated or of real pictures.
        out: a folder that does not exist or is empty.
        options: the format and what it may be told.
        selection: a file of scenes saved on the report's page; only they are exported.
        progress: counts pictures.

    Returns:
        What `export.json` in `out` says.

    Raises:
        GraycastError: `out` is in use or cannot be written, the dataset lacks what was asked for,
            is damaged, `selection` is not of its scenes, or a set of the split would be empty.
    """
    write_split, write_rest = _writers(options.format)
    stored = open_dataset(dataset)
    image_ids = stored.image_ids(stored.scene_ids["train"])
    if selection is not None:
        image_ids = chosen_pictures(selection, stored)
    chosen = options.resolved(stored)
    splits = chosen.split.assign(image_ids, images=len(stored.images))
    if out.absolute().is_relative_to(dataset.absolute()):
        raise GraycastError(f"{out}: is inside the dataset: choose a folder outside of it")
    total, done = len(image_ids), 0

    def counted(image_ids: Iterable[int]) -> Iterator[StoredScene]:
        nonlocal done
        for image_id in image_ids:
            yield stored.picture(image_id)
            done += 1
            progress.count("pictures", done, total)

    with new_folder(out) as folder:
        for split, chosen_ids in splits.items():
            write_split(folder, split, counted(chosen_ids), stored, chosen)
        write_rest(folder, splits, stored, chosen)
        return write_record(folder, stored, chosen, splits)


def _writers(name: str) -> tuple[WriteSplit, WriteRest]:
    module_name, _, function = FORMATS[name].writer.partition(".")
    module = import_module(f".{module_name}", __package__)
    return getattr(module, function), getattr(module, "write_rest", _nothing)


def _nothing(folder: Path, splits: Iterable[str], stored: StoredDataset, options: Options) -> None:
    """Formats that have nothing beside their splits."""
