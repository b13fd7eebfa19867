"""The common style of all plots, and how they are written to a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .folder import fill_whole

INK, ACCENT, SECOND, SOFT, PALE = "#1f2933", "#0b6e99", "#c4622d", "#9aa5b1", "#e4e7eb"


Grid = Literal["both", "x", "y"]


def plain_figure(
    width_in: float,
    height_in: float,
    columns: Sequence[float | int],
    *,
    rows: int = 1,
    grid: Grid = "both",
) -> tuple[Figure, list[Axes]]:
    """Return a figure of plain axes, row by row; `columns` are the relative widths in a row."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.subplots(rows, len(columns), width_ratios=columns, squeeze=False).ravel().tolist()
    for ax in axes:
        plain_axes(ax, grid=grid)
    return figure, axes


def plain_axes(ax: Axes, *, grid: Grid = "both") -> None:
    """Show two pale spines, small ticks, and a pale grid behind what is drawn."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(SOFT)
    ax.tick_params(colors=INK, labelsize=8, length=3)
    ax.grid(axis=grid, color=PALE, lw=0.6)
    ax.set_axisbelow(True)


def caption(ax: Axes, title: str, x: str, y: str = "") -> None:
    """Set a title at the left, and the labels of both axes."""
    ax.set_title(title, loc="left", fontsize=9, color=INK, fontweight="bold")
    ax.set_xlabel(x, fontsize=8, color=INK)
    ax.set_ylabel(y, fontsize=8, color=INK)


def save_png(figure: Figure, path: Path, *, dpi: int) -> None:
    """Write a figure as PNG under a temporary name and rename it, so it is never incomplete.

    Raises:
        GraycastError: the folder is missing or the disk refuses.
    """
    fill_whole(
        path,
        lambda file: figure.savefig(file, dpi=dpi, format="png", metadata={"Software": None}),
    )
