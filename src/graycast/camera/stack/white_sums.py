"""Groups of frames that add up to the same white picture, and its motion during the stack.

A pattern and its inverse add up to a picture of the scene without stripes, and so do all steps of a
period. A stack has several such groups. Differences between their sums show what changed while the
stack was taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ...rig.pattern import Code
from .frame_groups import white_groups
from .levels import Stack
from .registration import PictureMotion, Prepared, prepare, register

MOST_PIXELS = 400_000  # Larger pictures are reduced by a whole factor.
LIT = 0.1  # A lit pixel has this share of the contrast that 2 % of the pixels exceed.
AROUND_PX = 15  # A dark pixel this near to lit pixels counts as lit.
COMPARED = 3  # The number of earlier sums with which a sum is compared until a motion is known.
TOP = 0.97  # A reduced pixel above this share of saturation contains saturated pixels.


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteSum:
    """The mean of frames (with their indices in the code) that add up to a white picture."""

    frames: tuple[int, ...]
    picture: Float[np.ndarray, "h w"]  # [DN], `scale` times smaller than the frames
    valid: Bool[np.ndarray, "h w"]  # Lit and not saturated
    scale: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Displacement:
    """The motion of the picture from one white sum to the next [px of the camera]."""

    before: tuple[int, ...]
    after: tuple[int, ...]
    motion: PictureMotion


def white_sums(frames: Stack, code: Code, saturation_dn: float) -> list[WhiteSum]:
    """Return the mean picture of each of the `white_groups`, reduced in size if it is large."""
    groups = white_groups(code)
    h, w = frames.shape[1:]
    scale = max(1, round(np.ceil(np.sqrt(h * w / MOST_PIXELS))))
    if not groups or min(h, w) < 2 * scale:
        return []
    size = w // scale, h // scale
    whole = frames[:, : size[1] * scale, : size[0] * scale]
    small = np.array([cv2.resize(f, size, interpolation=cv2.INTER_AREA) for f in whole])
    contrast = (small.max(axis=0) - small.min(axis=0)).astype(np.float32)
    lit = cv2.dilate(contrast, np.ones((AROUND_PX, AROUND_PX), np.uint8))
    lit = lit > LIT * float(np.percentile(contrast, 98))
    return [
        WhiteSum(
            frames=group,
            picture=small[list(group)].mean(axis=0, dtype=np.float32),
            valid=lit & (small[list(group)].max(axis=0) < TOP * saturation_dn),
            scale=scale,
        )
        for group in groups
    ]


def displacements(sums: Sequence[WhiteSum]) -> list[Displacement]:
    """Return the motion of the picture from each white sum to the next, over the whole stack.

    A sum is skipped if its motion cannot be measured against any of the three sums before it (with
    fine stripes, a non-linear camera leaves more structure in the sum than the scene has). The
    motion to the next sum is then returned instead.

    Leaves out: codes without inverses and without phases, which have no such sums.
    """
    ready = [prepare(each.picture, each.valid) for each in sums]
    for start in range(len(sums) - 1):
        if register(ready[start], ready[start + 1]).known:
            return _steps(sums[start:], ready[start:])
    return []


def _steps(sums: Sequence[WhiteSum], ready: Sequence[Prepared]) -> list[Displacement]:
    steps: list[Displacement] = []
    compared = [0]  # Indices of the sums whose positions [px] are in `place_px`.
    place_px = {0: (0.0, 0.0)}
    for k in range(1, len(sums)):
        for other in reversed(compared[-COMPARED:]):
            small = register(ready[other], ready[k])
            if small.known:
                break
        else:
            continue
        scale, last = sums[k].scale, compared[-1]
        x_px = place_px[other][0] + scale * small.x_px
        y_px = place_px[other][1] + scale * small.y_px
        motion = PictureMotion(
            x_px=x_px - place_px[last][0],
            y_px=y_px - place_px[last][1],
            sigma_px=scale * small.sigma_px,
            known=True,
        )
        steps.append(Displacement(before=sums[last].frames, after=sums[k].frames, motion=motion))
        compared.append(k)
        place_px[k] = x_px, y_px
    return steps
