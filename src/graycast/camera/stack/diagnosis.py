"""Symptoms of wrong stacks that can still be read, each with its measure."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from ...rig.pattern import Code
from ..decode import CodeMap, DecodeSpec, Levels, Reason
from ..decode.plan import AxisPlan, plan_axes
from .levels import Stack, inverse_pairs
from .sense import phase_faults
from .stack_figures import MAX_SAMPLES, samples, well_lit
from .stack_pictures import StackPictures

CLEAR = 0.75  # A value this far from the middle, in halves of the contrast, is not blurred.
ALIKE = 0.25  # This share of well lit pixels may be clearly bright, or dark, in both of a pair.
DRIFT = 0.15  # The brightness may change by this much between frames.
OUTSIDE = 0.05  # This share may be beyond white, black or the projector's picture.
CONFLICT = 0.2  # This share of the well lit pixels may have frames that contradict.
CLEAR_OF_NOISE = 20.0  # Below this contrast over noise, noise alone can make frames contradict.
SATURATED = 0.2
UNLIT = 0.01
MIRRORED = 0.7
ROUGH = 0.15  # This share of neighbours may be more than FAR_PX apart.
FAR_PX = 8.0
MENDED_OF = 30_000  # Changes of the order are tried on so many pairs.
# More than TORN of the neighbours far apart is a fault; its remedy leaves less than FEWER of them.
TORN, FEWER = 2e-3, 0.5


def symptoms(
    pictures: StackPictures, code: Code, codes: CodeMap, *, spec: DecodeSpec, levels: Levels
) -> Iterator[str]:
    """Warnings, the cause before the effect.

    Only the well lit pixels are asked whether frames, order and sizes are right: dark and shaded
    ones contradict themselves in healthy stacks too.
    """
    well = well_lit(codes)
    yield from _twins(pictures)
    yield from _ends(pictures.frames, code, well)
    yield from _pairs(pictures, code, well)
    yield from phase_faults(pictures.frames, code, spec, levels, well)
    yield from _shares(code, codes, well)
    yield from _contradictions(code, codes, well, levels)
    yield from _course(code, codes, well)
    if pictures.lossy and any(f.kind in ("phase", "line") for f in code.frames):
        yield "JPEG pictures of a phase code: compression and gamma bend phases; use PNG or TIFF"


def _twins(pictures: StackPictures) -> Iterator[str]:
    first: dict[str, str] = {}
    for file, digest in zip(pictures.files, pictures.digests, strict=True):
        if digest in first:
            yield (
                f"{first[digest]} and {file.name} are the same picture: one may have been copied "
                "twice"
            )
        first.setdefault(digest, file.name)


def _ends(frames: Stack, code: Code, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    """White must be brightest and black darkest."""
    kinds = [frame.kind for frame in code.frames]
    taken = samples(well)
    if not len(taken):
        return
    flat = frames.reshape(len(frames), -1)[:, taken].astype(np.float32)
    contrast = flat.max(axis=0) - flat.min(axis=0)
    if "white" in kinds and "black" in kinds:
        step_dn = float(np.median(flat[kinds.index("white")] - flat[kinds.index("black")]))
        if step_dn < 0:
            suspicion = "the two may be swapped"
            yield f"white is darker than black by {-step_dn:.0f} DN (median): {suspicion}"
            return
    for kind, sign in (("white", 1), ("black", -1)):
        if kind not in kinds:
            continue
        extreme = (sign * flat).max(axis=0)
        beyond = (extreme - sign * flat[kinds.index(kind)]) > 0.5 * contrast
        if beyond.mean() > OUTSIDE:
            other = "brighter" if sign > 0 else "darker"
            yield (
                f"{100 * beyond.mean():.0f} % of the well lit pixels have a frame much {other} "
                f"than {kind}: is {kind} another frame, or taken with another exposure?"
            )


def _pairs(pictures: StackPictures, code: Code, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    """A pattern and its inverse are opposite, and together equally bright for every bit."""
    pairs = inverse_pairs(code)
    if not pairs or not well.any():
        return
    taken = samples(well)
    flat = pictures.frames.reshape(len(pictures.frames), -1)[:, taken]
    high, low = flat.max(axis=0).astype(np.float32), flat.min(axis=0).astype(np.float32)
    middle, half = (high + low) / 2, np.maximum((high - low) / 2, 1)
    sums = {}
    for k, other in pairs:
        first, second = ((flat[i].astype(np.float32) - middle) / half for i in (k, other))
        clear = (np.abs(first) > CLEAR) & (np.abs(second) > CLEAR)  # well inside a stripe
        alike = clear & (first * second > 0)
        if alike.mean() > ALIKE:
            both = np.corrcoef(first[clear], second[clear])[0, 1] if first[clear].std() else 0.0
            yield (
                f"{code.frames[k].name} and its inverse are alike in {100 * alike.mean():.0f} % of "
                f"the well lit pixels (correlation {both:+.2f}, it should be near -1): are "
                f"{pictures.files[k].name} and {pictures.files[other].name} the right files?"
            )
        striped = np.abs(first - second) > 1.0  # half of the contrast: not blurred to grey
        if striped.mean() > 0.3:
            whole = flat[k].astype(np.float32) + flat[other]
            sums[k] = float(np.median(whole[striped] / (high + low)[striped]))
    usual = float(np.median([*sums.values()])) if sums else 1.0
    for k, total in sums.items():
        if abs(total / usual - 1) > DRIFT:
            yield (
                f"{code.frames[k].name} and its inverse together are {total / usual:.2f} times as "
                "bright as the others: the exposure or the light may have changed"
            )


def _shares(code: Code, codes: CodeMap, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    lit = codes.reason != Reason.SHADOW
    count = {reason: int((codes.reason[well] == reason).sum()) for reason in Reason}
    if lit.mean() < UNLIT:
        yield (
            f"{100 * lit.mean():.2f} % of the pixels are lit: check that the projector is in view "
            "and that the exposure is long enough"
        )
    saturated = int((codes.reason == Reason.SATURATED).sum()) / max(int(lit.sum()), 1)
    if saturated > SATURATED:
        yield f"{100 * saturated:.0f} % of the lit pixels are saturated: shorten the exposure"
    placed = count[Reason.DECODED] + count[Reason.OUTSIDE_PROJECTOR]
    outside = count[Reason.OUTSIDE_PROJECTOR] / max(placed, 1)
    if outside > OUTSIDE:
        size = f"{code.width_px} x {code.height_px} px"
        yield (
            f"{100 * outside:.0f} % of the codes lie outside the projector of {size}: its size "
            "may be wrong, axes or bits may be exchanged, or the coarsest bit may be swapped "
            "with its inverse"
        )


def _contradictions(
    code: Code, codes: CodeMap, well: Bool[np.ndarray, "h w"], levels: Levels
) -> Iterator[str]:
    """Frames that do not belong together contradict where they are best seen."""
    conflict = np.isin(codes.reason[well], (Reason.CONTRADICTORY, Reason.INTERREFLECTION))
    if not conflict.any() or conflict.mean() <= CONFLICT:
        return
    phases = any(frame.kind in ("phase", "line") for frame in code.frames)
    ask = (
        "check period_px, the steps and their order" if phases else "check the names of the frames"
    )
    contrast_dn = float(np.median(codes.modulation[well])) * levels.range_dn
    noise_dn = float(np.sqrt(levels.floor_dn2 + levels.slope_dn * contrast_dn / 2))
    if contrast_dn < CLEAR_OF_NOISE * noise_dn:
        ask = (
            f"their contrast is {contrast_dn / noise_dn:.0f} times the noise, which may be the "
            f"reason: lengthen the exposure; else {ask}"
        )
    yield f"{100 * conflict.mean():.0f} % of the well lit pixels have frames that contradict: {ask}"


def _course(code: Code, codes: CodeMap, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    """Neighbouring pixels should have neighbouring codes; a wrong bit breaks this."""
    maps = {
        axis: np.where(well, place, np.float32(np.nan))
        for axis, place in (("column", codes.column), ("row", codes.row))
    }
    for axis, plan in plan_axes(code, 0).items():
        pairs_px = _neighbours(maps[axis])
        if len(pairs_px) < 50:
            continue
        far = _far_share(pairs_px)
        remedy = None if plan.periods else _mended(pairs_px, code, plan, far)
        if remedy is not None:
            change, left = remedy
            yield (
                f"{100 * far:.1f} % of neighbouring well lit pixels are over {FAR_PX:g} {axis}s "
                f"apart, {100 * left:.1f} % if {change}"
            )
        elif far > ROUGH:
            jump_px = np.median(np.abs(pairs_px[:, 1] - pairs_px[:, 0]))
            yield (
                f"{axis}s do not change smoothly: {100 * far:.0f} % of neighbouring well lit "
                f"pixels are over {FAR_PX:g} apart, median jump {jump_px:.3g} px: the order of "
                "the frames, the axes or the period may be wrong"
            )
    if len(code.axes) == 2:
        mirrored = mirror_symptom(codes.column, codes.row, step=2 if code.subpixel else 8)
        if mirrored is not None:
            yield mirrored


def mirror_symptom(
    column: Float[np.ndarray, "h w"], row: Float[np.ndarray, "h w"], *, step: int = 8
) -> str | None:
    """A sentence if columns and rows turn the other way round than the picture's x and y.

    No camera sees that, since it looks at the side of a surface that the projector lights.

    Args:
        step: camera pixels between the places that are compared: over single ones the whole columns
            and rows of a Gray code seldom change.
    """
    column, row = column[::step, ::step], row[::step, ::step]
    cx, cy = np.diff(column, axis=1)[:-1], np.diff(column, axis=0)[:, :-1]
    rx, ry = np.diff(row, axis=1)[:-1], np.diff(row, axis=0)[:, :-1]
    turn = cx * ry - cy * rx
    turn = turn[np.isfinite(turn) & (turn != 0)]
    share = float((turn < 0).mean()) if len(turn) >= 20 else 0.0
    if share <= MIRRORED:
        return None
    return (
        f"the code is a mirror image in {100 * share:.0f} % of the picture: column and row may be "
        "exchanged, a coarse bit may be swapped with its inverse, or the projector may be set to "
        "rear projection"
    )


def _neighbours(position: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "n 2"]:
    """Positions of neighbouring decoded pixels, an even choice along x and along y."""
    step = max(1, round(np.sqrt(position.size / MAX_SAMPLES)))
    rows, columns = position[::step], position[:, ::step]
    first = np.concatenate([rows[:, :-1].ravel(), columns[:-1].ravel()])
    second = np.concatenate([rows[:, 1:].ravel(), columns[1:].ravel()])
    pairs = np.stack([first, second], axis=-1)[:: max(1, step)].astype(np.float64)
    return pairs[np.isfinite(pairs).all(axis=-1)]


def _far_share(pairs_px: Float[np.ndarray, "n 2"]) -> float:
    return float((np.abs(pairs_px[:, 1] - pairs_px[:, 0]) > FAR_PX).mean())


def _mended(pairs_px, code: Code, plan: AxisPlan, far: float) -> tuple[str, float] | None:
    """The change of the bits that makes most jumps go, in words; and the jumps left."""
    if far < TORN:
        return None
    pairs_px = pairs_px[:: max(1, len(pairs_px) // MENDED_OF)]
    value = np.floor((pairs_px - plan.first_px) / plan.cell_px).astype(np.int64)
    gray = value ^ (value >> 1)
    best = None
    for change, order, turned in _changes(code, plan):
        left = _far_share(_binary(_reordered(gray, order) ^ turned) * plan.cell_px)
        if left < FEWER * far and (best is None or left < best[1]):
            best = change, left
    return best


def _changes(code: Code, plan: AxisPlan) -> Iterator[tuple[str, list[int], int]]:
    """Candidate errors of the bits: a text, the order of the bits, and the inverted ones."""
    count = len(plan.bits)
    names = [code.frames[bit.frame].name for bit in plan.bits]
    as_is = [*range(count)]
    for k in as_is:
        yield f"{names[k]} were its inverse: the two may be swapped", as_is, 1 << (count - 1 - k)
    for k, other in combinations(as_is, 2):
        order = as_is.copy()
        order[k], order[other] = other, k
        yield f"{names[k]} and {names[other]} were exchanged: their order may be wrong", order, 0
    yield "all bits were in the opposite order: check that bit 0 is the finest", as_is[::-1], 0
    for by in range(1, count):
        moved = f"{by} finer" if 2 * by <= count else f"{count - by} coarser"
        deviation = f"each bit were {moved}, in a cycle: a file may be missing"
        yield deviation, as_is[by:] + as_is[:by], 0


def _reordered(gray, order: list[int]):
    """Gray values whose k-th bit from above is what the `order[k]`-th was."""
    last = len(order) - 1
    bits = [((gray >> (last - source)) & 1) << (last - k) for k, source in enumerate(order)]
    return np.bitwise_or.reduce(bits)


def _binary(gray):
    """Values of a Gray code of up to 32 bits."""
    for shift in (16, 8, 4, 2, 1):
        gray = gray ^ (gray >> shift)
    return gray
