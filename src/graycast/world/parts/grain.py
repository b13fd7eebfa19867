"""The direction of brushed or turned grooves at each corner of a mesh."""

import numpy as np
from jaxtyping import Float

from .part import Grain, Mesh

ACROSS = np.cos(np.radians(20))  # A face whose normal is nearer to the grain has another one.


def corner_grain(mesh: Mesh, grain: Grain) -> Float[np.ndarray, "f 3 3"]:
    """A direction for each face corner, of any length, to be projected onto the surface.

    Directions of a turned part are `axis x (corner - point)`: linear, so between the corners of a
    face they are right, too. Faces nearly across the grain have another direction: ends of a
    brushed part the axis x, y or z that lies furthest from the grain, and radial faces of a
    turned part its axis.
    """
    axis = np.array(grain.axis) / np.linalg.norm(grain.axis)
    corner_m = mesh.vertices_m[mesh.faces]
    if grain.turned:
        along, other = np.cross(axis, corner_m - grain.point_m), axis
    else:
        along, other = np.broadcast_to(axis, corner_m.shape), np.eye(3)[np.argmin(np.abs(axis))]
    middle = along.mean(axis=1)
    out = np.abs(np.einsum("fi,fi->f", middle, mesh.face_normal))
    is_end = out > ACROSS * np.linalg.norm(middle, axis=1)
    return np.where(is_end[:, None, None], other, along)
