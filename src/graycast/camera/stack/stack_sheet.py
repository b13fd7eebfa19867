"""The preview of a decoded stack: one sheet with its picture, code maps, reasons and depth."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure

from ...base.plotting import save_png
from ..decode import Reason
from .decoding import StackResult

DPI, TILE_PX = 100, 700
_GAP_PX, _ABOVE_PX, _BELOW_PX = 30, 40, 84  # The space below a tile has a colour bar or a legend.
_UNKNOWN = (0.20, 0.20, 0.22)
_PERCENTILES = (1, 99)  # The colour scale of depth extends between these percentiles.
_LEAST_P = 1e-4  # Smaller probabilities have the colour of this one.

Paint = Callable[[Axes], None]


def draw_sheet(result: StackResult, path: Path) -> None:
    """Draw picture, code maps, reasons and depth on a sheet of equal tiles."""
    height, width = result.codes.reason.shape
    tiles = dict(_tiles(result, max(1, round(width / 1000))))
    columns = 2 if len(tiles) == 4 else 3
    rows = -(-len(tiles) // columns)
    tile_px = (TILE_PX, round(TILE_PX * height / width))
    step_px = (tile_px[0] + _GAP_PX, _ABOVE_PX + tile_px[1] + _BELOW_PX)
    size_px = (_GAP_PX + columns * step_px[0], rows * step_px[1])
    figure = Figure(figsize=(size_px[0] / DPI, size_px[1] / DPI), dpi=DPI)
    for k, (title, paint) in enumerate(tiles.items()):
        row, column = divmod(k, columns)
        left = _GAP_PX + column * step_px[0]
        bottom = size_px[1] - row * step_px[1] - _ABOVE_PX - tile_px[1]
        place = np.array([left, bottom, *tile_px]) / (*size_px, *size_px)
        ax = figure.add_axes((place[0], place[1], place[2], place[3]))
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        ax.set_title(title, loc="left", fontsize=12, weight="bold")
        paint(ax)
    save_png(figure, path, dpi=DPI)


def _tiles(result: StackResult, step: int) -> Iterator[tuple[str, Paint]]:
    """Yield titles and paint functions of the tiles: three, four or six, which fill their rows.

    If both axes are coded, the probability that a depth is wrong takes the place of the noise.
    """
    yield "picture", lambda ax: _show(ax, result.picture[::step, ::step])
    for axis in result.code.axes:
        position = result.codes.column if axis == "column" else result.codes.row
        limits = (0.0, result.code.size_px(axis) - 1.0)
        name, label = f"decoded {axis}", f"projector {axis} [px]"
        yield name, partial(_draw_map, position[::step, ::step], "viridis", limits, label)
    yield "reasons", lambda ax: _draw_reasons(ax, result, step)
    if result.depth is None:
        return
    depth_mm = 1e3 * result.depth.depth_m[::step, ::step]
    limits = _limits(depth_mm)
    yield "depth", partial(_draw_map, depth_mm, "viridis_r", limits, "depth [mm]")
    p_wrong, both = result.p_wrong, len(result.code.axes) == 2
    if both == (p_wrong is None):
        sigma_mm = 1e3 * result.depth.sigma_m[::step, ::step]
        limits, label = (0.0, _limits(sigma_mm)[1]), "standard deviation of the depth [mm]"
        yield "noise of the depth", partial(_draw_map, sigma_mm, "magma", limits, label)
    if p_wrong is not None:
        yield "doubt of the depth", partial(_draw_doubt, p_wrong[::step, ::step])


def _limits(values: Float[np.ndarray, "h w"]) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, _PERCENTILES)
    return float(low), float(high)


def _show(ax: Axes, image: np.ndarray) -> None:
    ax.imshow(image, aspect="auto")


def _draw_map(
    values: Float[np.ndarray, "h w"], name: str, limits: tuple[float, float], label: str, ax: Axes
) -> None:
    low, high = limits
    share = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    image = colormaps[name](np.nan_to_num(share))[..., :3]
    image[np.isnan(values)] = _UNKNOWN
    _show(ax, image)
    _draw_bar(ax, ScalarMappable(Normalize(low, high), colormaps[name]), label)


def _draw_doubt(p_wrong: Float[np.ndarray, "h w"], ax: Axes) -> None:
    """Draw the probability that a depth is wrong, in logarithmic steps from 1e-4 to 1."""
    scale = ScalarMappable(LogNorm(_LEAST_P, 1.0), colormaps["magma"])
    image = scale.to_rgba(np.nan_to_num(p_wrong, nan=1.0).clip(_LEAST_P, 1.0))[..., :3]
    image[np.isnan(p_wrong)] = _UNKNOWN
    _show(ax, image)
    _draw_bar(ax, scale, "probability that the depth is wrong")


def _draw_bar(ax: Axes, scale: ScalarMappable, label: str) -> None:
    height_px = ax.bbox.height
    bar = ax.inset_axes((0.0, -20 / height_px, 0.55, 12 / height_px))
    ax.figure.colorbar(scale, cax=bar, orientation="horizontal")
    bar.tick_params(labelsize=9, length=2, pad=2)
    bar.annotate(label, (1, 0.5), (14, 0), xycoords="axes fraction",
                 textcoords="offset pixels", va="center", fontsize=10)  # fmt: skip


def _draw_reasons(ax: Axes, result: StackResult, step: int) -> None:
    """Draw the reasons with their shares of the lit pixels, because a far background is not lit."""
    reason = (result.codes if result.depth is None else result.depth).reason
    palette = np.array([to_rgb(kind.color) for kind in Reason])
    _show(ax, palette[reason[::step, ::step]])
    lit = reason != Reason.SHADOW
    for kind in Reason:
        if not (reason == kind).any():
            continue
        words = f"{kind.words} {100 * (reason[lit] == kind).mean() if lit.any() else 0:.1f} %"
        if kind is Reason.SHADOW:
            words = f"not lit: shadow or empty, {100 * (~lit).mean():.1f} % of the picture"
        ax.plot([], [], "s", color=kind.color, mec="0.4", ms=8, label=words)
    title = "shares of the lit pixels; meanings: docs/reference/glossary.md"
    ax.legend(title=title, title_fontsize=9, alignment="left",
              loc="upper left", bbox_to_anchor=(-0.01, -0.005), ncols=3, fontsize=9,
              frameon=False, borderpad=0.3, handletextpad=0.2, columnspacing=1.2,
              borderaxespad=0.1)  # fmt: skip
