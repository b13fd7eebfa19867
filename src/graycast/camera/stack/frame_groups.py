"""Groups of frames in a code: a pattern with its inverse, and the steps of a period."""

from ...rig.pattern import Code


def inverse_pairs(code: Code) -> list[tuple[int, int]]:
    """Return the indices of frames and their inverses, in the order of the code."""
    index = {
        (f.kind, f.axis, f.bit, f.period_px): k for k, f in enumerate(code.frames) if f.inverse
    }
    return [
        (k, index[f.kind, f.axis, f.bit, f.period_px])
        for k, f in enumerate(code.frames)
        if not f.inverse and (f.kind, f.axis, f.bit, f.period_px) in index
    ]


def full_periods(code: Code, *, kinds: tuple[str, ...] = ("phase", "line")) -> list[list[int]]:
    """Return the frames of each period that has all its steps, in the order of the steps."""
    groups: dict[tuple, dict[int, int]] = {}
    for k, frame in enumerate(code.frames):
        if frame.kind in kinds:
            whole, start = int(frame.step), frame.step % 1  # A cosine may begin between steps.
            key = frame.axis, frame.kind, frame.period_px, frame.steps, start
            groups.setdefault(key, {})[whole] = k
    return [
        [steps[i] for i in range(key[3])] for key, steps in groups.items() if len(steps) == key[3]
    ]


def opposite_steps(code: Code) -> list[tuple[int, int]]:
    """Return the pairs of cosine steps half a period apart, which are like pattern and inverse."""
    return [
        (steps[k], steps[k + len(steps) // 2])
        for steps in full_periods(code, kinds=("phase",))
        if len(steps) % 2 == 0
        for k in range(len(steps) // 2)
    ]


def white_groups(code: Code) -> list[tuple[int, ...]]:
    """Return the groups of frames that add up to a white picture, in the order of the code.

    A group is a pattern with its inverse, all steps of a period, or a white frame.
    """
    white = [(k,) for k, frame in enumerate(code.frames) if frame.kind == "white"]
    groups = [*map(tuple, inverse_pairs(code)), *map(tuple, full_periods(code)), *white]
    return sorted(groups, key=lambda group: sum(group) / len(group))
