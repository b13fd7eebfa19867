"""A part's mesh as a few convex hulls, which is what the physics engine collides.

CoACD cuts the mesh finely; then hulls are joined again wherever their union still follows the
surface within a tolerance, and lose vertices that hardly matter, because the time of a drop
grows with both. The result is a function of the mesh alone: CoACD
1.0.14 with its seed fixed gave the same bits over repeated runs and over 1, 2 and 5 threads.

Leaves out: concave details shallower than the tolerance are filled, so a pin does not enter a
bore with less clearance than that, and parts may rest that far from where they would touch.

Source: Wei et al., "Approximate Convex Decomposition for 3D Meshes with Collision-Aware
Concavity and Tree Search", SIGGRAPH 2022 (CoACD).
"""

import hashlib
import os
import zipfile
from importlib.metadata import version
from itertools import product
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from ..parts import Mesh

TOLERANCE_M = 0.5e-3
TOLERANCE_OF_DIAGONAL = 0.005  # a bottle is spared the hulls that a bracket's 0.5 mm would cost
# How far a hull may shrink when it loses vertices, of the box diagonal. A scanned box whose nearly
# flat sides kept 129 vertices (0.03 %) rocked on them for ever; with 51 (0.3 %) it comes to rest.
VERTEX_TOLERANCE_OF_DIAGONAL = 0.003
# Relative concavity. 0.01 halves the deviation of a bored bracket (0.55 mm) for four to five times
# the hulls and the time, and shatters scanned, bumpy bodies into hundreds.
COACD_THRESHOLD = 0.02
# A faster search than the default; half as much again cuts worse, into more pieces, and is slower.
MCTS_ITERATIONS, MCTS_NODES = 60, 10
SURFACE_SAMPLES = 6000
CACHE_VERSION = 1

Hull = tuple[np.ndarray, np.ndarray]
"""Vertices [m] (v, 3) in the part's frame and faces (f, 3), counter-clockwise from outside."""


def cache_folder() -> Path:
    """Where hulls are kept between runs: `$XDG_CACHE_HOME/graycast/hulls`, else `~/.cache/...`."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "graycast" / "hulls"


def convex_hulls(mesh: Mesh, *, folder: Path | None = None) -> tuple[Hull, ...]:
    """Convex hulls whose union is the mesh within `tolerance_m(mesh)`, in the mesh's frame.

    Args:
        mesh: closed, as `parts` delivers it. CoACD remeshes an open one, coarsely.
        folder: of the disk cache, `cache_folder()` if None. A file that is damaged or of
            another mesh, version or setting is made anew, and appears at once or not at all.

    Returns:
        One hull for a mesh that is convex within the tolerance (CoACD is not run), else several.
        CoACD's cut is not bound to the tolerance, joining is: 0.6 mm at a steel bracket with
        bores, 1.5 mm at the trigger of a spray bottle. `deviation_m` measures it.
    """
    file = (cache_folder() if folder is None else folder) / f"{_key(mesh)}.npz"
    hulls = _read(file)
    if hulls is None:
        hulls = decompose(mesh)
        _write(file, hulls)
    return hulls


def decompose(mesh: Mesh) -> tuple[Hull, ...]:
    """`convex_hulls` without the cache: a second to half a minute for a concave mesh."""
    sample_m = _surface_samples(mesh)
    limit_m = tolerance_m(mesh)
    hulls = (_hull(mesh.vertices_m),)
    if deviation_m(sample_m, hulls) > limit_m:
        hulls = _join(_coacd(mesh), sample_m, limit_m)
    thin_m = VERTEX_TOLERANCE_OF_DIAGONAL * float(np.linalg.norm(mesh.extent_m))
    return tuple(_hull(_thin(vertices, thin_m)) for vertices, _ in hulls)


def tolerance_m(mesh: Mesh) -> float:
    """How far the hulls' union may be from the surface: 0.5 mm or 0.5 % of the box diagonal."""
    return max(TOLERANCE_M, TOLERANCE_OF_DIAGONAL * float(np.linalg.norm(mesh.extent_m)))


def deviation_m(surface_m: Float[np.ndarray, "n 3"], hulls: tuple[Hull, ...]) -> float:
    """How far points of the true surface lie from the surface of the hulls' union [m].

    The deepest that a point is buried in any one hull (a filled concavity), or the farthest that
    one is from all of them (a lost corner), whichever is more. A point's depth in a hull is its
    distance to the nearest face's plane.
    """
    height = np.stack([_height_m(surface_m, vertices) for vertices, _ in hulls])
    return float(max(-height.min(), height.min(axis=0).max(), 0.0))


def _height_m(
    point: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "n"]:
    """Largest signed distance to the planes of the vertices' hull; negative inside."""
    plane = np.unique(ConvexHull(vertices).equations.round(12), axis=0)
    return (point @ plane[:, :3].T + plane[:, 3]).max(axis=1)


