"""The obstacles of the arm as shapes of Coal: bin, table, rig, and the measured heap."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.frames import rigid
from ...world.parts import Mesh
from ...world.scene import TABLE_HALF_M, Scene, bin_mesh, bin_of
from .heap_obstacle import BELOW_M, CELL_M, MeasuredHeap
from .robot import Obstacle

RIG_M = 0.06  # The box around camera, projector and what joins them is twice as thick as this.


def standing(scene: Scene, T_base_world: Float[np.ndarray, "4 4"]) -> tuple[Obstacle, ...]:
    """The table, which carries the robot, the bin, and a box about the rig."""
    import coal

    box = bin_of(scene)
    table = rigid(np.eye(3), np.array([0.0, 0.0, -box.floor_m - BELOW_M / 2]))
    half = scene.rig.T_cam_proj[:3, 3] / 2
    low, high = np.minimum(half, -half) - RIG_M, np.maximum(half, -half) + RIG_M
    rig = scene.T_world_cam @ rigid(np.eye(3), half)
    return (
        Obstacle(
            name="the table",
            shape=coal.Box(2 * TABLE_HALF_M, 2 * TABLE_HALF_M, BELOW_M),
            T_base_shape=T_base_world @ table,
            carries=True,
        ),
        Obstacle(name="the bin", shape=triangles(bin_mesh(box)), T_base_shape=T_base_world),
        Obstacle(
            name="the rig",
            shape=coal.Box(*(high - low).tolist()),
            T_base_shape=T_base_world @ rig,
        ),
    )


def heap_obstacle(heap: MeasuredHeap, T_base_world: Float[np.ndarray, "4 4"]) -> Obstacle:
    """Solid from `BELOW_M` under the floor up to the measured heights."""
    import coal

    rows, columns = heap.height_m.shape
    # Coal's rows run from the far side of y to the near one.
    field = coal.HeightFieldOBBRSS(
        (columns - 1) * CELL_M, (rows - 1) * CELL_M, np.ascontiguousarray(heap.height_m[::-1]),
        -BELOW_M,
    )  # fmt: skip
    return Obstacle(name="the heap", shape=field, T_base_shape=T_base_world)


def triangles(mesh: Mesh) -> Any:
    """A mesh's surface; what is wholly inside touches nothing."""
    import coal

    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices_m))
    vertices = coal.StdVec_Vec3s()
    for vertex in mesh.vertices_m.astype(np.float64):
        vertices.append(vertex)
    faces = coal.StdVec_Triangle()
    for a, b, c in mesh.faces.tolist():
        faces.append(coal.Triangle(a, b, c))
    model.addSubModel(vertices, faces)
    model.endModel()
    return model


def hull(vertices_m: Float[np.ndarray, "v 3"]) -> Any:
    """The convex hull of points."""
    import coal

    points = coal.StdVec_Vec3s()
    for vertex in vertices_m.astype(np.float64):
        points.append(vertex)
    return coal.Convex.convexHull(points, False, "")
