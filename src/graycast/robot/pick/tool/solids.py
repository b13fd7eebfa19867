"""Triangle meshes of Coal shapes, for robots, tools and obstacles."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from ....base.errors import ConfigError
from ....base.frames import transform_points
from ....world.parts import Mesh

ROUND = 24  # number of sides in the mesh of a round shape


def shape_mesh(shape: Any) -> Mesh:
    """Return the surface of a robot's or tool's shape, in the shape's frame.

    Raises:
        ConfigError: the kind of the shape is not supported; URDF files do not produce it.
    """
    import coal
    from trimesh import creation

    match shape:
        case coal.Sphere():
            mesh = creation.uv_sphere(shape.radius, count=[ROUND // 2, ROUND])
        case coal.Cylinder():
            mesh = creation.cylinder(shape.radius, 2 * shape.halfLength, sections=ROUND)
        case coal.Box():
            mesh = creation.box(2 * np.asarray(shape.halfSide))
        case coal.BVHModelBase():
            return _listed(
                [shape.vertex(i) for i in range(shape.num_vertices)],
                [shape.tri_indices(i) for i in range(shape.num_tris)],
            )
        case _:
            raise ConfigError(
                f"a {type(shape).__name__} cannot be drawn: make the robot of spheres, cylinders, "
                "boxes and meshes"
            )
    return Mesh(vertices_m=np.array(mesh.vertices), faces=np.array(mesh.faces, dtype=np.int64))


def joined(pieces: Iterable[tuple[Mesh, Float[np.ndarray, "4 4"]]]) -> Mesh:
    """Join meshes at their poses into one mesh."""
    vertices, faces, count = [], [], 0
    for mesh, T in pieces:
        vertices.append(transform_points(T, mesh.vertices_m.astype(np.float64)))
        faces.append(mesh.faces.astype(np.int64) + count)
        count += len(mesh.vertices_m)
    return Mesh(vertices_m=np.concatenate(vertices), faces=np.concatenate(faces))


def _listed(points: list[Any], triangles: list[Any]) -> Mesh:
    faces = np.array([[triangle[k] for k in range(3)] for triangle in triangles], dtype=np.int64)
    return Mesh(vertices_m=np.array([np.asarray(point).ravel() for point in points]), faces=faces)
