"""Number, accuracy and computing time of the convex hulls of the zoo and of large meshes."""

import time

import numpy as np

from ..drop.decomposition import decompose, hull_error, tolerance_m
from ..parts import Mesh
from ..parts.shapes import revolve
from .figures import Figures
from .work import OnWork
from .zoo_parts import ZOO, zoo_part

DENSE_FACES = (80_000, 330_000, 500_000)


def measure_hulls(on_work: OnWork = lambda share, what: None) -> Figures:
    """The convex hulls of every part of the zoo, and of a smooth ring of ever more faces."""
    jobs = {name: zoo_part(name).mesh for name in ZOO}
    jobs |= {f"ring of {faces} faces": wavy_ring(faces) for faces in DENSE_FACES}
    rows = []
    for done, (name, mesh) in enumerate(jobs.items()):
        on_work(done / len(jobs), name)
        rows.append({"part": name} | _hulls_of(mesh))
    return {"hulls": rows}


def wavy_ring(faces: int) -> Mesh:
    """A smooth ring of about so many faces, 56 mm wide, whose surface waves by 1 mm."""
    turn = np.linspace(0, 2 * np.pi, int(np.sqrt(faces / 3.4)), endpoint=False)
    section_m = np.stack([0.02 + 0.008 * np.cos(turn), 0.008 * np.sin(turn)], axis=1)
    vertices_m, triangles = revolve(section_m, int(1.7 * len(turn)))
    waves = 1 + 0.02 * np.sin(400 * vertices_m[:, [1, 2, 0]])
    return Mesh(vertices_m=vertices_m * waves, faces=triangles)


def _hulls_of(mesh: Mesh) -> Figures:
    start, worked = time.perf_counter(), time.process_time()
    hulls = decompose(mesh)
    ended, rested = time.perf_counter(), time.process_time()
    error = hull_error(mesh, hulls)
    return {
        "faces": len(mesh.faces),
        "hulls": len(hulls),
        "vertices": sum(len(vertices) for vertices, _ in hulls),
        "filled_mm": 1e3 * error.filled_m,
        "lost_mm": 1e3 * error.lost_m,
        "tolerance_mm": 1e3 * tolerance_m(mesh),
        "seconds": ended - start,
        "processor_s": rested - worked,
    }
