"""Convert masks to polygons along the borders of their pixels, without loss.

Pixel (0, 0) covers [0, 1] x [0, 1], as in COCO and YOLO: the origin is the image's corner, half a
pixel before the origin that the rest of this package uses.

Outlines are inset by a sixteenth of a pixel. Programs that count the pixels inside an outline
(pycocotools) still recover the same mask. Programs that truncate coordinates and also paint the
outline (OpenCV's `fillPoly`, hence Ultralytics) recover it, too; without the inset, they would make
a mask one pixel wider on the right and at the bottom. Programs that round coordinates, or scale
them first, still make it wider.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

_ALONG = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])  # The inside is on the right.


INSET_PX = 1 / 16  # A binary fraction below 0.1, since pycocotools rounds to fifths
_INWARD = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]])  # These are the directions' inward normals.


def rings(mask: Bool[np.ndarray, "h w"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Return the corners (x, y) of a mask's borders: outer borders clockwise, holes anticlockwise.

    The corners are moved inwards by `INSET_PX`. Pixels that share only a corner are separate.
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
    """Return the border sides of pixels: start (x, y), direction, and index of the next side.

    Where two pixels share only a corner, the border turns right, so that it stays at its own pixel.
    """
    height, width = mask.shape
    padded = np.pad(mask, 1)
    inside = padded[1:-1, 1:-1]
    outside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])  # Each side starts here.
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
    """Return one closed path around a mask; cuts, followed in both directions, join its pieces.

    A cut has no area, so a reader that counts crossings recovers the mask. A reader that also
    paints outlines (OpenCV's `fillPoly`) draws a cut between two pieces as a line of one pixel.
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
    """Return a path for each connected piece of a mask."""
    pieces, _ = ndimage.label(mask)
    paths = []
    for i, (rows, columns) in enumerate(ndimage.find_objects(pieces), start=1):
        offset = np.array([columns.start, rows.start])
        paths.append(path(pieces[rows, columns] == i) + offset)
    return paths
