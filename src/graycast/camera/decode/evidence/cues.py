"""Evidence for and against the depth of a pixel, in numbers that no rig, code or scene defines.

A pixel whose light came by way of another surface, or from two surfaces at an edge, does not look
like one that sees one lit point. Its stripes have less contrast, above all the fine ones, its
frames do not fit the pattern at the decoded position, the position is off its epipolar line, and
it is off the surface of its neighbours. `CUES` lists these numbers; `wrong.py` turns them into a
probability. A number that a stack cannot give, such as an epipolar distance without rows, is NaN.

Leaves out: the response of a projector that is not linear, which makes all frames of a cosine fit a
little less well.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, UInt8, UInt16

from ....rig.pair import Rig
from ....rig.pattern import Axis, Code
from ..maps import CodeMap, DepthMap, Levels
from ..reasons import Reason
from ..triangulation import epipolar_residual_px, triangulation_axis
from .frame_fit import fit_frames
from .mirror_images import orientation, rivals
from .neighbours import look_around, surface_sizes, surroundings

AROUND_PX, HOLES_PX = 5, 7  # Sides of the squares in which cues and holes are averaged.


class Cue(NamedTuple):
    """One number per pixel.

    Attributes:
        reason: the reason of a pixel without depth if this cue spoke against it.
        sense: 1 if a wrong depth is more likely where the number is larger, -1 if it is less
            likely there, 0 if neither holds everywhere.
    """

    name: str
    reason: Reason
    sense: int = 0


_LIGHT, _STRIPES = Reason.LOW_MODULATION, Reason.INTERREFLECTION
_FRAMES, _PLACE = Reason.CONTRADICTORY, Reason.OUTLIER
# "across" is the projector axis that gives depth, "along" the other one, which checks it.
CUES = (
    Cue("contrast over noise", _LIGHT),  # log2
    Cue("sigma across", _LIGHT),  # log2 px
    Cue("sigma along", _LIGHT),
    Cue("sigma of depth", _LIGHT),  # log2 m
    *(
        Cue(f"{words} {axis}", reason, sense)
        for axis in ("across", "along")
        for words, reason, sense in (
            ("coarse contrast", _STRIPES, -1),  # Shares of brightest minus darkest frame
            ("fine contrast", _STRIPES, -1),
            ("fine over coarse contrast", _STRIPES, -1),
            ("misfit of coarse frames", _FRAMES, 1),
            ("misfit of fine frames", _FRAMES, 0),
            ("largest misfit", _FRAMES, 1),
        )
    ),
    Cue("fine contrast across, around", _STRIPES, -1),
    Cue("fine contrast along, around", _STRIPES, -1),
    Cue("largest misfit across, around", _FRAMES, 1),
    Cue("largest misfit along, around", _FRAMES, 1),
    Cue("off the surface", _PLACE),  # log2 px
    Cue("off the surface over sigma", _PLACE),
    Cue("off the surface, around", _PLACE),
    Cue("pairs of neighbours", _PLACE),
    Cue("pairs in line", _PLACE, -1),
    Cue("directions in line", _PLACE, -1),
    Cue("directions not in line", _PLACE),
    Cue("neighbours", _PLACE),
    Cue("largest step", _PLACE),  # px
    Cue("brightness over neighbours", _STRIPES),  # log2
    Cue("range of brightness", _STRIPES),  # log2
    Cue("size of surface", _PLACE, -1),  # log2 px
    Cue("off the epipolar line", _PLACE, 1),  # log2 px
    Cue("off the epipolar line over sigma", _PLACE),
    Cue("off the epipolar line, around", _PLACE, 1),
    Cue("holes around", _PLACE),
    Cue("slope forward", _PLACE),  # Of positions across, per pixel of a facing surface
    Cue("slope aside", _PLACE),
    Cue("handedness", _PLACE, -1),
    Cue("distance of a brighter rival", _PLACE),  # log2 px
    Cue("contrast over that of a rival", _STRIPES),  # log2
    Cue("off the surroundings", _PLACE),  # standard deviations
    Cue("spread of the surroundings", _PLACE),  # log2 px
)
NAMES = tuple(cue.name for cue in CUES)


# Cues that span orders of magnitude are stored as their binary logarithms, from these values on.
_LEAST = {
    "contrast over noise": 0.1,
    "sigma across": 1e-4,  # px
    "sigma along": 1e-4,
    "sigma of depth": 1e-6,  # m
    "off the surface": 1e-3,  # px
    "off the surface over sigma": 1e-3,
    "off the epipolar line": 1e-2,  # px
    "off the epipolar line over sigma": 1e-2,
    "size of surface": 1.0,  # px
    "distance of a brighter rival": 1.0,  # px
    "contrast over that of a rival": 1e-3,
    "spread of the surroundings": 0.1,  # px
}


def cues_of(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    levels: Levels,
    codes: CodeMap,
    depth: DepthMap | None,
    rig: Rig | None,
) -> Float32[np.ndarray, "cues h w"]:
    """Return the maps of `CUES`; NaN where a stack, a rig or a pixel cannot give a number.

    Args:
        depth: the depth of the positions in `codes`, before filters; None without a rig.
    """
    axis = triangulation_axis(rig) if rig is not None else code.axes[0]
    other: Axis = "row" if axis == "column" else "column"
    decoded = codes.reason == Reason.DECODED if depth is None else np.isfinite(depth.depth_m)
    across, along = (
        np.where(decoded, getattr(codes, each), np.nan).astype(np.float32) for each in (axis, other)
    )
    sigma_across, sigma_along = (
        np.ascontiguousarray(getattr(codes, f"sigma_{each}"), np.float32) for each in (axis, other)
    )
    contrast_dn, noise_dn = _contrast(frames, levels)
    maps = {
        "contrast over noise": contrast_dn / noise_dn,
        "sigma across": sigma_across,
        "sigma along": sigma_along,
        "size of surface": surface_sizes(across),
        "holes around": np.asarray(
            cv2.boxFilter((~decoded).astype(np.float32), -1, (HOLES_PX, HOLES_PX))
        ),
    }
    maps |= look_around(across, sigma_across, contrast_dn) | surroundings(across)
    step_px = np.nan_to_num(maps["largest step"], nan=1.0)
    for name, own, place in (("across", axis, across), ("along", other, along)):
        if own in code.axes:
            fitted = fit_frames(frames, code, own, place, step_px, contrast_dn)
            maps |= {f"{word} {name}": values for word, values in fitted.items()}
    if depth is not None and rig is not None:
        maps["sigma of depth"] = depth.sigma_m
        maps |= orientation(across, along, rig, axis)
        maps |= rivals(across, along, contrast_dn, depth, rig, axis)
        if other in code.axes:
            residual_px = np.abs(epipolar_residual_px(codes, depth, rig)).astype(np.float32)
            maps["off the epipolar line"] = residual_px
            maps["off the epipolar line over sigma"] = residual_px / sigma_along
    for name in _LEAST.keys() & maps.keys():
        maps[name] = np.log2(np.maximum(maps[name], np.float32(_LEAST[name])))
    cues = np.empty((len(NAMES), *decoded.shape), dtype=np.float32)
    for values, name in zip(cues, NAMES, strict=True):
        alone = name.removesuffix(", around")
        if alone != name:
            values[:] = _mean_around(cues[NAMES.index(alone)])
        else:
            values[:] = maps.pop(name, np.float32(np.nan))  # Its memory serves the next maps.
    return cues


def _contrast(frames, levels: Levels):
    """Return brightest minus darkest frame, and the noise of the darkest frame [DN]."""
    low_dn = frames.min(axis=0).astype(np.float32)
    light_dn = np.maximum(low_dn - np.float32(levels.offset_dn), 0)
    noise_dn = np.sqrt(np.float32(levels.floor_dn2) + np.float32(levels.slope_dn) * light_dn)
    return frames.max(axis=0).astype(np.float32) - low_dn, noise_dn


def _mean_around(values: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Return the mean of the known values in a square around each pixel that has one itself."""
    known = np.isfinite(values)
    size = (AROUND_PX, AROUND_PX)
    total = cv2.boxFilter(np.where(known, values, np.float32(0)), -1, size)
    share = cv2.boxFilter(known.astype(np.float32), -1, size)
    return np.where(known, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan))
