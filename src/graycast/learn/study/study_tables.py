"""A study's scores as tables for readers, spreadsheets and papers, and as a plot."""

import math
from collections.abc import Sequence
from pathlib import Path

from ...base.folder import write_whole
from ...base.plotting import (
    ACCENT,
    INK,
    SECOND,
    SOFT,
    caption,
    legend_below,
    plain_figure,
    save_png,
)
from ...base.tables import markdown_table, records_csv
from ...dataset.files.json_text import json_bytes
from ..study_file import StudySpec
from .study_runs import Result

Row = dict[str, str | float]
_KEYS = ("model", "input", "encoding", "training", "seed", "kind", "dataset")
_ALL = "all"  # name of the mean over the datasets of a world


def write_study(spec: StudySpec, results: Sequence[Result], out: Path) -> None:
    """Write `table.md`, `table.csv`, `table.tex`, `study.json` and `gaps.png` to `out`.

    If worlds have several datasets, all tables except `table.tex` also have each dataset's scores.
    """
    means = [row for result in results for row in _rows(spec, result)]
    parts = [
        row
        for number, name in enumerate(_datasets(spec))
        for result in results
        for row in _rows(spec, result, (number, name))
    ]
    write_whole(out / "table.md", _markdown(spec, means, parts).encode())
    write_whole(out / "table.csv", records_csv(means + parts).encode())
    write_whole(out / "table.tex", _latex(spec, means).encode())
    content = {"title": spec.title, "figure": "AP50", "rows": means + parts}
    write_whole(out / "study.json", json_bytes(content))
    _draw(spec, means, out / "gaps.png")


def _datasets(spec: StudySpec) -> list[str]:
    """Return the names of the datasets in a world by index; empty if there is only one.

    Datasets with the same index in two worlds have the same parts, so one world gives the names.
    """
    first = spec.gap[0] if spec.gap is not None else next(iter(spec.tests))
    named = spec.tests[first].datasets
    return [path.name for path in named] if len(named) > 1 else []


def _rows(spec: StudySpec, result: Result, dataset: tuple[int, str] | None = None) -> list[Row]:
    """Return a row for boxes and a row for masks, with score and interval for each world."""
    rows = []
    run = result.run
    number, name = dataset if dataset is not None else (None, _ALL)
    for kind in ("box", "mask"):
        worlds = {world: result.of(world, kind, number) for world in spec.tests}
        figures = {world: figure for world, figure in worlds.items() if figure is not None}
        if not figures:
            continue
        if spec.gap is not None:
            own, other = (figures.get(world) for world in spec.gap)
            if own is not None and other is not None:
                figures["gap"] = own - other
        row: Row = {
            "model": run.model.model,
            "input": run.input,
            "encoding": run.encoding.name,
            "training": run.training,
            "seed": run.seed,
            "kind": kind,
            "dataset": name,
        }
        for world, figure in figures.items():
            interval = figure.interval
            values = (interval.value, interval.low, interval.high)
            row |= dict(zip(_ends(world), values, strict=True))
        rows.append(row)
    return rows


def _interval_text(row: Row, name: str) -> str:
    value, low, high = (float(row.get(key, math.nan)) for key in _ends(name))
    if math.isnan(value):  # A world without masks has NaN, too.
        return "-"
    return f"{value:.2f}" if math.isnan(low) else f"{value:.2f} [{low:.2f}, {high:.2f}]"


def _ends(name: str) -> tuple[str, str, str]:
    """Return the names of the columns for a value and for both ends of its interval."""
    return name, f"{name}_low", f"{name}_high"


def _keys(rows: Sequence[Row]) -> list[str]:
    """Return the keys that differ between rows, and always model, input and kind."""
    return [
        key
        for key in _KEYS
        if key in ("model", "input", "kind") or len({row[key] for row in rows}) > 1
    ]


def _markdown(spec: StudySpec, means: Sequence[Row], parts: Sequence[Row]) -> str:
    text = f"# {spec.title}\n\n"
    text += "AP50, the mean over the world's datasets, with 95 % intervals over scenes.\n\n"
    text += _lines(spec, means)
    if parts:
        text += "\n## Each dataset by itself\n\n" + _lines(spec, parts)
    return text


def _table(spec: StudySpec, rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Return the column headings, and the cells of each row."""
    keys, columns = _keys(rows), [*spec.tests, *(["gap"] if spec.gap is not None else [])]
    cells = [
        [*(str(row[key]) for key in keys), *(_interval_text(row, name) for name in columns)]
        for row in rows
    ]
    return [*keys, *columns], cells


def _lines(spec: StudySpec, rows: Sequence[Row]) -> str:
    return markdown_table(*_table(spec, rows)) + "\n"


def _latex(spec: StudySpec, rows: Sequence[Row]) -> str:
    heads, cells = _table(spec, rows)
    head, *lines = (" & ".join(row).replace("_", r"\_") + r" \\" for row in (heads, *cells))
    keys = len(_keys(rows))
    return "\n".join(
        [
            rf"% {spec.title}: AP50 with 95 % intervals over scenes",
            rf"\begin{{tabular}}{{{'l' * keys}{'c' * (len(heads) - keys)}}}",
            r"\hline",
            head,
            r"\hline",
            *lines,
            r"\hline",
            r"\end{tabular}",
            "",
        ]
    )


def _draw(spec: StudySpec, rows: Sequence[Row], path: Path) -> None:
    """Plot a bar with an interval for each world in each row."""
    figure, (ax,) = plain_figure(9.0, 1.3 + 0.34 * len(rows), (1,), grid="x")
    height = 0.8 / len(spec.tests)
    for number, (world, ink) in enumerate(
        zip(spec.tests, (ACCENT, SECOND, SOFT, INK), strict=False)
    ):
        measured = [(i, row) for i, row in enumerate(rows) if world in row]
        place = [i + (number - (len(spec.tests) - 1) / 2) * height for i, _ in measured]
        value = [float(row[world]) for _, row in measured]
        ax.barh(place, value, height=0.9 * height, color=ink, label=world)
        low = [max(0.0, float(row[world]) - float(row[f"{world}_low"])) for _, row in measured]
        high = [max(0.0, float(row[f"{world}_high"]) - float(row[world])) for _, row in measured]
        if measured and not any(map(math.isnan, low + high)):
            ax.errorbar(value, place, xerr=[low, high], fmt="none", ecolor=INK, lw=0.8, capsize=2)
    keys = _keys(rows)
    names = [" ".join(str(row[key]) for key in keys) for row in rows]
    ax.set_yticks(range(len(rows)), names, fontsize=7)
    ax.invert_yaxis()
    ax.set_xlim(0, 1)
    legend_below(ax, columns=4)
    caption(ax, spec.title, "AP50, with 95 % intervals over scenes")
    save_png(figure, path, dpi=110)
