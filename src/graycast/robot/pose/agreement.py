"""Compare a pose with the measured depth, by pixels that agree or contradict."""

import numpy as np

from ...base.kernels import kernel
from .drawing import draw

VISIBLE, TOUCHING, HIDDEN, CONTRADICTED, UNKNOWN, MISSED, MISSED_UNKNOWN = range(7)
KINDS = 7
# Kinds of pixels. All but the last two count pixels that the part at its pose would cover.
# VISIBLE: the measured point is on the part's surface.
# TOUCHING: as VISIBLE, but outside the detection's outline.
# HIDDEN: the measured point is in front of the part.
# CONTRADICTED: the measured point is behind the part, so the ray went through the part.
# UNKNOWN: nothing is measured.
# MISSED: a point is measured within the outline, where the part at its pose would not be.
# MISSED_UNKNOWN: as MISSED, but nothing is measured.


# In a box, a visible pixel counts +1, and a contradicted pixel -1. The other weights were chosen
# on brackets in heaps. Likely mistakes are the pose of a neighbour, and a pose sunk into the floor.
# For the latter, the surface continues around the part, and the true part hides the posed part.
OUTSIDE = 0.3  # weight of a pixel that agrees, but is outside the box
HIDING = 1.0  # cost of a hidden pixel
GOING_ON = 3.0  # cost of a pixel next to the part where the part's surface continues
OFF_CENTRE = 0.3  # cost of a part centred on the box's border, as a share of the box's pixels


@kernel(nogil=True, error_model="numpy")
def count(depth, z, inside, tolerance_m):
    """Return the pixels of each kind, and left, top, right, bottom of those that are not HIDDEN."""
    number = np.zeros(KINDS, np.int64)
    h, w = z.shape
    edge = np.array([w, h, -1, -1])
    for i in range(h):
        for j in range(w):
            covered, known = depth[i, j] < np.inf, z[i, j] > 0
            if not covered:
                if inside[i, j]:
                    number[MISSED if known else MISSED_UNKNOWN] += 1
                continue
            off = z[i, j] - depth[i, j]
            if not known:
                kind = UNKNOWN
            elif abs(off) <= tolerance_m:
                kind = VISIBLE if inside[i, j] else TOUCHING
            else:
                kind = HIDDEN if off < 0 else CONTRADICTED
            number[kind] += 1
            if kind != HIDDEN:
                edge[0], edge[1] = min(edge[0], j), min(edge[1], i)
                edge[2], edge[3] = max(edge[2], j), max(edge[3], i)
    return number, edge


@kernel(nogil=True, error_model="numpy")
def misfits(depth, z, inside, tolerance_m):
    """Return the number of pixels in an outline that are measured clearly in front of the part."""
    number = 0
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            if inside[i, j] and depth[i, j] < np.inf and depth[i, j] - z[i, j] > tolerance_m:
                number += 1
    return number


@kernel(nogil=True, error_model="numpy")
def tight_score(number, misfit):
    """Return the share of pixels that agree, among those in the outline or on the posed part.

    Hidden pixels outside the outline and unknown pixels do not count. Within the outline, surfaces
    in front of the part (`misfit`) contradict the pose.
    """
    against = number[TOUCHING] + number[CONTRADICTED] + misfit
    against += number[MISSED] + number[MISSED_UNKNOWN]
    return number[VISIBLE] / max(number[VISIBLE] + against, 1)


@kernel(nogil=True, error_model="numpy")
def loose_score(number, edge, box, going_on):
    """Return the weighted number of agreeing minus contradicting pixels, per pixel of the box.

    A box contains other objects, too, so pixels that the part does not cover do not count.
    """
    wide, high = box[2] - box[0] + 1, box[3] - box[1] + 1
    worth = number[VISIBLE] + OUTSIDE * number[TOUCHING] - number[CONTRADICTED]
    worth -= HIDING * number[HIDDEN] + GOING_ON * going_on
    x = (edge[0] + edge[2] - box[0] - box[2]) / wide
    y = (edge[1] + edge[3] - box[1] - box[3]) / high
    return worth / (wide * high) - OFF_CENTRE * (x * x + y * y)


@kernel(nogil=True, error_model="numpy")
def going_on(depth, z, tolerance_m):
    """Return the number of pixels next to the part at which the measured surface continues it."""
    number = 0
    h, w = z.shape
    for i in range(2, h - 2):
        for j in range(2, w - 2):
            if depth[i, j] < np.inf:
                continue
            for di, dj in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                near, far = depth[i + di, j + dj], depth[i + 2 * di, j + 2 * dj]
                if not near < np.inf:
                    continue
                slope = near - far if far < np.inf else 0.0
                if abs(z[i, j] - near - slope) <= tolerance_m:
                    number += 1
                    break
    return number


@kernel(nogil=True, error_model="numpy")
def score(T, part, window, box, tolerance_m, canvas):
    """Return a pose's score, which is at most 1, and the pixel counts behind this score."""
    draw(T, part, window, canvas)
    depth, z, inside = canvas.depth, window.z, window.inside
    number, edge = count(depth, z, inside, tolerance_m)
    if window.tight:
        return tight_score(number, misfits(depth, z, inside, tolerance_m)), number
    return loose_score(number, edge, box, going_on(depth, z, tolerance_m)), number
