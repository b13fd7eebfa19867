"""The hulls of meshes, made once and kept."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from ....base.progress import UNWATCHED, ProgressMeter
from ...parts import Mesh
from . import cutting, error, mesh_hulls, solid
from .cache import cache_folder, key_of, read_decomposition, write_decomposition
from .error import Decomposition, measured
from .hull_process import decompose_apart
from .mesh_hulls import decompose

FEW_FACES = 20_000  # A mesh with so few faces is tried as one hull here, without a child process.

_SETTINGS = (
    error.TOLERANCE_M,
    error.TOLERANCE_OF_DIAGONAL,
    error.MIDDLE_TOLERANCE,
    error.SAMPLES,
    error.LID_SAMPLES,
    mesh_hulls.VERTEX_TOLERANCE_OF_DIAGONAL,
    mesh_hulls.CUT_SHARE,
    mesh_hulls.MOST_PIECES,
    mesh_hulls.MOST_FACES_CUT,
    mesh_hulls.COARSER,
    solid.SIMPLIFIED_BY,
    solid.ENOUGH_FACES,
    cutting.REFLEX_RAD,
    cutting.PLANES,
    cutting.WORTH,
    cutting.EACH,
    cutting.EVEN,
    cutting.CUT,
    cutting.THIN,
    cutting.HAIR,
    cutting.WEDGES,
    cutting.ACROSS,
    cutting.DEEPEST_CUTS,
)


def convex_hulls(
    mesh: Mesh, *, folder: Path | None = None, progress: ProgressMeter = UNWATCHED
) -> Decomposition:
    """Convex hulls whose union is the mesh within `tolerance_m(mesh)`, in the mesh's frame.

    Cavities are filled. A body of so much detail that it would take too many pieces or too long
    (`making.MOST_PIECES`, `MOST_FACES_CUT`) is cut more coarsely, as `progress` hears; what came of
    it is measured, and the result says whether it is `coarse`. It is a function of the mesh alone.

    Args:
        mesh: closed, as `parts` delivers it.
        folder: of the disk cache, `cache_folder()` if None. A file that is damaged or of
            another mesh, version or setting is made anew, and appears at once or not at all.
        progress: hears what is being done, where it is not read from the cache.

    Returns:
        One hull for a mesh that is convex within the tolerance, else several, found by a child
        process that ends with this call.

    Raises:
        ValueError: the mesh is not closed, or inside out.
        GraycastError: the child was killed.
    """
    (hulls,) = convex_hulls_of((("", mesh),), folder=folder, progress=progress)
    return hulls


def convex_hulls_of(
    named: Sequence[tuple[str, Mesh]],
    *,
    folder: Path | None = None,
    progress: ProgressMeter = UNWATCHED,
) -> tuple[Decomposition, ...]:
    """`convex_hulls` of each mesh, of equal ones once, by one child process per processor.

    Args:
        named: a part's name for stages and errors, which may be empty, and its mesh.
        progress: hears the number of kinds that are ready, or, while the last one is made, what is
            being done.

    Raises:
        ValueError, GraycastError: as in `convex_hulls`; of the kind that fails first.
    """
    folder = cache_folder() if folder is None else folder
    files = [folder / f"{key_of(mesh, _SETTINGS)}.npz" for _, mesh in named]
    kinds = dict(zip(files, named, strict=True))
    ready = {file: hulls for file in kinds if (hulls := read_decomposition(file)) is not None}

    def keep(file: Path, hulls: Decomposition) -> None:
        write_decomposition(file, hulls)
        ready[file] = hulls

    def jobs() -> Iterator[tuple[Path, str, Mesh]]:
        for file, (name, mesh) in kinds.items():
            if file in ready:
                continue
            if len(mesh.faces) <= FEW_FACES and mesh_hulls.is_one_hull(mesh):
                keep(file, measured(mesh, decompose(mesh)))
            else:
                yield file, name, mesh

    with closing(decompose_apart(jobs())) as all_news:
        for file, news in all_news:
            if isinstance(news, Decomposition):
                keep(file, news)
            left = len(kinds) - len(ready)
            if left == 1 and isinstance(news, str):
                name, _ = kinds[file]
                progress.stage(f"{name}: {news}" if name else news)
            elif left:
                progress.stage(f"collision hulls: {len(ready)} of {len(kinds)} kinds are ready")
    return tuple(ready[file] for file in files)
