"""Meshes in the form for the pages' 3D views, and the bin of a dataset."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ....base.errors import GraycastError
from ....cell.stored_bin import stored_bin
from ....dataset.read.stored import StoredDataset
from ....world.parts import Mesh
from ....world.scene import Bin, bin_mesh
from .packing import pack_bytes

UPRIGHT = 0.9  # least cosine between the vertical and the normal of a face that points up


def dataset_walls(dataset: StoredDataset, files: Path) -> dict[str, Any] | None:
    """Return the bin of a dataset for its page, or why it is missing; None for real pictures.

    Args:
        files: see `stored_bin`.
    """
    if dataset.real:
        return None
    try:
        return packed_walls(stored_bin(dataset, files))
    except GraycastError as error:
        remedy = "If the bin's mesh is in another folder, name this folder with --files."
        return {"missing": f"The bin is not drawn: {error}. {remedy}"}


def packed_walls(box: Bin) -> dict[str, Any]:
    """Return a bin's inner sides and rim, and how far each vertex moves if the bin grows.

    If the domain scales the bin by f, the vertices are `vertices + (f - 1) * growth`. The walls of
    a box keep their thickness.
    """
    mesh = open_bin(box)
    growth_m = mesh.vertices_m
    if box.mesh is None:
        x, y, z = box.inner_m
        growth_m = np.clip(growth_m, [-x / 2, -y / 2, 0], [x / 2, y / 2, z])
    return {**packed_mesh(mesh), "growth": packed_values((1e3 * growth_m).astype("<f4"))}


def open_bin(box: Bin) -> Mesh:
    """Return a bin without its outer sides, so that its inside is visible from everywhere."""
    whole = bin_mesh(box)
    normal, centre = whole.face_normal, whole.vertices_m[whole.faces].mean(axis=1)
    low, high = whole.bounds_m
    middle = np.array([*(low + high)[:2] / 2, high[2]])
    inwards = np.einsum("fi,fi->f", normal, middle - centre) > 0
    return Mesh(vertices_m=whole.vertices_m, faces=whole.faces[inwards | (normal[:, 2] > UPRIGHT)])


def packed_mesh(mesh: Mesh) -> dict[str, Any]:
    """Return vertices [mm] and faces in the format that a page unpacks."""
    mesh = replace(mesh, corner_uv=None, corner_normals=None)
    return {
        "vertices": packed_values((1e3 * mesh.vertices_m).astype("<f4")),
        "faces": packed_values(mesh.faces.astype("<u4")),
    }


def packed_values(values: np.ndarray) -> str:
    """Return the bytes of an array, compressed."""
    return pack_bytes(np.ascontiguousarray(values).view(np.uint8))
