"""The hulls of a mesh, made once and kept."""

from pathlib import Path

from ...parts import Mesh
from . import cutting, error, making, solid
from .cache import cache_folder, key_of, read_decomposition, write_decomposition
from .child import decompose_apart
from .error import Decomposition, measured
from .making import OnStage, decompose, silent

FEW_FACES = 20_000  # whether one hull will do is asked here, without a child

# All that hulls depend on beside the mesh and `CACHE_VERSION`.
_SETTINGS = (
    error.TOLERANCE_M,
    error.TOLERANCE_OF_DIAGONAL,
    error.MIDDLE_TOLERANCE,
    error.SAMPLES,
    error.LID_SAMPLES,
    making.VERTEX_TOLERANCE_OF_DIAGONAL,
    making.CUT_SHARE,
    making.MOST_PIECES,
    making.MOST_FACES_CUT,
    making.COARSER,
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
    mesh: Mesh, *, folder: Path | None = None, on_stage: OnStage = silent
) -> Decomposition:
    """Convex hulls whose union is the mesh within `tolerance_m(mesh)`, in the mesh's frame.

    Cavities are filled. A body of so much detail that it would take too many pieces or too long
    (`making.MOST_PIECES`, `MOST_FACES_CUT`) is cut more coarsely, as `on_stage` tells; what came of
    it is measured, and the result says whether it is `coarse`. It is a function of the mesh alone.

    Args:
        mesh: closed, as `parts` delivers it.
        folder: of the disk cache, `cache_folder()` if None. A file that is damaged or of
            another mesh, version or setting is made anew, and appears at once or not at all.
        on_stage: told what is being done, where it is not read from the cache.

    Returns:
        One hull for a mesh that is convex within the tolerance, else several, found by a child
        process that ends with this call.

    Raises:
        ValueError: the mesh is not closed, or inside out.
        GraycastError: the child was killed.
    """
    key = key_of(mesh, _SETTINGS)
    file = (cache_folder() if folder is None else folder) / f"{key}.npz"
    made = read_decomposition(file)
    if made is None:
        if len(mesh.faces) <= FEW_FACES and making.is_one_hull(mesh):
            made = measured(mesh, decompose(mesh))
        else:
            made = decompose_apart(mesh, on_stage=on_stage)
        write_decomposition(file, made)
    return made