def _surface_samples(mesh: Mesh) -> Float[np.ndarray, "n 3"]:
    """Vertices, where grooves are deepest, and points spread over the faces by area."""
    rng = np.random.default_rng(0)  # fixed: hulls depend on the mesh alone
    corner = mesh.vertices_m[mesh.faces]
    area = np.linalg.norm(mesh.face_cross_m2, axis=1)
    face = rng.choice(len(area), SURFACE_SAMPLES, p=area / area.sum())
    weight = rng.dirichlet((1.0, 1.0, 1.0), SURFACE_SAMPLES)
    inside = np.einsum("nk,nki->ni", weight, corner[face])
    vertices = mesh.vertices_m[np.unique(mesh.faces)]
    return np.vstack([inside, vertices[:: 1 + len(vertices) // SURFACE_SAMPLES]])


def _hull(vertices: Float[np.ndarray, "v 3"]) -> Hull:
    """The convex hull of points, faces turned outward."""
    hull = ConvexHull(vertices)
    kept = hull.vertices
    number = np.full(len(vertices), -1)
    number[kept] = np.arange(len(kept))
    faces, corner = number[hull.simplices], vertices[hull.simplices]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("fi,fi->f", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices[kept], faces


def _coacd(mesh: Mesh) -> tuple[Hull, ...]:
    import coacd  # loads its native library and OpenMP, which a cached part does not need

    coacd.set_log_level("off")
    pieces = coacd.run_coacd(
        coacd.Mesh(mesh.vertices_m, mesh.faces),
        threshold=COACD_THRESHOLD,
        mcts_iterations=MCTS_ITERATIONS,
        mcts_nodes=MCTS_NODES,
        preprocess_resolution=100,
        seed=0,
    )
    return tuple(_hull(vertices) for vertices, _ in pieces)


def _join(
    hulls: tuple[Hull, ...], surface_m: Float[np.ndarray, "n 3"], limit_m: float
) -> tuple[Hull, ...]:
    """Replaces pairs by their common hull, the least harmful first, while none exceeds the limit.

    The harm is the depth to which the common hull buries the true surface.
    """
    alive = {i: vertices for i, (vertices, _) in enumerate(hulls)}
    harm: dict[tuple[int, int], float] = {}

    def consider(i: int, j: int) -> None:
        a, b = alive[i], alive[j]
        if (a.min(axis=0) > b.max(axis=0) + limit_m).any():
            return
        if (b.min(axis=0) > a.max(axis=0) + limit_m).any():
            return
        both = np.vstack([a, b])
        within = (surface_m > both.min(axis=0)) & (surface_m < both.max(axis=0))
        height_m = _height_m(surface_m[within.all(axis=1)], both)
        depth_m = -float(height_m.min(initial=0.0))
        if depth_m <= limit_m:
            harm[i, j] = depth_m

    for j in alive:
        for i in range(j):
            consider(i, j)
    new = len(hulls) - 1
    while harm:
        i, j = min(harm, key=lambda pair: (harm[pair], pair))
        both = np.vstack([alive.pop(i), alive.pop(j)])
        harm = {pair: depth for pair, depth in harm.items() if not {i, j} & set(pair)}
        new += 1
        others = list(alive)
        alive[new] = both[ConvexHull(both).vertices]
        for other in others:
            consider(other, new)
    return tuple(_hull(vertices) for vertices in alive.values())


def _thin(vertices: Float[np.ndarray, "v 3"], limit_m: float) -> Float[np.ndarray, "k 3"]:
    """Vertices enough for a hull that leaves none of the others further outside than the limit.

    The farthest one outside is added until none is: the engine's cost grows with each vertex.
    """
    directions = np.array(list(product((-1, 0, 1), repeat=3)))
    chosen = sorted({int(i) for i in (vertices @ directions.T).argmax(axis=0)})
    if np.linalg.matrix_rank(vertices[chosen] - vertices[chosen[0]], tol=1e-9) < 3:
        return vertices
    while True:
        outside_m = _height_m(vertices, vertices[chosen])
        farthest = int(outside_m.argmax())
        if outside_m[farthest] <= limit_m or farthest in chosen:
            return vertices[chosen]
        chosen.append(farthest)


def _key(mesh: Mesh) -> str:
    """A name for the result: everything it depends on."""
    settings = [CACHE_VERSION, version("coacd"), TOLERANCE_M, TOLERANCE_OF_DIAGONAL]
    settings += [VERTEX_TOLERANCE_OF_DIAGONAL, SURFACE_SAMPLES]
    settings += [COACD_THRESHOLD, MCTS_ITERATIONS, MCTS_NODES]
    digest = hashlib.sha256(repr(settings).encode())
    for array in (mesh.vertices_m.astype("<f8"), mesh.faces.astype("<i8")):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def _read(file: Path) -> tuple[Hull, ...] | None:
    """The hulls of a cache file; None if there is none or it is damaged (a zip has checksums)."""
    try:
        # NumPy leaves a file open that it opened itself and then could not read.
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            vertices, faces = data["vertices_m"], data["faces"]
            splits = data["vertex_split"], data["face_split"]
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        return None
    pieces = zip(np.split(vertices, splits[0]), np.split(faces, splits[1]), strict=True)
    return tuple(pieces)


def _write(file: Path, hulls: tuple[Hull, ...]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as aside:
        try:
            np.savez(
                aside,
                vertices_m=np.vstack([vertices for vertices, _ in hulls]),
                faces=np.vstack([faces for _, faces in hulls]),
                vertex_split=np.cumsum([len(vertices) for vertices, _ in hulls])[:-1],
                face_split=np.cumsum([len(faces) for _, faces in hulls])[:-1],
            )
        except BaseException:
            os.unlink(aside.name)
            raise
    os.replace(aside.name, file)
