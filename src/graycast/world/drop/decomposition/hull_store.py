"""Make the hulls of each mesh once, and store them for later runs."""

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ....base.errors import GraycastError
from ....base.folder import cache_folder
from ....base.progress import UNWATCHED, ProgressMeter
from ...parts import Mesh, Part
from . import cutting, error, mesh_hulls, solid
from .cache import read_decomposition, write_decomposition
from .error import Decomposition, measure
from .hull_process import decompose_apart
from .mesh_hulls import decompose

FEW_FACES = 20_000  # Up to this many faces, a single hull is tried without a child process.

CACHE_VERSION = 3  # Raise this number when a change in this folder changes the hulls.
# The cache key has all constants that determine the hulls.
_SETTINGS = tuple(
    (name, value)
    for module in (error, mesh_hulls, solid, cutting)
    for name, value in vars(module).items()
    if name.isupper() and isinstance(value, int | float | tuple)
)


def prepare(
    parts: Iterable[Part], *, hull_folder: Path | None = None, progress: ProgressMeter = UNWATCHED
) -> tuple[Decomposition, ...]:
    """Return the convex hulls of each part, whose union is its mesh within `tolerance_m(mesh)`.

    Hulls that the cache lacks are made, once for equal meshes. A mesh that is convex within the
    tolerance has one hull. Other meshes are cut by child processes, one per processor, which end
    with this call. Cavities are filled. A body with so much detail that it would need too many
    pieces or too much time (`mesh_hulls.MOST_PIECES`, `MOST_FACES_CUT`) is cut more coarsely, which
    `progress` reports. Its error is measured, and the result says whether it is `coarse`. Hulls
    depend only on the mesh, and are in its frame.

    Args:
        parts: parts with closed meshes, which the loaders of parts guarantee.
        hull_folder: the disk cache; the user's if None. A damaged file, or a file for a different
            mesh, version or setting, is replaced in one step. If the folder cannot be written,
            nothing is kept.
        progress: called with the number of kinds that are ready, or, during the last kind, with the
            current stage.

    Raises:
        ValueError: a mesh is not closed, or inside out; the first kind that fails is named.
        GraycastError: a child was killed.
    """
    folder, parts = hull_folder or cache_folder("hulls"), tuple(parts)
    keys = [_key(part.mesh) for part in parts]
    kinds = dict(zip(keys, parts, strict=True))
    files = {} if folder is None else {key: folder / f"{key}.npz" for key in kinds}
    stored = {key: read_decomposition(file) for key, file in files.items()}
    ready = {key: hulls for key, hulls in stored.items() if hulls is not None}

    def keep(key: str, hulls: Decomposition) -> None:
        ready[key] = hulls
        if key in files:
            with suppress(OSError, GraycastError):  # Then the next run makes the hulls again.
                write_decomposition(files[key], hulls)

    def jobs() -> Iterator[tuple[str, Part]]:
        for key, part in kinds.items():
            if key in ready:
                continue
            if len(part.mesh.faces) <= FEW_FACES and mesh_hulls.is_one_hull(part.mesh):
                keep(key, measure(part.mesh, decompose(part.mesh)))
            else:
                yield key, part

    with closing(decompose_apart(jobs())) as all_news:
        for key, news in all_news:
            if isinstance(news, Decomposition):
                keep(key, news)
            left = len(kinds) - len(ready)
            if left == 1 and isinstance(news, str):
                progress.stage(f"{kinds[key].name}: {news}")
            elif left:
                progress.stage(f"collision hulls: {len(ready)} of {len(kinds)} kinds are ready")
    return tuple(ready[key] for key in keys)


def _key(mesh: Mesh) -> str:
    """Return a cache key, which covers everything that the result depends on."""
    digest = hashlib.sha256(repr((CACHE_VERSION, version("manifold3d"), _SETTINGS)).encode())
    for array in (mesh.vertices_m.astype("<f8"), mesh.faces.astype("<i8")):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]
