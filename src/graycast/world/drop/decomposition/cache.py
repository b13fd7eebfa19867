"""Read and write files that store hulls between runs and pass them between processes."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ....base.folder import fill_whole
from .error import Decomposition


def read_decomposition(file: Path) -> Decomposition | None:
    """Return the content of a cache file; None if the file is missing or damaged."""
    try:
        # NumPy does not close a file that it cannot read, so this function opens and closes it.
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
