"""Masks as polygons along the borders of their pixels, without loss.

Pixel (0, 0) covers [0, 1] x [0, 1], as in COCO and YOLO: coordinates count from the image's corner,
half a pixel before those of the rest of this package.

Outlines lie a sixteenth of a pixel inside the borders. Programs that count what lies inside
(pycocotools) read the same mask from there. Those that cut coordinates to whole numbers and paint
the outline with the rest (OpenCV's `fillPoly`, so Ultralytics) would else make a mask a pixel wider
on its right and lower side, half of a part of 2 x 2 pixels: now they, too, paint the pixels of the
mask. What rounds instead of cutting, or scales before, is still wider.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

_ALONG = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # The inside is on the right of each border.


INSET_PX = 1 / 16  # It is a binary fraction up to 0.1, as pycocotools rounds fifths of a pixel.
_INWARD = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]])  # Each points inwards from such a border.


def rings(mask: Bool[np.ndarray, "h w"]) -> list[Float[np.ndarray, "_ 2"]]:
    """The corners (x, y) of every border of a mask: clockwise on the screen, holes the other way.

    They lie inside the mask by `INSET_PX`. Pixels that touch at a corner only are apart.
    """
    start, direction, following = _edges(mask)
    turns = direction != direction[following]
    after, following = following, following.tolist()
    visited, corners = [False] * len(start), []
    for first in range(len(start)):
        ring, edge = [], first
        while not visited[edge]:
            visited[edge] = True
            ring.append(edge)
            edge = following[edge]
        if ring:
            edges = np.array(ring)
            corner = edges[turns[edges]]
            first_side, second = direction[corner], direction[after[corner]]
            inward = _INWARD[first_side] + _INWARD[second]
            corners.append(start[corner] + _ALONG[first_side] + INSET_PX * inward)
    return corners


def _edges(
    mask: Bool[np.ndarray, "h w"],
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
    """Sides of pixels that border the outside: start (x, y), direction, and the edge that follows.

    At a corner where two pixels touch, the border stays with its own pixel: it turns right.
    """
    height, width = mask.shape
    padded = np.pad(mask, 1)
    inside = padded[1:-1, 1:-1]
    outside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # where the pixel's side begins
    starts, directions = [], []
    for side, beyond in enumerate(outside):
        y, x = np.nonzero(inside & ~beyond)
        starts.append(np.stack([x, y], axis=1) + corner[side])
        directions.append(np.full(len(x), side))
    start, direction = np.concatenate(starts), np.concatenate(directions)
    table = np.full((4, height + 1, width + 1), -1)
    table[direction, start[:, 1], start[:, 0]] = np.arange(len(start))
    end = start + _ALONG[direction]
    following = np.full(len(start), -1)
    for turn in (1, 0, 3):
        choice = table[(direction + turn) % 4, end[:, 1], end[:, 0]]
        following = np.where(following < 0, choice, following)
    return start, direction, following


def path(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "_ 2"]:
    """One closed path around a mask, its pieces and holes joined by cuts that are walked twice.

    A cut has no area, so a reader that counts crossings gets the mask back; a reader that paints
    outlines (OpenCV's `fillPoly`) sees it as a line of one pixel, which matters between pieces.
    """
    around = sorted(rings(mask), key=len, reverse=True)
    joined = around[0]
    for ring in around[1:]:
        apart = np.square(joined[:, None] - ring[None]).sum(axis=-1)
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        turned = np.roll(ring, -j, axis=0)
        joined = np.concatenate([joined[: i + 1], turned, turned[:1], joined[i:]])
    return joined


def polygons(mask: Bool[np.ndarray, "h w"]) -> list[Float[np.ndarray, "_ 2"]]:
    """A path for each connected piece of a mask."""
    pieces, _ = ndimage.label(mask)
    paths = []
    for i, (rows, columns) in enumerate(ndimage.find_objects(pieces), start=1):
        offset = np.array([columns.start, rows.start])
        paths.append(path(pieces[rows, columns] == i) + offset)
    return paths
