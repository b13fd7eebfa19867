"""The bin of a stored dataset, read from the dataset's configuration."""

from pathlib import Path

from pydantic import ValidationError

from ..base.errors import DatasetError
from ..dataset.files.seal import sha256
from ..dataset.read.stored import StoredDataset
from ..world.scene import Bin
from .config import BinSection, resolve_bin


def stored_bin(dataset: StoredDataset, files: Path) -> Bin:
    """Return the bin of a simulated dataset, with its shape and friction but not with its material.

    Args:
        files: the folder in which the configuration's relative paths start.

    Raises:
        DatasetError: the configuration has no readable bin, or the bin's mesh has changed.
        GraycastError: the bin's mesh cannot be read.
    """
    config = dataset.claim["config"]
    try:
        section = BinSection.model_validate({**config["bin"], "material": None, "floor": None})
    except (KeyError, ValidationError) as error:
        raise DatasetError(
            f"{dataset.folder}: its configuration has no bin that this version of Graycast can "
            "read: use the version that made the dataset"
        ) from error
    box, mesh = resolve_bin(section, files)[0], section.mesh
    if mesh is not None and sha256((files / mesh).read_bytes()) != config["files"].get(str(mesh)):
        raise DatasetError(
            f"{dataset.folder}: the bin's mesh {files / mesh} has changed since the dataset was "
            "made: restore the file"
        )
    return box
