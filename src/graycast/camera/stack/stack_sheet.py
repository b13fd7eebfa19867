"""The preview of a decoded stack: one sheet of its picture, code maps, reasons and depth."""

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ...base.plotting import save_png
from ..decode import Reason
from .decoding import StackResult

DPI, TILE_IN = 100, 7.0
_UNKNOWN = (0.20, 0.20, 0.22)


def draw_sheet(result: StackResult, path: Path) -> None:
    """Picture, code maps, reasons and depth side by side."""
    height, width = result.codes.reason.shape
    step = max(1, round(width / 1000))
    tiles: list[tuple[str, np.ndarray | None, tuple[float, float] | None]] = [
        ("picture", None, None)
    ]
    for axis in result.code.axes:
        position = result.codes.column if axis == "column" else result.codes.row
        tiles.append((f"decoded {axis}", position, (0.0, result.code.size_px(axis) - 1.0)))
    tiles.append(("reasons", None, None))
    if result.depth is not None:
        tiles.append(("depth [m]", result.depth.depth_m, None))
    rows = -(-len(tiles) // 2)
    tile_in = (TILE_IN, TILE_IN * height / width + 0.9)
    layout = ConstrainedLayoutEngine(h_pad=0.15, w_pad=0.1)
    figure = Figure(figsize=(2 * tile_in[0], rows * tile_in[1]), dpi=DPI, layout=layout)
    grid = figure.subplots(rows, 2, squeeze=False).ravel()
    for ax in grid:
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
    for ax, (title, values, limits) in zip(grid, tiles, strict=False):
        ax.set_title(title, loc="left", fontsize=12, weight="bold")
        if values is not None:
            _draw_map(figure, ax, values[::step, ::step], limits)
        elif title == "picture":
            ax.imshow(result.picture[::step, ::step])
        else:
            _draw_reasons(ax, result, step)
    save_png(figure, path, dpi=DPI)


def _draw_map(figure: Figure, ax, values, limits) -> None:
    name = "viridis" if limits is not None else "viridis_r"
    if limits is None:
        known = values[np.isfinite(values)]
        limits = tuple(np.percentile(known, (1, 99))) if known.size else (0.0, 1.0)
    low, high = limits
    share = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    image = colormaps[name](np.nan_to_num(share))[..., :3]
    image[np.isnan(values)] = _UNKNOWN
    ax.imshow(image)
    bar = ScalarMappable(Normalize(low, high), colormaps[name])
    figure.colorbar(bar, ax=ax, orientation="horizontal", shrink=0.6, aspect=40, pad=0.02)


def _draw_reasons(ax, result: StackResult, step: int) -> None:
    reason = (result.codes if result.depth is None else result.depth).reason
    palette = np.array([to_rgb(kind.color) for kind in Reason])
    ax.imshow(palette[reason[::step, ::step]])
    for kind in Reason:
        share = 100 * (reason == kind).mean()
        if share:
            words = f"{kind.words} {share:.1f} %"
            ax.plot([], [], "s", color=kind.color, mec="0.4", ms=8, label=words)
    ax.legend(title="meanings: docs/reference/glossary.md", title_fontsize=9, alignment="left",
              loc="upper left", bbox_to_anchor=(0, -0.01), ncols=3, fontsize=9,
              frameon=False)  # fmt: skip
