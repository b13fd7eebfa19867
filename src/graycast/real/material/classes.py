"""Division of a scan without masks into classes, each of which is one material.

Neighbouring pixels on a surface without a step or a crease form a piece, and a piece has one
material. The pieces follow a mixture of at most MOST_CLASSES materials. The materials are taken
from a grid of kind, roughness, base colour and scatter by expectation maximisation, with the
likelihood of the fit, and their number by the Bayesian information criterion.

Leaves out: several materials on one smooth surface, such as a print.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from ...base.errors import GraycastError
from .fitting import BRIGHTEST, COARSE, DARKEST, FEWEST
from .observing import Reflections
from .surface_model import KINDS, SurfaceModel

MOST_CLASSES = 3
LEAST_PIXELS = 12  # Smaller pieces are mostly pixels at edges, and belong to no class.
MOST_PIXELS = 3000  # More pixels do not change the division, because they share normals.
LEAST_SHARE = 0.02  # Of the windows; a smaller class is light that is reflected repeatedly.
CREASE_COSINE = math.cos(0.2)  # Normals of neighbours on one piece differ by a smaller angle.
STEP = 0.3  # A larger slope of the line between neighbours against their surface is a step.
COLOR_RATIO, SCATTERS = 1.11, (0.05, 0.12, 0.3)  # Of the candidates
PARAMETERS = 4  # Of a class: roughness, base colour, scatter and share.
ROUNDS = 50
# Without a reference, the median pixel as a matt one has each of these reflectances in turn.
USUAL = (0.8, 0.25, 0.08, 0.025)


@dataclass(frozen=True, slots=True, kw_only=True)
class Division:
    """The class of each observation, from 0, the most frequent; -1 without one."""

    label: Int[np.ndarray, " n"]
    count: int

    def members(self, number: int) -> Bool[np.ndarray, " n"]:
        return self.label == number

    def most(self, inside: Bool[np.ndarray, " n"]) -> int | None:
        """Return the class with the most observations inside a mask; None if none is inside."""
        own = self.label[inside & (self.label >= 0)]
        return int(np.bincount(own).argmax()) if len(own) else None

    def share(self, number: int) -> float:
        """Return the class's share of the observations that have a class."""
        return float(self.members(number).sum() / max((self.label >= 0).sum(), 1))


def divide(observations: Reflections, *, scale: float | None = None, seed: int) -> Division:
    """Divide observations into classes of one material each.

    Args:
        scale: see `MaterialFit.scale`; None tries several, and takes the best division.
        seed: seed for the choice of pixels.

    Raises:
        GraycastError: the pixels are too few.
    """
    piece = smooth_pieces(observations)
    size = np.bincount(piece)
    number = np.cumsum(size >= LEAST_PIXELS) - 1
    piece = np.where(size[piece] >= LEAST_PIXELS, number[piece], -1)
    if (piece >= 0).sum() < FEWEST:
        raise GraycastError(
            f"only {(piece >= 0).sum()} pixels are on smooth surfaces, and a division needs "
            f"{FEWEST}: take a longer exposure, or mark the surface with a mask"
        )
    if scale is not None:
        scales = [scale]
    else:
        matt = observations.light / observations.light_cosine
        scales = [float(np.median(matt[piece >= 0])) * math.pi / usual for usual in USUAL]
    subset = _subset(observations, piece, np.random.default_rng(seed))
    best = max((_mixture(subset.scores(one), subset.windows) for one in scales), key=_criterion)
    label = np.append(best[1], -1)[piece]  # Index -1 is the last element.
    return Division(label=label, count=int(label.max()) + 1)


def _criterion(mixture: tuple[float, Int[np.ndarray, " pieces"]]) -> float:
    return mixture[0]


