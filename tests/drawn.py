"""Figures looked at before they become pixels: what was drawn, by the titles of their axes."""

from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree


@contextmanager
def figures_of(module):
    """The figures that a module writes meanwhile, in order; their files are written, too."""
    figures, write = [], module.save_png

    def save(figure, path, *, dpi):
        figures.append(figure)
        write(figure, path, dpi=dpi)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "save_png", save)
        yield figures


@contextmanager
def no_pixels():
    """Figures are made, and one black pixel is written: for tests of the files beside pictures."""

    def write(figure, file, **how):
        Image.new("L", (1, 1)).save(file, format="PNG")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", write)
        yield


def axes_of(figure):
    """The axes of a figure that have a title, by it."""
    titled = {ax.get_title(loc="left") or ax.get_title(): ax for ax in figure.axes}
    titled.pop("", None)
    return titled


def lines_of(ax):
    """(x, y) of each line with markers, as numbers."""
    lines = (line for line in ax.lines if line.get_marker() not in ("None", "", None))
    return [tuple(np.array(values, float) for values in line.get_data()) for line in lines]


def points_of(ax):
    """The points of all lines with markers, sorted; those without a number left out."""
    points = np.concatenate([np.column_stack(line) for line in lines_of(ax)])
    return np.array(sorted(points[np.isfinite(points).all(axis=1)].tolist()))


def heights_of(ax):
    """Of bars that stand."""
    return [bar.get_height() for bar in ax.patches]


def shares_of(picture, name, *, within=1e-3):
    """What share of a colour map's range each pixel of its RGB picture stands for; NaN for none."""
    table = colormaps[name](np.arange(256))[:, :3]
    distance, index = cKDTree(table).query(np.asarray(picture, float)[..., :3])
    return np.where(distance < within, index / 255, np.nan)
