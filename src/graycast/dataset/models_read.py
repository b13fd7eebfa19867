"""The parts of a dataset read back from its `models/`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import DatasetError, MeshError
from ..world.parts import Mesh, Symmetry, load_mesh
from . import records
from .records import MM_PER_M
from .safe_reading import Unreadable, read_json


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredModel:
    """A part's shape [m] with what `models_info.json` says of it."""

    mesh: Mesh
    diameter_m: float
    symmetry: Symmetry


def read_models(dataset: Path) -> dict[int, StoredModel]:
    """The models of a dataset by object id.

    Raises:
        DatasetError: there are none, or a file is missing or damaged.
    """
    folder = dataset / "models"
    if not folder.is_dir():
        raise DatasetError(f"{dataset}: has no models: give a dataset that graycast generate made")
    try:
        infos = read_json(folder / "models_info.json", dict[str, records.ModelInfo])
    except Unreadable as error:
        raise DatasetError(f"{folder}: {error}: run graycast validate") from error
    return {int(key): _model(folder / f"obj_{int(key):06d}.ply", i) for key, i in infos.items()}


def _model(file: Path, info: records.ModelInfo) -> StoredModel:
    try:
        mesh = load_mesh(file, unit="mm")[0]
    except MeshError as error:
        raise DatasetError(f"{error}: run graycast validate") from error
    return StoredModel(
        mesh=mesh,
        diameter_m=info.diameter / MM_PER_M,
        symmetry=symmetry_m(info.symmetries_discrete, info.symmetries_continuous),
    )


def symmetry_m(discrete: list[list[float]], continuous: list[records.Continuous]) -> Symmetry:
    """Of `models_info.json`, whose lengths are millimetres."""
    scale = np.array([[1, 1, 1, 1 / MM_PER_M]] * 3 + [[1, 1, 1, 1]])
    return Symmetry(
        discrete=tuple(np.reshape(matrix, (4, 4)) * scale for matrix in discrete),
        continuous=tuple(
            (_three(one.axis), _three([x / MM_PER_M for x in one.offset])) for one in continuous
        ),
    )


def _three(numbers: list[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z
