"""Timing of two jobs in turn, and text output of a benchmark's results."""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

Figures = dict[str, Any]
Show = Callable[[str], None]  # function that shows a line of progress

LONGEST_LIST = 20  # Longer lists of numbers are only in the file of --json.
PAIRS = 5  # number of pairs that are timed in turn, A B A B ...


def in_turn(
    first: Callable[[], object], second: Callable[[], object]
) -> tuple[float, float, float]:
    """Return the median seconds of two jobs that run in turn, after one warm-up run of each.

    The third value is the median of the ratios of pairs, because other load of the machine slows
    both jobs of a pair. A ratio of medians would compare runs of different pairs.
    """
    first(), second()
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(PAIRS):
        for job, times in zip((first, second), seconds, strict=True):
            start = time.perf_counter()
            job()
            times.append(time.perf_counter() - start)
    ratios = [one / other for one, other in zip(*seconds, strict=True)]
    return median(seconds[0]), median(seconds[1]), median(ratios)


def describe(figures: Figures) -> str:
    """Return the results as text, one per line; a list of dictionaries becomes a table."""
    lines = []
    for name, value in figures.items():
        if isinstance(value, dict) and all(isinstance(one, list) for one in value.values()):
            lines.append(f"{name:28} in --json")
        elif isinstance(value, dict):
            lines.append(f"{name}:")
            lines += [f"  {key:26} {_short(number)}" for key, number in value.items()]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            lines += [f"{name}:", *_columns(value)]
        else:
            lines.append(f"{name:28} {_short(value)}")
    return "\n".join(lines)


def _columns(rows: list[Figures]) -> list[str]:
    names = list(dict.fromkeys(name for row in rows for name in row))
    cells = [names, *([_short(row.get(name, "")) for name in names] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(names))]
    return [
        "  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in cells
    ]


def _short(value: Any) -> str:
    if isinstance(value, list):
        if len(value) > LONGEST_LIST:
            return f"{len(value)} numbers, in --json"
        return " ".join(_short(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)
