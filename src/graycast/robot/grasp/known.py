"""Places where a suction cup holds a part whose mesh is known.

They are found once and carried to wherever the part lies by its pose.
"""

import numpy as np
from jaxtyping import Float

from ...world.parts import Mesh
from ...world.parts.sampling import spread_points
from .grip import Grip, downs, frame_on
from .patch import STEP_M, patch_of_mesh
from .robust import Burden, Doubt, patch_radius_m, robustness
from .suction import Cup


def suction_places(
    mesh: Mesh,
    cup: Cup,
    *,
    weight_n: float,
    center_m: Float[np.ndarray, "3"],
    doubt: Doubt,
    count: int = 200,
    seed: int = 0,
) -> list[Grip]:
    """Every place that is tried, also where a cup does not hold, in the order over the surface.

    A place's score is its robustness with the tool's axis upright and leaning by up to
    30 degrees to four sides, the least of the five: how the part will lie is not known yet.

    Args:
        mesh: of the part.
        cup: the tool.
        weight_n: of the part.
        center_m: its centre of mass.
        doubt: what is not known.
        count: places that are tried, evenly over the surface.
        seed: of the doubts.
    """
    points, normals = spread_points(mesh, count)
    places = []
    for point, normal in zip(points, normals, strict=True):
        T_part_tool = frame_on(point, normal)
        patch = patch_of_mesh(mesh, T_part_tool, radius_m=patch_radius_m(cup, doubt), step_m=STEP_M)
        center = T_part_tool[:3, :3].T @ (center_m - point)
        burdens = [Burden(weight_n=weight_n, center_m=center, down=down) for down in downs()]
        score = robustness(cup, patch, burdens, doubt, seed=seed)
        places.append(Grip(T_part_tool=T_part_tool, score=score))
    return places
