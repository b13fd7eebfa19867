"""Drawing, scoring and alignment of the candidate poses of one detection."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from ...camera.crop import Crop
from .agreement import score
from .aligning import align
from .drawing import draw, lens
from .model import PoseModel

TOLERANCE = 0.02  # A measurement may be off the part by this share of the diameter.
TOLERANCE_SIGMAS = 3.5  # It may be off by this many times the noise, if that is more.
# A pixel's depth pulls at the pose within so many tolerances, step by step. The first gate reaches
# as far as ICP may have left the pose. The last is one and a half times what counts as visible.
GATES = (6.0, 5.0, 4.0, 3.0, 2.0, 2.0, 1.5, 1.5)
EDGE = 3.0  # At a part's outline, the depth falls back by more than this many tolerances.
OUTLINE_WEIGHT = 1.0  # A pixel of the outline has this weight against one of the surface.
LEAST_PIXELS = 30  # A part that is put otherwise is placed on at least this many pixels.


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseTrial:
    """A pose, its score (at most 1), and its pixels by kind (`checking`)."""

    T: Float[np.ndarray, "4 4"]
    worth: float
    number: Int[np.ndarray, " kinds"]

    def better_of(self, other: "PoseTrial") -> "PoseTrial":
        return self if self.worth > other.worth else other


@final
class Trials:
    """Poses of a part tried in one detection's window."""

    def __init__(self, model: PoseModel, crop: Crop) -> None:
        noise_m = crop.noise_m if np.isfinite(crop.noise_m) else 0.0
        self.tolerance_m = max(TOLERANCE * model.diameter_m, TOLERANCE_SIGMAS * noise_m)
        self._model, self._crop = model, crop
        self._lens = lens(crop.camera)
        self._drawn = np.empty(crop.z.shape)
        self._face = np.empty(crop.z.shape, np.int64)
        i, j = np.nonzero(crop.inside)
        self._middle = np.array([j.mean(), i.mean()])
        self._box = np.array([j.min(), i.min(), j.max(), i.max()])

    def judge(self, T: Float[np.ndarray, "4 4"]) -> PoseTrial:
        model, crop = self._model, self._crop
        worth, number = score(
            T, model.vertices_m, model.faces, self._lens, crop.ray, crop.left_px, crop.top_px,
            crop.z, crop.inside, crop.tight, self._box, self.tolerance_m, self._drawn, self._face,
        )  # fmt: skip
        return PoseTrial(T=T, worth=float(worth), number=number)

    def align(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The pose moved so that surface and outline lie on what is measured."""
        model, crop, moved = self._model, self._crop, T.copy()
        align(
            moved, model.vertices_m, model.faces, model.face_normal, self._lens, crop.ray,
            crop.left_px, crop.top_px, crop.z, crop.inside, crop.tight,
            np.array(GATES) * self.tolerance_m, EDGE * self.tolerance_m, OUTLINE_WEIGHT,
            self._drawn, self._face,
        )  # fmt: skip
        return moved

    def placed(self, T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
        """The pose shifted to the detection's place and depth; None if it covers too little.

        Twice: a shift along the ray changes what is covered.
        """
        crop, moved = self._crop, T.copy()
        for _ in range(2):
            draw(
                moved, self._model.vertices_m, self._model.faces, self._lens, crop.ray,
                crop.left_px, crop.top_px, self._drawn, self._face,
            )  # fmt: skip
            covered = np.isfinite(self._drawn)
            off_m = (crop.z - self._drawn)[crop.inside & covered & np.isfinite(crop.z)]
            if len(off_m) < LEAST_PIXELS:
                return None
            hidden = (crop.z < self._drawn - self.tolerance_m) & ~crop.inside
            i, j = np.nonzero(covered & ~hidden)
            if crop.tight:
                off_px = self._middle - [j.mean(), i.mean()]
            else:
                corners = np.array([j.min(), i.min(), j.max(), i.max()])
                off_px = (self._box - corners).reshape(2, 2).mean(axis=0)
            moved[:3, 3] += moved[:3, 3] / moved[2, 3] * np.median(off_m)
            moved[:2, 3] += off_px * moved[2, 3] / self._lens[:2]
        return moved
