"""Point-pair features: a table of a part's pairs of points, and votes from pairs in the scene.

The feature of two points with normals consists of their distance and three angles, which no rigid
motion changes. Each pair of a scene's reference point and another point votes for all model pairs
with the same feature: for their reference points, and for the rotation about the normal.

Source: B. Drost, M. Ulrich, N. Navab, S. Ilic, "Model globally, match locally: efficient and
robust 3D object recognition", CVPR 2010. If many model pairs have the same feature, each of their
votes has less weight. Otherwise, the many equal pairs on a plane would outweigh distinctive pairs.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int

from ...base.kernels import kernel
from .closest import OrientedPoints

ANGLES = 15  # number of bins of each angle of a feature, 12 degrees wide
TURNS = 30  # number of bins of the rotation about the normal, 12 degrees wide


class PairTable(NamedTuple):
    """The pairs of a model's points, sorted by feature.

    Attributes:
        step_m: bin width of the distance.
        distances: number of bins of the distance.
        start: index of each feature's first pair; the last entry is the number of pairs.
        first: index of each pair's reference point.
        turn_rad: the other point's angle about the reference point's normal.
    """

    step_m: float
    distances: int
    start: Int[np.ndarray, " features_and_end"]
    first: Int[np.ndarray, " pairs"]
    turn_rad: Float32[np.ndarray, " pairs"]


def pair_table(points: OrientedPoints, step_m: float) -> PairTable:
    """Return a table of all ordered pairs of a model's points."""
    longest = float(np.linalg.norm(np.ptp(points.point, axis=0)))
    distances = int(longest / step_m) + 1
    start, first, turn = _filled(*points, step_m, distances)
    return PairTable(step_m=step_m, distances=distances, start=start, first=first, turn_rad=turn)


@kernel(nogil=True, error_model="numpy")
def feature_of(p, n, q, m, step_m, distances):
    """Return the number of two points' feature; -1 if they coincide or are too far apart."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    d = int(length / step_m)
    if length < 0.5 * step_m or d >= distances:
        return -1
    first = (n[0] * dx + n[1] * dy + n[2] * dz) / length
    second = (m[0] * dx + m[1] * dy + m[2] * dz) / length
    between = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    number = d
    for cosine in (first, second, between):
        angle = math.acos(min(max(cosine, -1.0), 1.0))
        number = number * ANGLES + min(int(angle / math.pi * ANGLES), ANGLES - 1)
    return number


@kernel(nogil=True, error_model="numpy")
def frame_of(n):
    """Return the smallest rotation that maps a normal to the x axis."""
    R = np.empty((3, 3))
    x, y, z = n[0], n[1], n[2]
    if x < -0.999999:
        R[:] = 0.0
        R[0, 0], R[1, 1], R[2, 2] = -1.0, -1.0, 1.0
        return R
    k = 1 / (1 + x)
    R[0, 0], R[0, 1], R[0, 2] = x, y, z
    R[1, 0], R[1, 1], R[1, 2] = -y, 1 - k * y * y, -k * y * z
    R[2, 0], R[2, 1], R[2, 2] = -z, -k * y * z, 1 - k * z * z
    return R


@kernel(nogil=True, error_model="numpy")
def turn_of(R, p, q):
    """Return the angle of q about the x axis, after R has rotated p's normal to this axis."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    y = R[1, 0] * dx + R[1, 1] * dy + R[1, 2] * dz
    z = R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz
    return math.atan2(z, y)


@kernel(nogil=True, error_model="numpy")
def _filled(point, normal, step_m, distances):
    n = len(point)
    count = np.zeros(distances * ANGLES**3 + 1, np.int64)
    for i in range(n):
        for j in range(n):
            k = feature_of(point[i], normal[i], point[j], normal[j], step_m, distances)
            if i != j and k >= 0:
                count[k + 1] += 1
    start = np.cumsum(count)
    place = start[:-1].copy()
    first = np.empty(start[-1], np.int32)
    turn = np.empty(start[-1], np.float32)
    for i in range(n):
        R = frame_of(normal[i])
        for j in range(n):
            k = feature_of(point[i], normal[i], point[j], normal[j], step_m, distances)
            if i != j and k >= 0:
                first[place[k]] = i
                turn[place[k]] = turn_of(R, point[i], point[j])
                place[k] += 1
    return start, first, turn


@kernel(nogil=True, error_model="numpy")
def votes(scene, references, model, pairs, peaks):
    """Return the best poses for each reference point, and the weights of their votes.

    Args:
        references: indices of the reference points in the scene.
        peaks: number of poses for each reference point.
    """
    point, normal, start = scene.point, scene.normal, pairs.start
    n = len(model.point)
    T = np.zeros((len(references) * peaks, 4, 4))
    weight = np.zeros(len(references) * peaks)
    ballot = np.empty((n, TURNS), np.float32)
    for k in range(len(references)):
        i = references[k]
        ballot[:] = 0.0
        R = frame_of(normal[i])
        for j in range(len(point)):
            f = feature_of(point[i], normal[i], point[j], normal[j], pairs.step_m, pairs.distances)
            if i == j or f < 0 or start[f] == start[f + 1]:
                continue
            mine = turn_of(R, point[i], point[j])
            one = 1 / math.sqrt(start[f + 1] - start[f])
            for e in range(start[f], start[f + 1]):
                share = (mine - pairs.turn_rad[e]) / (2 * math.pi)
                share -= math.floor(share)
                ballot[pairs.first[e], min(int(share * TURNS), TURNS - 1)] += one
        for peak in range(peaks):
            at = np.argmax(ballot)
            m, t = at // TURNS, at % TURNS
            before, after = ballot[m, t - 1], ballot[m, (t + 1) % TURNS]
            weight[k * peaks + peak] = ballot[m, t] + 0.5 * (before + after)
            angle = (t + 0.5) / TURNS * 2 * math.pi
            R_model = frame_of(model.normal[m])
            _pose(T[k * peaks + peak], R, point[i], R_model, model.point[m], angle)
            ballot[m, t] = ballot[m, t - 1] = ballot[m, (t + 1) % TURNS] = 0.0
    return T, weight


@kernel(nogil=True, error_model="numpy")
def _pose(T, R_scene, p_scene, R_model, p_model, angle):
    """Fill T with the pose that maps a model's point and normal to the scene's, with a rotation."""
    c, s = math.cos(angle), math.sin(angle)
    turned = np.empty((3, 3))
    for j in range(3):
        turned[0, j] = R_model[0, j]
        turned[1, j] = c * R_model[1, j] - s * R_model[2, j]
        turned[2, j] = s * R_model[1, j] + c * R_model[2, j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                T[i, j] += R_scene[k, i] * turned[k, j]
        T[i, 3] = p_scene[i]
        for j in range(3):
            T[i, 3] -= T[i, j] * p_model[j]
    T[3, 3] = 1.0
