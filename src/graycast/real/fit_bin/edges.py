"""Degrees of freedom that no wall determines, fitted to edges in the depth map.

Walls that are lost, in shadow or hardly seen leave the place along an axis, or the turn about z,
free. Edges of the rim and the floor hold them still, to a part of a pixel: a pose that is shifted
predicts the rim where depth saw past it, and past the rim where depth saw it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...base.frames import axis_rotation, rigid
from .bin_views import BinView
from .shape import BinShape

SEARCHED = ("x", "y", "about z")
_FIRST_M, _LAST_M = 4e-3, 0.05e-3
_LEVER_M = 0.2  # A turn is as large a step as a shift of a point so far away.
_ACROSS_PX = 512
_LEAST_TOLERANCE_M = 0.003
_TRY_M, _LEAST_VOTES = 2e-3, 25.0  # A shift by the first must cost as many pixels as the second.


def hold_by_edges(
    views: Sequence[BinView],
    shape: BinShape,
    T_world_cam: Float[np.ndarray, "4 4"],
    loose: Sequence[str],
    noise_m: float,
) -> tuple[Float[np.ndarray, "4 4"], tuple[str, ...]]:
    """The pose moved along some of `SEARCHED` to the most evidence, and those it is held in.

    A pattern search: evidence counts pixels, so it has no derivative.

    Args:
        loose: the degrees of freedom to find; others than `SEARCHED` are left alone.
        noise_m: RMS of the residuals.
    """
    free = [name for name in SEARCHED if name in loose]
    if not free:
        return T_world_cam, ()
    grids = [view.grid(_ACROSS_PX) for view in views]
    tolerance_m = max(_LEAST_TOLERANCE_M, 4 * noise_m)

    def votes(poses: list[np.ndarray]) -> Float[np.ndarray, " p"]:
        each = (shape.votes(np.stack(poses), grid, tolerance_m) for grid in grids)
        return sum(each, start=np.zeros(len(poses)))

    best, step_m = T_world_cam, _FIRST_M
    most = votes([best])[0]
    while step_m > _LAST_M:
        tried = [_moved(best, name, s * step_m) for name in free for s in (1, -1)]
        score = votes(tried)
        if score.max() > most:
            best, most = tried[int(score.argmax())], score.max()
        else:
            step_m /= 2
    beside = votes([_moved(best, name, s * _TRY_M) for name in free for s in (1, -1)])
    cost = most - beside.reshape(len(free), 2).max(axis=1)
    determined = tuple(name for name, lost in zip(free, cost, strict=True) if lost >= _LEAST_VOTES)
    return best, determined


def _moved(
    T_world_cam: Float[np.ndarray, "4 4"], name: str, step_m: float
) -> Float[np.ndarray, "4 4"]:
    if name == "about z":
        return rigid(axis_rotation("z", step_m / _LEVER_M), np.zeros(3)) @ T_world_cam
    return rigid(np.eye(3), step_m * np.eye(3)["xy".index(name)]) @ T_world_cam
