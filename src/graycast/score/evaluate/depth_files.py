"""The scanner's depth by angle of incidence as files: JSON, CSV, Markdown and a plot."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ...base.errors import GraycastError
from ...base.plotting import ACCENT, INK, SECOND, SOFT, caption, plain_figure, save_png
from ...base.progress import UNWATCHED, ProgressMeter
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
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow([*_COLUMNS, *reasons])
    for name, rows in tables.items():
        for row in rows:
            writer.writerow([name, row.name, row.pixels, *_figures(row, reasons)])
    (folder / "depth.csv").write_text(table.getvalue(), encoding="utf-8")
    (folder / "depth.md").write_text(depth_markdown(tables), encoding="utf-8")
    _draw(tables, {name: colors.get(name, SOFT) for name in reasons}, folder / "depth.png")


def depth_markdown(tables: Tables) -> str:
    """A table for all pixels and one for the parts; rows without pixels are left out."""
    lines = ["# The scanner's depth against perfect depth, by angle of incidence"]
    for name, rows in tables.items():
        lines += ["", f"## {'All pixels' if name == 'all' else 'Parts'}", ""]
        lines.append("| angle | pixels | decoded | bias | sigma | > 1 mm | > 5 mm | holes |")
        lines.append("|---|---|---|---|---|---|---|---|")
        for row in rows:
            if not row.pixels:
                continue
            e = row.error
            holes = sorted(
                ((share, reason) for reason, share in row.reason.items() if reason != "decoded"),
                reverse=True,
            )
            shares = ", ".join(f"{r.replace('_', ' ')} {s:.1%}" for s, r in holes if s >= 0.001)
            error = "| none | none | none | none |"
            if e.pixels:
                error = (
                    f"| {e.median_mm:+.3f} mm | {e.sigma_mm:.3f} mm | {e.beyond_1mm:.2%} "
                    f"| {e.beyond_5mm:.2%} |"
                )
            decoded = row.reason.get("decoded", 0.0)
            lines.append(f"| {row.name} | {row.pixels} | {decoded:.1%} {error} {shares} |")
    return "\n".join(lines) + "\n"


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
