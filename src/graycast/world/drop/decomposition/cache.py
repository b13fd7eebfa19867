"""Hulls kept on disk between runs."""

import hashlib
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ....base import folder
from ....base.folder import fill_whole
from ...parts import Mesh
from .error import Decomposition

CACHE_VERSION = 3  # Raise it where a change in this folder gives other hulls.


def cache_folder() -> Path:
    """Where hulls are kept between runs."""
    return folder.cache_folder("hulls")


def key_of(mesh: Mesh, settings: tuple[object, ...]) -> str:
    """A name for the result: everything it depends on."""
    digest = hashlib.sha256(repr((CACHE_VERSION, version("manifold3d"), settings)).encode())
    for array in (mesh.vertices_m.astype("<f8"), mesh.faces.astype("<i8")):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def read_decomposition(file: Path) -> Decomposition | None:
    """The content of a cache file; None if the file is missing or damaged."""
    try:
        # NumPy leaves a file open that it opened itself and then could not read.
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            vertices, faces = data["vertices_m"], data["faces"]
            splits = data["vertex_split"], data["face_split"]
            filled_m, lost_m, tolerance_m = map(float, data["measured_m"])
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        return None
    pieces = zip(np.split(vertices, splits[0]), np.split(faces, splits[1]), strict=True)
    return Decomposition(
        hulls=tuple(pieces),
        filled_m=filled_m,
        lost_m=lost_m,
        tolerance_m=tolerance_m,
    )


def write_decomposition(file: Path, decomposition: Decomposition) -> None:
    """Write a cache file, completely or not at all."""
    hulls, own = decomposition.hulls, decomposition
    file.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {
        "vertices_m": np.vstack([vertices for vertices, _ in hulls]),
        "faces": np.vstack([faces for _, faces in hulls]),
        "vertex_split": np.cumsum([len(vertices) for vertices, _ in hulls])[:-1],
        "face_split": np.cumsum([len(faces) for _, faces in hulls])[:-1],
        "measured_m": np.array([own.filled_m, own.lost_m, own.tolerance_m]),
    }
    fill_whole(file, lambda aside: np.savez(aside, **arrays))
