"""Quality figures of a decoded stack."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from ...base.public_value import public_value
from ...rig.pattern import Code
from ..decode import CodeMap, Mark, Reason, reason_shares
from .frame_groups import inverse_pairs

WELL = 0.4  # A well lit pixel has this share of the contrast that 2 % of the lit pixels exceed.
MAX_SAMPLES = 150_000  # Medians are taken over at most this many pixels.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class StackFigures:
    """Shares of pixels, and medians over the better lit half of the decoded pixels.

    `lit_share` is the share of pixels whose frames differ by more than noise, and `decoded_share`
    is relative to these. Of the decoded pixels, `clipped_share` have a saturated frame, and
    `settled_share` have a period that their neighbours resolved. `modulation`, by frame name, is
    |pattern - inverse| over white minus black; without an inverse, twice the distance from the
    middle of white and black; without white and black, the pixel's brightest and darkest frame
    replace them. For a phase code it is twice the amplitude. The epipolar residual [projector px]
    is NaN without a rig or without both axes. `epipolar_sure_px` is its median over the pixels
    without any doubtful bit; it is NaN with phases.
    """

    lit_share: float
    decoded_share: float
    reasons: dict[str, float]
    modulation: dict[str, float]
    clipped_share: float = 0.0
    settled_share: float = 0.0
    epipolar_median_px: float = np.nan
    epipolar_95_px: float = np.nan
    epipolar_sure_px: float = np.nan


def figures_of(
    frames: UInt8[np.ndarray, "n h w"] | UInt16[np.ndarray, "n h w"],
    code: Code,
    codes: CodeMap,
    residual_px: Float[np.ndarray, "h w"] | None,
    reason: UInt8[np.ndarray, "h w"],
) -> StackFigures:
    """Return the figures of a stack.

    Args:
        codes: the positions before any is removed as doubtful, as an outlier or as out of range.
        reason: the reasons after that.
    """
    lit = codes.reason != Reason.SHADOW
    off = sure = np.empty(0)
    if residual_px is not None:
        known = np.isfinite(residual_px)
        off = np.abs(residual_px[known])
        sigma_px = np.maximum(codes.sigma_column, codes.sigma_row)[known]
        # All pixels without a doubtful bit have the same, smallest sigma. With phases sigma varies
        # from pixel to pixel, and the smallest one has no meaning.
        if not any(frame.kind in ("phase", "line") for frame in code.frames):
            sure = off[sigma_px < 1.05 * sigma_px.min(initial=np.inf)]
    decoded = codes.reason == Reason.DECODED
    return StackFigures(
        lit_share=float(lit.mean()),
        decoded_share=float(decoded[lit].mean()) if lit.any() else 0.0,
        reasons=reason_shares(reason),
        modulation=_modulation(frames, code, decoded, codes.modulation) if decoded.any() else {},
        clipped_share=_marked(codes, decoded, Mark.CLIPPED),
        settled_share=_marked(codes, decoded, Mark.SETTLED),
        epipolar_median_px=float(np.median(off)) if off.size else np.nan,
        epipolar_95_px=float(np.percentile(off, 95)) if off.size else np.nan,
        epipolar_sure_px=float(np.median(sure)) if sure.size else np.nan,
    )


def well_lit(codes: CodeMap) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the lit pixels with at least 40 % of the contrast of the best pixels.

    Dark surfaces and shadows with a little indirect light are lit, too, but have contradictions
    even in a good stack. Wrong frames cause contradictions in the best lit pixels as well.
    """
    lit = ~np.isin(codes.reason, (Reason.SHADOW, Reason.SATURATED))
    if not lit.any():
        return lit
    return lit & (codes.modulation >= WELL * np.percentile(codes.modulation[lit], 98))


def _marked(codes: CodeMap, decoded: Bool[np.ndarray, "h w"], mark: Mark) -> float:
    if not decoded.any():
        return 0.0
    if codes.mark is None:
        raise ValueError("the marks of this code map were not kept")
    return float((codes.mark[decoded] & mark > 0).mean())


def samples(where: Bool[np.ndarray, "h w"]) -> np.ndarray:
    """Return flat indices of evenly sampled pixels of a mask."""
    index = np.flatnonzero(where)
    return index[:: max(1, -(-len(index) // MAX_SAMPLES))]


def _modulation(
    frames, code: Code, decoded: Bool[np.ndarray, "h w"], contrast: Float[np.ndarray, "h w"]
) -> dict[str, float]:
    bright = decoded & (contrast >= np.median(contrast[decoded]))
    taken = samples(bright)
    flat = frames.reshape(len(frames), -1)[:, taken].astype(np.float32)
    kinds = [frame.kind for frame in code.frames]
    if "white" in kinds and "black" in kinds:
        white, black = flat[kinds.index("white")], flat[kinds.index("black")]
    else:
        white, black = flat.max(axis=0), flat.min(axis=0)
    span = np.maximum(white - black, 1)
    inverse = dict(inverse_pairs(code))
    modulation = {}
    for k, frame in enumerate(code.frames):
        if frame.kind not in ("gray", "complementary") or frame.inverse:
            continue
        other = flat[inverse[k]] if k in inverse else white + black - flat[k]
        modulation[frame.name] = float(np.median(np.abs(flat[k] - other) / span))
    return modulation | _phase_modulation(flat, code, span)


def _phase_modulation(flat, code: Code, span) -> dict[str, float]:
    groups: dict[tuple, list[int]] = {}
    for k, frame in enumerate(code.frames):
        if frame.kind in ("phase", "line"):
            groups.setdefault((frame.axis, frame.kind, frame.period_px, frame.steps), []).append(k)
    modulation = {}
    for (axis, kind, period_px, steps), members in groups.items():
        if len(members) < 3:
            continue
        turn = np.array([2j * np.pi * code.frames[k].step / steps for k in members])
        wave = np.abs(np.exp(turn) @ flat[members]) * 4 / len(members)
        modulation[f"{axis}_{kind}_{period_px:g}px"] = float(np.median(wave / span))
    return modulation
