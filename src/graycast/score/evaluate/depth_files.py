"""The scanner's depth by angle of incidence as files: JSON, CSV, Markdown and a plot."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...base.errors import GraycastError
from ...base.plotting import ACCENT, INK, SECOND, SOFT, caption, plain_figure, save_png
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.tables import csv_text, markdown_table
from ...dataset.json_text import plain
from ...dataset.scene_content import SceneContent, scene_content
from ...dataset.stored import open_dataset
from .depth import ANGLE_EDGES_DEG, EDGE, DepthRow, depth_rows

DEPTH = "depth.json"
_COLUMNS = (
    "of", "angle", "pixels", "decoded", "bias_mm", "sigma_mm", "rms_mm", "beyond_1mm", "beyond_5mm"
)  # fmt: skip

Tables = Mapping[str, Sequence[DepthRow]]


def evaluate_depth(
    dataset: Path, *, progress: ProgressMeter = UNWATCHED
) -> dict[str, list[DepthRow]]:
    """Rows over all pixels (`all`) and over the parts (`parts`) of all images of a dataset.

    Raises:
        DatasetError: the dataset cannot be read.
        GraycastError: it does not hold both depths.
    """
    stored = open_dataset(dataset)
    if lacks := sorted({"depth", "depth_sl"} - stored.holds):
        raise GraycastError(
            f"{dataset}: has no {' and no '.join(lacks)}: the scanner's depth is compared with "
            "perfect depth, so give a simulated dataset"
        )

    def read(pass_: int) -> Iterable[SceneContent]:
        pictures = stored.pictures
        for done, picture in enumerate(pictures, start=1):
            yield scene_content(picture)
            progress.count("scenes", pass_ * len(pictures) + done, 2 * len(pictures))

    return {"all": depth_rows(read(0)), "parts": depth_rows(read(1), parts_only=True)}


def write_depth(tables: Tables, folder: Path, *, colors: Mapping[str, str]) -> None:
    """Fill a folder with `depth.json`, `depth.csv`, `depth.md` and `depth.png`.

    Args:
        colors: of the reasons, in the order in which they are listed.

    Raises:
        GraycastError: the folder cannot be written.
    """
    content = plain({name: [asdict(row) for row in rows] for name, rows in tables.items()})
    text = json.dumps(content, indent=1, allow_nan=False)
    (folder / DEPTH).write_text(text + "\n", encoding="utf-8")
    reasons = _reasons(tables, colors)
    table = csv_text(
        [*_COLUMNS, *reasons],
        (
            [name, row.name, row.pixels, *_figures(row, reasons)]
            for name, rows in tables.items()
            for row in rows
        ),
    )
    (folder / "depth.csv").write_text(table, encoding="utf-8")
    (folder / "depth.md").write_text(depth_markdown(tables), encoding="utf-8")
    _draw(tables, {name: colors.get(name, SOFT) for name in reasons}, folder / "depth.png")


def depth_markdown(tables: Tables) -> str:
    """A table for all pixels and one for the parts; rows without pixels are left out."""
    texts = ["# The scanner's depth against perfect depth, by angle of incidence"]
    heads = ["angle", "pixels", "decoded", "bias", "sigma", "> 1 mm", "> 5 mm", "holes"]
    for name, rows in tables.items():
        texts.append(f"## {'All pixels' if name == 'all' else 'Parts'}")
        texts.append(markdown_table(heads, [_cells(row) for row in rows if row.pixels]))
    return "\n\n".join(texts) + "\n"


def _cells(row: DepthRow) -> list[str]:
    error = ["none"] * 4
    if (e := row.error).pixels:
        error = [f"{e.median_mm:+.3f} mm", f"{e.sigma_mm:.3f} mm"]
        error += [f"{e.beyond_1mm:.2%}", f"{e.beyond_5mm:.2%}"]
    holes = sorted(
        ((share, reason) for reason, share in row.reason.items() if reason != "decoded"),
        reverse=True,
    )
    shares = ", ".join(f"{r.replace('_', ' ')} {s:.1%}" for s, r in holes if s >= 0.001)
    return [row.name, str(row.pixels), f"{row.reason.get('decoded', 0.0):.1%}", *error, shares]


def _figures(row: DepthRow, reasons: Sequence[str]) -> list[str]:
    e = row.error
    error = (e.median_mm, e.sigma_mm, e.rms_mm, e.beyond_1mm, e.beyond_5mm)
    decoded = row.reason.get("decoded", 0.0)
    holes = [row.reason.get(name, 0.0) for name in reasons]
    return ["" if np.isnan(value) else f"{value:.6f}" for value in (decoded, *error, *holes)]


def _reasons(tables: Tables, order: Iterable[str]) -> list[str]:
    """The reasons that occur, in the given order; others come last."""
    reasons_there = {name for rows in tables.values() for row in rows for name in row.reason}
    first = [name for name in order if name in reasons_there and name != "decoded"]
    return first + sorted(reasons_there - {"decoded", *first})


def _draw(tables: Tables, colors: Mapping[str, str], path: Path) -> None:
    figure, axes = plain_figure(13.2, 3.8, (1, 1, 1, 1))
    for (name, rows), color in zip(tables.items(), (ACCENT, SECOND), strict=True):
        known = [k for k in range(EDGE) if rows[k].error.pixels]
        angle = [sum(ANGLE_EDGES_DEG[k : k + 2]) / 2 for k in known]
        bias = [rows[k].error.median_mm for k in known]
        sigma = [rows[k].error.sigma_mm for k in known]
        axes[0].plot(angle, bias, "o-", ms=3, color=color, label=f"{name}: bias")
        axes[0].plot(angle, sigma, "s--", ms=3, color=color, label=f"{name}: sigma")
        spikes = [100 * rows[k].error.beyond_5mm for k in known]
        axes[1].plot(angle, spikes, "o-", ms=3, color=color, label=name)
    axes[0].set_yscale("symlog", linthresh=1.0)
    caption(axes[0], "Scanner less perfect depth", "angle of incidence [deg]", "[mm]")
    caption(axes[1], "Spikes beyond 5 mm", "angle of incidence [deg]", "of the decoded pixels [%]")
    for ax in axes[:2]:
        ax.legend(fontsize=7, frameon=False)
    for ax, (name, rows) in zip(axes[2:], tables.items(), strict=True):
        _holes(ax, rows, colors)
        caption(ax, f"Holes, {name}", "angle of incidence [deg]", "of the pixels [%]")
    save_png(figure, path, dpi=120)


def _holes(ax: Axes, rows: Sequence[DepthRow], colors: Mapping[str, str]) -> None:
    at = np.arange(len(rows))
    base = np.zeros(len(rows))
    for name, color in colors.items():
        share = 100 * np.array([row.reason.get(name, 0.0) for row in rows])
        ax.bar(at, share, 0.9, bottom=base, color=color, label=name.replace("_", " "))
        base = base + share
    names = [row.name.removesuffix(" deg").replace(" to ", "-") for row in rows]
    ax.set_xticks(at, names, fontsize=6, rotation=45, color=INK)
    ax.set_ylim(0, 100)
    ax.legend(fontsize=6, frameon=False)
