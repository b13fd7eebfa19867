"""Parts as BOP object models, written and read: PLY files in millimetres, `models_info.json`.

A model keeps the part's own frame, so that poses refer to the user's CAD coordinates. BOP's usual
origin, the centre of the bounding box, is not required (`models_info.json` has the box).
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from ...base.color import srgb
from ...base.errors import DatasetError, MeshError
from ...base.ply import COLORS, TEXTURE, header
from ...world.parts import Mesh, Part, Symmetry, load_mesh
from ..files.records import MM_PER_M, Continuous, ModelInfo
from ..files.safe_reading import Unreadable, read_json

_CHUNK = 2048  # rows of the distance matrix that are in memory at a time


def model_files(parts: tuple[Part, ...]) -> dict[str, bytes]:
    """Return the files of `models/` except `models_info.json`, by name."""
    files = {}
    for obj_id, part in enumerate(parts, start=1):
        texture = None if part.mesh.corner_uv is None else part.material.texture
        name = f"obj_{obj_id:06d}"
        files[f"{name}.ply"] = _ply(part, None if texture is None else f"{name}.png")
        if texture is not None:
            encoded = cv2.imencode(".png", np.ascontiguousarray(texture[..., ::-1]))
            files[f"{name}.png"] = encoded[1].tobytes()
    return files


def models_info(parts: tuple[Part, ...]) -> dict[str, Any]:
    """Return box, diameter and symmetries of each model [mm] for `models_info.json`."""
    return {str(obj_id): _info(part) for obj_id, part in enumerate(parts, start=1)}


def _info(part: Part) -> dict[str, Any]:
    mesh = part.mesh
    vertices_mm = mesh.vertices_m[np.unique(mesh.faces)].astype(np.float64) * MM_PER_M
    low, size = vertices_mm.min(axis=0), np.ptp(vertices_mm, axis=0)
    info: dict[str, Any] = {"diameter": diameter(vertices_mm)}
    for i, axis in enumerate("xyz"):
        info[f"min_{axis}"], info[f"size_{axis}"] = float(low[i]), float(size[i])
    if part.symmetry.discrete:
        scale = np.array([[1, 1, 1, MM_PER_M]] * 3 + [[1, 1, 1, 1]])
        info["symmetries_discrete"] = [(T * scale).ravel().tolist() for T in part.symmetry.discrete]
    if part.symmetry.continuous:
        info["symmetries_continuous"] = [
            {"axis": [float(a) for a in axis], "offset": [MM_PER_M * o for o in offset_m]}
            for axis, offset_m in part.symmetry.continuous
        ]
    return info


def diameter(points: Float[np.ndarray, "n 3"]) -> float:
    """Return the largest distance between any two points, in their unit.

    The farthest points are corners of the convex hull. If the points are flat, there is no hull,
    and all points are compared.
    """
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:
        pass
    chunks = (points[i : i + _CHUNK] for i in range(0, len(points), _CHUNK))
    return max(float(cdist(chunk, points).max()) for chunk in chunks)


def _ply(part: Part, texture_name: str | None) -> bytes:
    """Return ASCII PLY as bop_toolkit's `load_ply` reads it: one normal, uv or colour per vertex.

    A vertex whose corners differ in normal or uv is written once for each distinct corner.
    """
    mesh = part.mesh
    columns = [mesh.faces.reshape(-1, 1), np.round(_corner_normals(mesh).reshape(-1, 3), 6) + 0.0]
    if texture_name is not None:
        if mesh.corner_uv is None:
            raise ValueError(f"{texture_name} has no place on a mesh without uv")
        columns.append(mesh.corner_uv.reshape(-1, 2))
    rows, index = np.unique(np.hstack(columns), axis=0, return_inverse=True)
    vertices_mm = mesh.vertices_m[rows[:, 0].astype(np.int64)].astype(np.float64) * MM_PER_M
    properties = [("float", name) for name in ("x", "y", "z", "nx", "ny", "nz")]
    table = np.hstack([vertices_mm, rows[:, 1:]])
    formats = ["%.9g"] * table.shape[1]
    if texture_name is not None:
        properties += [("float", "texture_u"), ("float", "texture_v")]
    else:
        color = np.broadcast_to(srgb(np.array(part.material.base_color)), (len(table), 3))
        properties += [("uchar", name) for name in COLORS]
        table, formats = np.hstack([table, color]), [*formats, "%d", "%d", "%d"]
    notes = [] if texture_name is None else [f"{TEXTURE} {texture_name}"]
    text = io.BytesIO()
    text.write(header("ascii", properties, vertices=len(table), faces=len(mesh.faces), notes=notes))
    np.savetxt(text, table, fmt=formats)
    np.savetxt(text, index.reshape(-1, 3), fmt="3 %d %d %d")
    return text.getvalue()


def _corner_normals(mesh: Mesh) -> Float[np.ndarray, "f 3 3"]:
    """Return the mesh's normals or, without any, angle-weighted means of face normals at vertices.

    Source: G. Thürmer, C. Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    if mesh.corner_normals is not None:
        return mesh.corner_normals.astype(np.float64)
    corner = mesh.vertices_m[mesh.faces].astype(np.float64)
    ahead = _unit(np.roll(corner, -1, axis=1) - corner)
    behind = _unit(np.roll(corner, 1, axis=1) - corner)
    angle_rad = np.arccos(np.clip((ahead * behind).sum(axis=-1), -1.0, 1.0))
    total = np.zeros(mesh.vertices_m.shape)
    np.add.at(total, mesh.faces, angle_rad[..., None] * mesh.face_normal[:, None])
    return _unit(total)[mesh.faces]


def _unit(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Return vectors of length one; a zero vector stays zero."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length > 0, length, 1.0)


# --- reading -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredModel:
    """A part's shape [m] with its diameter and its symmetries."""

    mesh: Mesh
    diameter_m: float
    symmetry: Symmetry


def read_models(dataset: Path) -> dict[int, StoredModel]:
    """Read the models of a dataset, by object id.

    Raises:
        DatasetError: the dataset has no models, or a file is missing or damaged.
    """
    folder = dataset / "models"
    if not folder.is_dir():
        raise DatasetError(f"{dataset}: has no models: give a dataset that graycast generate made")
    try:
        infos = read_json(folder / "models_info.json", dict[str, ModelInfo])
    except Unreadable as error:
        raise DatasetError(f"{folder}: {error}: run graycast validate") from error
    return {int(key): _model(folder / f"obj_{int(key):06d}.ply", i) for key, i in infos.items()}


def _model(file: Path, info: ModelInfo) -> StoredModel:
    try:
        mesh = load_mesh(file, unit="mm")[0]
    except MeshError as error:
        raise DatasetError(f"{error}: run graycast validate") from error
    return StoredModel(
        mesh=mesh,
        diameter_m=info.diameter / MM_PER_M,
        symmetry=symmetry_m(info.symmetries_discrete, info.symmetries_continuous),
    )


def symmetry_m(discrete: list[list[float]], continuous: list[Continuous]) -> Symmetry:
    """Return symmetries with lengths in metres; `models_info.json` has millimetres."""
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
