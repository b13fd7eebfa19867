"""The common style of all plots, and a function that writes them to a file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox, ScaledTranslation

from .folder import fill_whole

INK, ACCENT, SECOND, SOFT, PALE = "#1f2933", "#0b6e99", "#c4622d", "#9aa5b1", "#e4e7eb"


# Offsets [pt] of a name from its point, the best offset first.
_SIDES = tuple(
    ((x, y), side)
    for y in (-10, 6, -20, 16, -30, 26)
    for x, side in ((6, "left"), (-6, "right"), (0, "center"))
)
_BELOW_IN = 0.48  # Ticks and the label of an axis need this distance below it.

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
    """Show two pale spines, small ticks, and a pale grid behind the plotted data."""
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


def _figure_of(ax: Axes) -> Figure:
    """Return the figure to which axes belong; the axes must not have been removed from it."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure


def legend_below(ax: Axes, *, columns: int, title: str = "") -> None:
    """Draw the legend below the axes and their label, where no plotted line can cross it."""
    place = ScaledTranslation(0, -_BELOW_IN, _figure_of(ax).dpi_scale_trans)
    ax.legend(
        loc="upper left",
        bbox_to_anchor=(0.0, 0.0),
        bbox_transform=ax.transAxes + place,
        borderaxespad=0.0,
        ncols=columns,
        fontsize=7,
        title=title or None,
        title_fontsize=7,
        alignment="left",
        frameon=False,
    )


def write_names(
    ax: Axes,
    names: Sequence[str],
    points: Float[np.ndarray, "n 2"],
    colors: Sequence[str],
) -> None:
    """Write names next to data points without overlaps; earlier names have priority.

    A name is left out if there is no room on any side of its point, or if the point is not finite.
    The limits of the axes must be final.
    """
    taken: list[Bbox] = []
    _figure_of(ax).draw_without_rendering()
    dots = ax.transData.transform(points)
    for name, point, dot, color in zip(names, points, dots, colors, strict=True):
        for shift, side in _SIDES if np.isfinite(point).all() else ():
            text = ax.annotate(
                name, point, shift, textcoords="offset points", ha=side, fontsize=7, color=color
            )
            box = text.get_window_extent()
            inside = ax.bbox.x0 <= box.x0 and box.x1 <= ax.bbox.x1 and box.y0 >= ax.bbox.y0
            others = (other for other in dots if other is not dot)
            if inside and not any(box.overlaps(one) for one in taken):
                if not any(box.contains(*other) for other in others):
                    taken.append(box)
                    break
            text.remove()


def save_png(figure: Figure, path: Path, *, dpi: int) -> None:
    """Write a figure as PNG under a temporary name and rename it, so it is never incomplete.

    Raises:
        GraycastError: the folder is missing or the disk refuses.
    """
    fill_whole(
        path,
        lambda file: figure.savefig(file, dpi=dpi, format="png", metadata={"Software": None}),
    )
