"""Open the examples of datasets, of their exports with labels, and of other datasets."""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, final, overload

from ...base.errors import DatasetError
from ...base.file_limits import parse_json
from ...base.public_value import public_value
from ..export.options import FORMATS
from ..export.record import RECORD, read_record
from ..export.split import Split
from ..files.places import CLAIM
from ..files.seal import MANIFEST, OWN
from ..read.example import Example
from ..read.stored import StoredDataset, open_dataset
from .foreign import Foreign, is_foreign, open_foreign

ReadOne = Callable[[int], Example]

# This base class declares the type of the examples for editors. At run time it has no item type,
# because a run-time type check would read an example from its files.
if TYPE_CHECKING:
    _Sequence = Sequence[Example]
else:
    _Sequence = Sequence


@final
@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Examples(_Sequence):
    """The examples of one set, each read from its files on demand.

    No files are kept open, so each process of a data loader can have a copy.

    Attributes:
        folder: the dataset or export that the examples come from.
        scene_ids: numbers of the pictures, in the order of the examples; the scenes' ids if each
            scene has one picture.
        categories: object ids and the parts' names.
        place_of: for each picture's number its scene, its scanner's name, and its number among
            that scanner's pictures of the scene.
        origins: the files that determine the content of the examples.
    """

    folder: Path
    split: str
    scene_ids: tuple[int, ...]
    categories: Mapping[int, str]
    read: ReadOne
    place_of: Mapping[int, tuple[int, str, int]]
    origins: tuple[Path, ...] = ()

    def content_sum(self) -> str:
        """Return a SHA-256 that changes with the data, so that no run resumes with other data.

        A scene's manifest represents all of its files, because it holds their SHA-256; durations in
        it are left out.

        Limitation: changes of other datasets' pictures, and of an export's files, are not noticed
        while the annotations or `export.json` stay the same.

        Raises:
            DatasetError: a file is missing or damaged.
        """
        digest = hashlib.sha256()
        try:
            for path in self.origins:
                content = path.read_bytes()
                if path.name == MANIFEST and (own := parse_json(content).get(OWN)):
                    content = own.encode()
                digest.update(hashlib.sha256(content).digest())
        except (OSError, ValueError, AttributeError) as error:
            raise DatasetError(f"{path}: cannot be read ({error}): restore the file") from error
        return digest.hexdigest()

    def __len__(self) -> int:
        return len(self.scene_ids)

    @overload
    def __getitem__(self, index: int) -> Example: ...

    @overload
    def __getitem__(self, index: slice) -> list[Example]: ...

    def __getitem__(self, index: int | slice) -> Example | list[Example]:
        """Return an example, or a list for a slice.

        Raises:
            DatasetError: a file of the example is missing or damaged.
            IndexError: the index is out of range.
        """
        if isinstance(index, slice):
            return [self.read(scene_id) for scene_id in self.scene_ids[index]]
        return self.read(self.scene_ids[index])


def open_examples(
    folder: Path | str, *, split: str = "train", division: Split | None = None
) -> Examples:
    """Return the examples of a dataset, of its export, or of another dataset.

    Args:
        folder: the folder of a dataset or an export; for other datasets a file of COCO annotations,
            or the folder of one of BOP's splits, such as `train_pbr`.
        split: `train`, `val` or `test`.
        division: the shares of the sets; None puts all scenes into `train`. Must be None for an
            export, which was divided when it was made.

    Raises:
        DatasetError: the folder is not of these kinds, or does not have the set `split`.
    """
    folder = Path(folder)
    if not (folder / CLAIM).is_file() and not (folder / RECORD).is_file() and is_foreign(folder):
        return _from_others(folder, open_foreign(folder), split, division or Split())
    if not (folder / RECORD).is_file():
        return _from_dataset(open_dataset(folder), split, division or Split())
    if division is not None:
        raise DatasetError(f"{folder}: was divided when it was exported: remove --shares")
    record = read_record(folder)
    scene_ids = _of_set(folder, record.splits, split)
    return Examples(
        folder=folder,
        split=split,
        scene_ids=scene_ids,
        categories={int(obj_id): name for obj_id, name in record.categories.items()},
        place_of={image_id: record.image(image_id) for image_id in scene_ids},
        read=_reader(record.format)(folder, split, record, scene_ids),
        origins=(folder / RECORD,),
    )


def _from_dataset(stored: StoredDataset, split: str, division: Split) -> Examples:
    images = stored.image_ids(stored.scene_ids["train"])
    divided = division.assign(images, images=len(stored.images))
    image_ids = _of_set(stored.folder, divided, split)
    return Examples(
        folder=stored.folder,
        split=split,
        scene_ids=image_ids,
        categories=stored.categories,
        place_of={
            image_id: (scene_id, *stored.images[place])
            for image_id in image_ids
            for scene_id, place in [divmod(image_id, len(stored.images))]
        },
        read=partial(_stored_example, stored),
        origins=tuple(
            stored.folder / "train" / f"{scene_id:06d}" / MANIFEST
            for scene_id in sorted({image_id // len(stored.images) for image_id in image_ids})
        ),
    )


def _from_others(path: Path, foreign: Foreign, split: str, division: Split) -> Examples:
    sets = division.assign(set(foreign.scene_of))
    inside = set(_of_set(path, sets, split))
    return Examples(
        folder=path,
        split=split,
        scene_ids=tuple(i for i, scene in enumerate(foreign.scene_of) if scene in inside),
        categories=foreign.categories,
        place_of=_places(foreign.scene_of),
        read=foreign.read,
        origins=(path,) if path.is_file() else tuple(sorted(path.glob("[0-9]*/scene_*.json"))),
    )


def _places(scene_of: Sequence[int]) -> dict[int, tuple[int, str, int]]:
    """Return `Examples.place_of` for pictures of a single scanner without a name."""
    before: Counter[int] = Counter()
    places = {}
    for i, scene in enumerate(scene_of):
        places[i] = (scene, "", before[scene])
        before[scene] += 1
    return places


def _stored_example(stored: StoredDataset, scene_id: int) -> Example:
    return stored.picture(scene_id).example()


def _of_set(folder: Path, sets: Mapping[str, Sequence[int]], split: str) -> tuple[int, ...]:
    if split not in sets:
        raise DatasetError(f"{folder}: has no set {split!r}: choose one of {', '.join(sets)}")
    return tuple(sets[split])


def _reader(name: str) -> Callable[..., ReadOne]:
    reader = FORMATS[name].reader
    if reader is None:
        raise DatasetError(
            f"an export as {name} is not for training: train from the dataset or from another "
            "export"
        )
    module, _, function = reader.partition(".")
    return getattr(import_module(f".{module}", __package__), function)
