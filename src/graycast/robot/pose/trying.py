"""Render, score and align the candidate poses of one detection."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ...camera.crop import Crop
from .agreement import score
from .aligning import align
from .drawing import Canvas, Window, draw, lens
from .model import PoseModel

TOLERANCE = 0.02  # tolerance of a measurement, as a share of the diameter
TOLERANCE_SIGMAS = 3.5  # tolerance as a multiple of the noise, if that is larger
# Gates of successive alignment steps, in tolerances. The first gate covers the error that ICP may
# leave. The last gate is 1.5 times the limit for a visible pixel.
GATES = (6.0, 5.0, 4.0, 3.0, 2.0, 2.0, 1.5, 1.5)
EDGE = 3.0  # At a part's outline, depth increases by more than this many tolerances.
LEAST_PIXELS = 30  # minimum number of measured pixels on the part in another orientation


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseTrial:
    """A pose, its score (at most 1), and its number of pixels of each kind (see `agreement`)."""

    T: Float[np.ndarray, "4 4"]
    worth: float
    number: Int[np.ndarray, " kinds"]


@final
class Trials:
    """Trials of poses of a part in the window of one detection."""

    def __init__(self, model: PoseModel, crop: Crop) -> None:
        noise_m = crop.noise_m if np.isfinite(crop.noise_m) else 0.0
        self.tolerance_m = max(TOLERANCE * model.diameter_m, TOLERANCE_SIGMAS * noise_m)
        self._part = model.facets
        self._window = Window(
            lens=lens(crop.camera),
            ray=crop.ray,
            left_px=crop.left_px,
            top_px=crop.top_px,
            z=crop.z,
            inside=crop.inside,
            tight=crop.tight,
        )
        self._canvas = Canvas(depth=np.empty(crop.z.shape), face=np.empty(crop.z.shape, np.int64))
        i, j = np.nonzero(crop.inside)
        self._middle = np.array([j.mean(), i.mean()])
        self._box = np.array([j.min(), i.min(), j.max(), i.max()])

    def judge(self, T: Float[np.ndarray, "4 4"]) -> PoseTrial:
        worth, number = score(
            T, self._part, self._window, self._box, self.tolerance_m, self._canvas
        )
        return PoseTrial(T=T, worth=float(worth), number=number)

    def align(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Return the pose after moving it so that surface and outline fit the measurement."""
        moved, gates_m = T.copy(), np.array(GATES) * self.tolerance_m
        align(moved, self._part, self._window, gates_m, EDGE * self.tolerance_m, self._canvas)
        return moved

    def placed(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
        """Return the pose at the detection's position and depth; None if too few pixels fit.

        The shift is repeated once, because a shift along the ray changes which pixels are covered.
        """
        window, depth, moved = self._window, self._canvas.depth, T.copy()
        for _ in range(2):
            draw(moved, self._part, window, self._canvas)
            covered = np.isfinite(depth)
            off_m = (window.z - depth)[window.inside & covered & np.isfinite(window.z)]
            if len(off_m) < LEAST_PIXELS:
                return None
            hidden = (window.z < depth - self.tolerance_m) & ~window.inside
            i, j = np.nonzero(covered & ~hidden)
            if window.tight:
                off_px = self._middle - [j.mean(), i.mean()]
            else:
                corners = np.array([j.min(), i.min(), j.max(), i.max()])
                off_px = (self._box - corners).reshape(2, 2).mean(axis=0)
            moved[:3, 3] += moved[:3, 3] / moved[2, 3] * np.median(off_m)
            moved[:2, 3] += off_px * moved[2, 3] / window.lens[:2]
        return moved
