"""Small motions of rigid transforms: three angles [rad] and three lengths [m].

The motion (w, v) of `T` turns it to `R Exp(w)` and shifts it to `t + R v`, so both are in the frame
from which `T` maps.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....base.frames import inverse


def moved(
    T: Float[np.ndarray, "*n 4 4"], motion: Float[np.ndarray, "*n 6"]
) -> Float[np.ndarray, "*n 4 4"]:
    """Return transforms after one motion each."""
    step = np.zeros((*motion.shape[:-1], 4, 4))
    step[..., :3, :3] = Rotation.from_rotvec(motion[..., :3]).as_matrix()
    step[..., :3, 3], step[..., 3, 3] = motion[..., 3:], 1.0
    return T @ step


def motion_between(
    T_from: Float[np.ndarray, "n 4 4"], T_to: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n 6"]:
    """Return the motions that turn the first transforms into the second ones."""
    step = inverse(T_from) @ T_to
    return np.hstack([Rotation.from_matrix(step[:, :3, :3]).as_rotvec(), step[:, :3, 3]])


def motion_of_point(point_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 6"]:
    """Return the matrix that maps a small motion of a frame to the step [m] of a point in it."""
    return np.hstack([np.cross(np.eye(3), -point_m), np.eye(3)])


def adjoint(T_a_b: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 6 6"]:
    """Return the matrices that map small motions in frame b to the same motions in frame a."""
    R, t = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    matrix = np.zeros((*T_a_b.shape[:-2], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = R
    matrix[..., 3:, :3] = np.cross(t[..., None, :], R, axisa=-1, axisb=-2, axisc=-2)
    return matrix
