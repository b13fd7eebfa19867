"""Scenes that somebody chose on the report's page and saved as a file."""

from pathlib import Path
from typing import Literal

from ...base.errors import DatasetError, GraycastError
from .. import records
from ..safe_reading import Unreadable, read_json
from ..stored import StoredDataset

_SOME = 3  # An error names so many keys.


class Selection(records.Record):
    """The file: every chosen scene (`train-000003`) with its tags, and whose scenes they are."""

    kind: Literal["graycast-scenes"]
    dataset: str
    fingerprint: str
    scenes: dict[str, list[str]]


def chosen_pictures(path: Path, stored: StoredDataset) -> list[int]:
    """The numbers of a file's pictures, all of them pictures that an export can take.

    Raises:
        GraycastError: the file cannot be read, names no scene, is of another dataset, or names
            scenes that are not in the dataset's `train`.
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
