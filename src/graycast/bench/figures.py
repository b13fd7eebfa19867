"""The figures of a benchmark or a study: plain numbers for JSON, and their text form."""

import os
import platform
from typing import Any

from ..usage import peak_rss_bytes

Figures = dict[str, Any]

LONGEST_LIST = 20  # of numbers in a line; the rest are for --json


def stamped(what: str, figures: Figures) -> Figures:
    """Figures with their name before them, the machine, and the peak of memory of one process.

    It is that of this process or of one that it started and that has ended, whichever had more.
    """
    machine = {"benchmark": what, "machine": platform.machine(), "cores": os.cpu_count()}
    return machine | figures | {"peak_rss_bytes": peak_rss_bytes()}


def describe(figures: Figures) -> str:
    """The figures for a terminal: one a line, and a list of alike ones as a table."""
    lines = []
    for name, value in figures.items():
        if isinstance(value, dict) and all(isinstance(one, list) for one in value.values()):
            lines.append(f"{name:28} in --json")
        elif isinstance(value, dict):
            lines.append(f"{name}:")
            lines += [f"  {key:26} {_short(number)}" for key, number in value.items()]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            lines += [f"{name}:", *_table(value)]
        else:
            lines.append(f"{name:28} {_short(value)}")
    return "\n".join(lines)


def _table(rows: list[Figures]) -> list[str]:
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