def smooth_pieces(observations: Reflections) -> Int[np.ndarray, " n"]:
    """Return the number of each pixel's piece, the connected pixels without a step or a crease."""
    own, count = observations, len(observations)
    top, left = own.pixel.min(axis=0, initial=0)
    rows, columns = own.pixel.max(axis=0, initial=0) - (top, left) + 1
    index = np.full((rows + 1, columns + 1), -1)
    index[own.pixel[:, 0] - top, own.pixel[:, 1] - left] = np.arange(count)
    first, second = np.concatenate(
        [
            np.stack([index[:-1].ravel(), index[1:].ravel()]),
            np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()]),
        ],
        axis=1,
    )
    both = (first >= 0) & (second >= 0)
    first, second = first[both], second[both]
    line = own.point_m[second] - own.point_m[first]
    length = np.linalg.norm(line, axis=-1)
    keep = (own.normal[first] * own.normal[second]).sum(axis=-1) > CREASE_COSINE
    for side in (first, second):
        keep &= np.abs((own.normal[side] * line).sum(axis=-1)) < STEP * length
    links = coo_array((np.ones(keep.sum()), (first[keep], second[keep])), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Subset:
    """Some pixels of each piece; `weight` makes their number that of the piece's windows."""

    model: SurfaceModel
    place: Int[np.ndarray, " m"]  # Index of each pixel's piece
    weight: Float[np.ndarray, " m"]
    windows: Float[np.ndarray, " pieces"]

    def scores(self, scale: float) -> Float[np.ndarray, "candidates pieces"]:
        """Return each piece's log likelihood under each candidate."""
        rows = []
        for kind, roughness in product(KINDS, COARSE):
            nodes = self.model.nodes(kind, roughness)
            steps = 1 + int(math.log(1 / DARKEST[kind]) / math.log(COLOR_RATIO))
            colors = np.geomspace(DARKEST[kind], BRIGHTEST, steps)
            for color, scatter in product(colors, SCATTERS):
                density = self.model.densities(nodes, float(color), scale, scatter)
                rows.append(np.bincount(self.place, self.weight * density, len(self.windows)))
        return np.array(rows)


def _subset(
    observations: Reflections, piece: Int[np.ndarray, " n"], rng: np.random.Generator
) -> _Subset:
    pieces = int(piece.max()) + 1
    windows = np.bincount(piece[piece >= 0], 1 / observations.area_px[piece >= 0], pieces)
    order = rng.permutation(np.flatnonzero(piece >= 0))
    order = order[np.argsort(piece[order], kind="stable")]
    start = np.searchsorted(piece[order], np.arange(pieces))
    rank = np.arange(len(order)) - start[piece[order]]
    index = order[rank < max(LEAST_PIXELS, MOST_PIXELS // pieces)]
    place = piece[index]
    return _Subset(
        model=SurfaceModel(observations.part(index), None, 1.0),
        place=place,
        weight=(windows / np.bincount(place, minlength=pieces))[place],
        windows=windows,
    )


def _mixture(
    score: Float[np.ndarray, "candidates pieces"], windows: Float[np.ndarray, " pieces"]
) -> tuple[float, Int[np.ndarray, " pieces"]]:
    """Return the best Bayesian information criterion, and each piece's class in that mixture."""
    best, label = -math.inf, np.zeros(score.shape[1], dtype=np.int64)
    candidates: list[int] = []
    for count in range(1, MOST_CLASSES + 1):
        base = (
            logsumexp(score[candidates], axis=0) if candidates else np.full(score.shape[1], -np.inf)
        )
        candidates = [*candidates, int(np.logaddexp(base, score).sum(axis=1).argmax())]
        likelihood, candidates, own = _expectation_maximisation(score, candidates, windows)
        size = np.bincount(own, windows, count)
        criterion = likelihood - 0.5 * (PARAMETERS * count - 1) * math.log(windows.sum())
        if criterion <= best or size.min() < LEAST_SHARE * windows.sum():
            break
        best, label = criterion, np.argsort(np.argsort(-size))[own]
    return best, label


def _expectation_maximisation(
    score: Float[np.ndarray, "candidates pieces"],
    candidates: Sequence[int],
    windows: Float[np.ndarray, " pieces"],
) -> tuple[float, list[int], Int[np.ndarray, " pieces"]]:
    """Return the log likelihood of a mixture, its candidates, and the class of each piece."""
    share = np.full(len(candidates), 1 / len(candidates))
    now = list(candidates)
    for _ in range(ROUNDS):
        joint = score[now] + np.log(share)[:, None]
        part = np.exp(joint - logsumexp(joint, axis=0))
        share = np.maximum(part @ windows / windows.sum(), 1e-6)
        following = (score @ part.T).argmax(axis=0).tolist()
        if following == now:
            break
        now = following
    joint = score[now] + np.log(share)[:, None]
    return float(logsumexp(joint, axis=0).sum()), now, joint.argmax(axis=0)
