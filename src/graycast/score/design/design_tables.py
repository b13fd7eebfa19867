"""Tables and plots of the figures of a design study."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...base.folder import write_whole
from ...base.plotting import ACCENT, INK, SECOND, SOFT, caption, plain_figure, save_png, write_names
from ...base.tables import markdown_table, records_csv
from ...dataset.files.json_text import json_bytes
from ..evaluate.intervals import Interval
from .choosing import FIGURES, SettingFigures, choose, cost, on_front, row_of, sentences
from .point_fates import FATE_COLOR, FATES, Fate
from .result_files import PICTURE, SETTINGS, read_heaps
from .setting import place_settings, settings_of
from .study import DesignSpec

_HEADS = {
    "of_seen": ("of what it sees", 100.0, 1),
    "sigma_m": ("sigma mm", 1e3, 2),
    "bias_m": ("bias mm", 1e3, 2),
    "feature_m": ("feature mm", 1e3, 1),
    "seconds": ("seconds", 1.0, 2),
}


def write_design(spec: DesignSpec, out: Path) -> str:
    """Write `table.md`, `table.csv`, `design.json`, `pareto.png` and `missing.png` to `out`.

    Returns:
        The recommendation as text.

    Raises:
        GraycastError: figures are damaged, or the files cannot be written.
    """
    rows = rows_of(spec, out)
    conclusion = sentences(spec, rows)
    write_whole(out / "table.md", _markdown(spec, rows, conclusion).encode())
    records = [_record(row) for row in rows]
    write_whole(out / "table.csv", records_csv(records).encode())
    content = {"title": spec.title, "says": conclusion, "rows": records}
    write_whole(out / "design.json", json_bytes(content))
    _draw_pareto(spec, rows, out / "pareto.png")
    _draw_missing(spec, rows, out / "missing.png")
    return conclusion


def rows_of(spec: DesignSpec, out: Path) -> list[SettingFigures]:
    """Return a row for each setting, in descending order of the measured share."""
    placed = place_settings(spec, settings_of(spec))
    rows = [row_of(one, read_heaps(out, one.setting.name, spec)) for one in placed]
    front = on_front(np.array([cost(row) for row in rows]))
    rows = [replace(row, front=here) for row, here in zip(rows, front, strict=True)]
    return sorted(rows, key=lambda row: np.nan_to_num(-row.measured.value, nan=math.inf))


def _record(row: SettingFigures) -> dict[str, str | float | bool]:
    interval = row.measured
    return {
        "setting": row.name,
        "front": row.front,
        "measured": interval.value,
        "measured_low": interval.low,
        "measured_high": interval.high,
        **{name: row.figure[name] for name in FIGURES},
        **{str(fate): row.share[fate] for fate in FATES if fate is not Fate.MEASURED},
    }


def describe_design(spec: DesignSpec, out: Path) -> str:
    """Return the table and the recommendation as plain text."""
    rows = rows_of(spec, out)
    lines = [_heads(), *([row.name, *_cells(row)] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    return "\n".join([*text, "", sentences(spec, rows)])


def _heads() -> list[str]:
    return ["setting", "measured %", *(head for head, _, _ in _HEADS.values()), "front"]


def _cells(row: SettingFigures) -> list[str]:
    figures = [
        _number(factor * row.figure[name], digits) for name, (_, factor, digits) in _HEADS.items()
    ]
    return [_share(row.measured), *figures, "x" if row.front else ""]


def _markdown(spec: DesignSpec, rows: Sequence[SettingFigures], conclusion: str) -> str:
    rows_of_figures = [
        [f"[{row.name}]({SETTINGS}/{row.name}/{PICTURE})", *_cells(row)] for row in rows
    ]
    lost = [fate for fate in FATES if any(row.share[fate] > 0 for row in rows)]
    lost = [fate for fate in lost if fate is not Fate.MEASURED]
    texts = [
        f"# {spec.title}",
        conclusion,
        markdown_table(_heads(), rows_of_figures),
        _EXPLAINED.format(cone=spec.cone_deg, wrong=1e3 * spec.wrong_m),
        "## What is missing, in % of the open surface",
        markdown_table(
            ["setting", *(fate.replace("_", " ") for fate in lost)],
            [[row.name, *(_number(100 * row.share[fate], 1) for fate in lost)] for row in rows],
        ),
    ]
    return "\n\n".join(texts) + "\n"


_EXPLAINED = """\
Measured is the share of the open surface of the parts, with 95 % intervals over the heaps, which
are the same for all settings. The open surface is what can be seen from a direction that leans at
most {cone:g} degrees from the vertical, and a place counts as much as it shows in such views.
Depth counts as measured where it is within {wrong:g} mm of the truth. A setting is marked as front
if no other measures as much with as small a sigma and in as few seconds, and is better in one."""


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _share(interval: Interval) -> str:
    text = _number(100 * interval.value, 1)
    if math.isnan(interval.low):
        return text
    return f"{text} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def _draw_pareto(spec: DesignSpec, rows: Sequence[SettingFigures], path: Path) -> None:
    """Plot measured share over sigma and over seconds; settings off the front are pale."""
    best = choose(spec, rows)
    figure, axes = plain_figure(12.0, 5.2, (1, 1))
    for ax, column, words in zip(axes, (1, 2), ("sigma [mm]", "seconds of a scan"), strict=True):
        count = _draw_front(ax, rows, best, column)
        title = f"{spec.title}: {count} of {len(rows)} settings are on the front"
        caption(ax, title, words, "measured share of the open surface [%]")
    for ax, column in zip(axes, (1, 2), strict=True):  # Names avoid the points, drawn above.
        _write_settings(ax, rows, best, column)
    save_png(figure, path, dpi=110)


def _draw_front(
    ax: Axes, rows: Sequence[SettingFigures], best: SettingFigures | None, column: int
) -> int:
    """Plot measured share and interval over a cost; return the number of settings on the front.

    Both axes begin at 0, so that small differences look small.
    """
    costs = np.array([cost(row) for row in rows])
    front = np.array(on_front(costs[:, [0, column]]))
    x, y = costs[:, column], 100 * (1 - costs[:, 0])
    for row, here, at_x, at_y in zip(rows, front.tolist(), x.tolist(), y.tolist(), strict=True):
        limits = 100 * row.measured.low, 100 * row.measured.high
        ax.plot([at_x, at_x], limits, color=ACCENT if here else SOFT, lw=0.8, alpha=0.7)
        if row is best:
            ax.scatter([at_x], [at_y], s=90, facecolors="none", edgecolors=SECOND, lw=1.6)
    ax.scatter(x[~front], y[~front], s=18, color=SOFT)
    order = np.argsort(x[front], kind="stable")
    ax.plot(x[front][order], y[front][order], "o-", ms=5, lw=0.8, color=ACCENT)
    known = x[np.isfinite(x)]
    ax.set_xlim(0, 1.15 * known.max() if known.size and known.max() > 0 else 1)
    ax.set_ylim(bottom=0)
    return int(front.sum())


def _write_settings(
    ax: Axes, rows: Sequence[SettingFigures], best: SettingFigures | None, column: int
) -> None:
    """Write the settings' names where there is space: first the best setting, then the front."""
    costs = np.array([cost(row) for row in rows])
    front = on_front(costs[:, [0, column]])
    first = sorted(range(len(rows)), key=lambda i: (rows[i] is not best, not front[i]))
    write_names(
        ax,
        [rows[i].name.replace("_", " ") for i in first],
        np.column_stack([costs[:, column], 100 * (1 - costs[:, 0])])[first],
        [SECOND if rows[i] is best else INK if front[i] else SOFT for i in first],
    )


def _draw_missing(spec: DesignSpec, rows: Sequence[SettingFigures], path: Path) -> None:
    """Plot a bar for each setting with the shares of the open surface by fate."""
    figure, (ax,) = plain_figure(10.0, 1.6 + 0.24 * len(rows), (1,), grid="x")
    left = np.zeros(len(rows))
    for fate in FATES:
        width = 100 * np.array([np.nan_to_num(row.share[fate]) for row in rows])
        if width.any():
            label = fate.replace("_", " ")
            ax.barh(
                range(len(rows)), width, left=left, height=0.8, color=FATE_COLOR[fate], label=label
            )
        left += width
    ax.set_yticks(range(len(rows)), [row.name.replace("_", " ") for row in rows], fontsize=7)
    ax.invert_yaxis()
    ax.set_xlim(0, 100)
    ax.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    caption(ax, spec.title, "share of the open surface [%]")
    save_png(figure, path, dpi=110)
