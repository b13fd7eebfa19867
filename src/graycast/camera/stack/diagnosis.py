"""Detect faults in stacks that can be decoded nevertheless, with a measure for each fault."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...rig.pattern import Code, Frame
from ..decode import CodeMap, DecodeSpec, Levels, Reason, decode
from ..decode.plan import plan_axes
from .bit_order import FAR_PX, bits_fault
from .brightness import brightness_faults
from .computed import computed_pairs, describe_computed
from .description import LevelsSection
from .frame_groups import inverse_pairs, opposite_steps
from .levels import Stack, measure_levels
from .motion import describe_motion, stack_motion
from .sense import gray_bands, phase_faults
from .stack_figures import MAX_SAMPLES, samples, well_lit
from .stack_pictures import StackPictures
from .step_order import step_exchanges
from .white_sums import white_sums

CLEAR = 0.75  # A value this far from the middle, in units of half the contrast, is not blurred.
ALIKE = 0.25  # At most this share of well lit pixels may be equal in both frames of a pair.
DRIFT = 0.15  # The relative brightness may change by this much between frames.
OUTSIDE = 0.05  # At most this share may be beyond white, black or the projector's picture.
CONFLICT = 0.2  # At most this share of the well lit pixels may have contradictory frames.
CLEAR_OF_NOISE = 20.0  # Below this ratio of contrast to noise, noise can cause contradictions.
SATURATED = 0.2
UNLIT = 0.01
MIRRORED = 0.7
ROUGH = 0.15  # At most this share of neighbours may be more than FAR_PX apart.
TRIED_PX = 800  # Other orders of the pictures are tried in a window of this width and height.
SOUND = 0.5  # In the right order, more than this share of the well lit pixels is decoded.


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """Warnings about a stack, and whether their cause explains all symptoms, even of the rig."""

    warnings: tuple[str, ...]
    explained: bool
    exchanged: frozenset[int] = frozenset()  # Frames of periods with two exchanged pictures


def diagnose(
    pictures: StackPictures,
    code: Code,
    codes: CodeMap,
    spec: DecodeSpec,
    levels: Levels,
    *,
    known: LevelsSection,
) -> Diagnosis:
    """Return the warnings about a stack; symptoms of a known cause are left out.

    Only well lit pixels are used to check frames, order and sizes, because dark and shaded pixels
    have contradictions in healthy stacks, too.

    Args:
        levels: levels with which `codes` were decoded; `known` has the levels of the stack file.
    """
    names = [file.name for file in pictures.files]
    facts = [*_twins(pictures), *_exposure(codes)]
    if pictures.lossy and any(f.kind in ("phase", "line") for f in code.frames):
        facts.append(
            "JPEG pictures of a phase code: compression and gamma bend phases; use PNG or TIFF"
        )
    motion = stack_motion(white_sums(pictures.frames, code, levels.saturation_dn))
    moved = describe_motion(motion, names)
    computed = [*_computed(pictures.frames, code)]
    faults = _faults(pictures, code, codes, spec, levels)
    if faults.warnings:  # Sums of wrong frames have stripes, which can look like motion.
        explained = faults.explained or motion.explains
        reading = _better_reading(pictures, code, codes, spec, known, explained)
        if reading is not None:
            return Diagnosis(warnings=(reading, *computed, *facts), explained=True)
    if motion.explains:
        return Diagnosis(warnings=(*moved, *facts), explained=True)
    unequal = _brightness(pictures, code, well_lit(codes), levels, faults.exchanged)
    facts = [*unequal, *moved, *facts]
    if computed and not faults.explained:  # Levels measured in computed frames are wrong.
        return Diagnosis(warnings=(*computed, *facts), explained=False)
    return Diagnosis(warnings=(*computed, *faults.warnings, *facts), explained=faults.explained)


def _faults(
    pictures: StackPictures, code: Code, codes: CodeMap, spec: DecodeSpec, levels: Levels
) -> Diagnosis:
    """Return the faults of the frames and their order, with causes before effects."""
    well, frames = well_lit(codes), pictures.frames
    plans = plan_axes(code, spec.fine_bits)
    exchanges = step_exchanges(pictures, code, plans, spec, levels)
    exchanged = frozenset(k for exchange in exchanges for k in exchange.frames)
    warnings = [*_ends(frames, code, well), *_alike(pictures, code, well)]
    warnings += [exchange.text for exchange in exchanges]
    explained = bool(exchanges)
    for axis, plan in plans.items():
        order = None
        if not plan.periods:
            place_px = np.where(well, codes.column if axis == "column" else codes.row, np.nan)
            order = bits_fault(_neighbours(place_px), code, axis, plan)
        elif plan.bits:
            bands = gray_bands(frames, code, axis, spec, levels, well)
            order = bits_fault(bands.neighbour_places_px(), code, axis, plan)
            if order is None:
                others = tuple(p for p in plan.periods if exchanged.isdisjoint(p.frames))
                for fault in phase_faults(bands, code, axis, replace(plan, periods=others)):
                    warnings.append(fault.text)
                    explained |= fault.remedy
        if order is not None:
            warnings.append(order)
            explained = True
    if not explained:
        warnings += _outside(code, codes, well)
        warnings += _contradictions(code, codes, well, levels)
        warnings += _course(code, codes, well)
    return Diagnosis(warnings=tuple(warnings), explained=explained, exchanged=exchanged)


def _better_reading(
    pictures: StackPictures,
    code: Code,
    codes: CodeMap,
    spec: DecodeSpec,
    known: LevelsSection,
    explained: bool,
) -> str | None:
    """Return a warning if another order of frames removes all faults, or None.

    If another cause explains the faults, only the opposite order of all pictures is tried.
    """
    window = (slice(None), *_window(codes.reason != Reason.SHADOW))
    stack = np.ascontiguousarray(pictures.frames[window])
    readings = [(_OPPOSITE, stack[::-1], code)]
    if not explained:
        readings += [(text, stack, other) for text, other in _other_codes(code)]
    for text, frames, other in readings:
        levels = measure_levels(frames, other, known).levels
        decoded = decode(frames, other, spec, levels)
        share = (decoded.reason[well_lit(decoded)] == Reason.DECODED).mean()
        taken = replace(pictures, frames=frames)
        if share > SOUND and not _faults(taken, other, decoded, spec, levels).warnings:
            return text + f" (then {100 * share:.0f} % of the well lit pixels decode)"
    return None


_OPPOSITE = (
    "the pictures are in the opposite order: state the files of the stack from the last to the "
    "first"
)


def _other_codes(code: Code) -> Iterator[tuple[str, Code]]:
    """Yield codes with the order of bits or of steps reversed, for all axes and for each axis."""
    choices = [code.axes, *((axis,) for axis in code.axes if len(code.axes) > 1)]
    for axes in choices:
        whose = " and ".join(f"{axis}s" for axis in axes)
        bits = [f.bit for f in code.frames if f.kind == "gray" and f.axis in axes]
        if bits:
            frames = tuple(_turned_bits(f, code) if f.axis in axes else f for f in code.frames)
            text = f"the Gray bits of {whose} are in the opposite order: check that bit 0 is the "
            yield text + "finest", replace(code, frames=frames)
        if any(f.kind in ("phase", "line") and f.axis in axes for f in code.frames):
            frames = tuple(_turned_step(f) if f.axis in axes else f for f in code.frames)
            text = f"the phase steps of {whose} run backwards: state each step as steps - step"
            yield text, replace(code, frames=frames)


def _turned_bits(frame: Frame, code: Code) -> Frame:
    if frame.kind != "gray":
        return frame
    bits = [f.bit for f in code.frames if f.kind == "gray" and f.axis == frame.axis]
    ends = min(bits) + max(bits)
    xor_bit = frame.xor_bit if frame.xor_bit < 0 else ends - frame.xor_bit
    return replace(frame, bit=ends - frame.bit, xor_bit=xor_bit)


def _turned_step(frame: Frame) -> Frame:
    return replace(frame, step=-frame.step % frame.steps) if frame.steps else frame


def _window(lit: Bool[np.ndarray, "h w"]) -> tuple[slice, slice]:
    """Return a window about the median position of the lit pixels."""
    y, x = np.nonzero(lit)
    middle = [float(np.median(place)) if len(place) else 0.0 for place in (y, x)]
    starts = [
        round(min(max(m - TRIED_PX / 2, 0), max(size - TRIED_PX, 0)))
        for m, size in zip(middle, lit.shape, strict=True)
    ]
    return slice(starts[0], starts[0] + TRIED_PX), slice(starts[1], starts[1] + TRIED_PX)


def _computed(frames: Stack, code: Code) -> Iterator[str]:
    computed = computed_pairs(frames, code)
    if computed:
        yield describe_computed(len(computed), len(inverse_pairs(code)) + len(opposite_steps(code)))


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
    """Yield a warning if white is not the brightest frame, or black not the darkest."""
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


def _alike(pictures: StackPictures, code: Code, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    """Yield a warning for each pattern that is not the opposite of its inverse."""
    for k, other, flat, middle, half in _well_lit_pairs(pictures, code, well):
        first, second = ((flat[i].astype(np.float32) - middle) / half for i in (k, other))
        clear = (np.abs(first) > CLEAR) & (np.abs(second) > CLEAR)  # Far from edges of stripes
        alike = clear & (first * second > 0)
        if alike.mean() > ALIKE:
            both = np.corrcoef(first[clear], second[clear])[0, 1] if first[clear].std() else 0.0
            yield (
                f"{code.frames[k].name} and its inverse are alike in {100 * alike.mean():.0f} % of "
                f"the well lit pixels (correlation {both:+.2f}, it should be near -1): are "
                f"{pictures.files[k].name} and {pictures.files[other].name} the right files?"
            )


def _brightness(
    pictures: StackPictures,
    code: Code,
    well: Bool[np.ndarray, "h w"],
    levels: Levels,
    exchanged: frozenset[int],
) -> Iterator[str]:
    """Yield a warning for each pair, and each step, that is brighter or darker than the others."""
    sums = {}
    for k, other, flat, middle, half in _well_lit_pairs(pictures, code, well):
        first, second = (flat[i].astype(np.float32) for i in (k, other))
        striped = np.abs(first - second) > half  # Stripes that are not blurred to grey
        if striped.mean() > 0.3:
            sums[k] = float(np.median((first + second)[striped] / (2 * middle)[striped]))
    usual = float(np.median([*sums.values()])) if sums else 1.0
    for k, total in sums.items():
        if abs(total / usual - 1) > DRIFT:
            yield (
                f"{code.frames[k].name} and its inverse together are {total / usual:.2f} times as "
                "bright as the others: the exposure or the light may have changed"
            )
    names = [file.name for file in pictures.files]
    yield from brightness_faults(
        pictures.frames, code, names, well, levels.saturation_dn, exchanged=exchanged
    )


def _well_lit_pairs(pictures: StackPictures, code: Code, well: Bool[np.ndarray, "h w"]):
    """Yield each pair with samples of all frames, and the middle and half width of their range."""
    pairs = inverse_pairs(code)
    if not pairs or not well.any():
        return
    flat = pictures.frames.reshape(len(pictures.frames), -1)[:, samples(well)]
    high, low = flat.max(axis=0).astype(np.float32), flat.min(axis=0).astype(np.float32)
    for k, other in pairs:
        yield k, other, flat, (high + low) / 2, np.maximum((high - low) / 2, 1)


def _exposure(codes: CodeMap) -> Iterator[str]:
    lit = codes.reason != Reason.SHADOW
    if lit.mean() < UNLIT:
        yield (
            f"{100 * lit.mean():.2f} % of the pixels are lit: check that the projector is in view "
            "and that the exposure is long enough"
        )
    saturated = int((codes.reason == Reason.SATURATED).sum()) / max(int(lit.sum()), 1)
    if saturated > SATURATED:
        yield f"{100 * saturated:.0f} % of the lit pixels are saturated: shorten the exposure"


def _outside(code: Code, codes: CodeMap, well: Bool[np.ndarray, "h w"]) -> Iterator[str]:
    count = {reason: int((codes.reason[well] == reason).sum()) for reason in Reason}
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
    """Yield a warning if frames contradict each other in many well lit pixels."""
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
    """Yield warnings if neighbouring pixels do not have similar codes, or the code is mirrored."""
    for axis in code.axes:
        place_px = np.where(well, codes.column if axis == "column" else codes.row, np.nan)
        pairs_px = _neighbours(place_px)
        if len(pairs_px) < 50:
            continue
        apart_px = np.abs(pairs_px[:, 1] - pairs_px[:, 0])
        far = float((apart_px > FAR_PX).mean())
        if far > ROUGH:
            yield (
                f"{axis}s do not change smoothly: {100 * far:.0f} % of neighbouring well lit "
                f"pixels are over {FAR_PX:g} apart, median jump {np.median(apart_px):.3g} px: the "
                "order of the frames, the axes or the period may be wrong"
            )
    if len(code.axes) == 2:
        mirrored = mirror_symptom(codes.column, codes.row, step=2 if code.subpixel else 8)
        if mirrored is not None:
            yield mirrored


def mirror_symptom(
    column: Float[np.ndarray, "h w"], row: Float[np.ndarray, "h w"], *, step: int = 8
) -> str | None:
    """Return a warning if the code is a mirror image in the camera's picture, or None.

    A camera cannot see a mirrored code, because it sees surfaces from the side that is lit.

    Args:
        step: distance of compared pixels. Between adjacent pixels, the whole columns and rows of a
            Gray code seldom change.
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
    """Return positions of pairs of neighbouring decoded pixels, sampled evenly along x and y."""
    step = max(1, round(np.sqrt(position.size / MAX_SAMPLES)))
    rows, columns = position[::step], position[:, ::step]
    first = np.concatenate([rows[:, :-1].ravel(), columns[:-1].ravel()])
    second = np.concatenate([rows[:, 1:].ravel(), columns[1:].ravel()])
    pairs = np.stack([first, second], axis=-1)[:: max(1, step)].astype(np.float64)
    return pairs[np.isfinite(pairs).all(axis=-1)]
