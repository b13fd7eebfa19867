"""Read the object models of a dataset, and check them against `models_info.json`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import DatasetError
from ...base.frames import is_rigid
from ...base.ply import TEXTURE, triangles
from ..files import records
from ..files.safe_reading import Unreadable

_MODEL_MM = 1e-3  # A PLY file stores nine digits.


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """The content of `models/` for one object [mm]."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    info: records.ModelInfo


def read_model(out: Path, obj_id: int, info: records.ModelInfo) -> Model:
    path = out / "models" / f"obj_{obj_id:06d}.ply"
    if not path.is_file():
        raise Unreadable(f"models/{path.name} is missing")
    try:
        head, vertices, faces = triangles(path)
    except DatasetError as error:
        raise Unreadable(str(error)) from error
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise Unreadable(f"models/{path.name} has no faces, or faces without vertices")
    for line in head:
        if line.startswith(TEXTURE) and not (path.parent / line.split()[-1]).is_file():
            raise Unreadable(f"models/{line.split()[-1]} is missing")
    return Model(vertices=vertices, faces=faces, info=info)


def model_problems(obj_id: int, model: Model) -> Iterator[str]:
    from ..write.models import diameter  # The import takes as long as the check of a scene.

    info, name = model.info, f"models_info.json: object {obj_id}"
    low, size = model.vertices.min(axis=0), np.ptp(model.vertices, axis=0)
    if np.abs([low - info.low, size - info.size]).max() > _MODEL_MM:
        yield f"{name}: box from {info.low}, size {info.size}; the PLY's: {low}, {size}"
    diameter_mm = diameter(model.vertices)
    if abs(diameter_mm - info.diameter) > _MODEL_MM:
        yield f"{name}: diameter is {info.diameter}, the PLY's is {diameter_mm:.6f}"
    for k, symmetry in enumerate(info.symmetries_discrete):
        if not is_rigid(np.array(symmetry, dtype=float).reshape(4, 4)):
            yield f"{name}: discrete symmetry {k} is not a rigid motion"
    for k, continuous in enumerate(info.symmetries_continuous):
        if abs(np.linalg.norm(continuous.axis) - 1) > 1e-6:
            yield f"{name}: the axis of continuous symmetry {k} has not length 1"
