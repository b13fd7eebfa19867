"""Find the axes of figures by their titles, before the figures are rendered."""

from contextlib import contextmanager

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree


@contextmanager
def figures_of(module):
    """Collect the figures that a module writes in this block; their files are written, too."""
    figures, write = [], module.save_png

    def save(figure, path, *, dpi):
        figures.append(figure)
        write(figure, path, dpi=dpi)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "save_png", save)
        yield figures


@contextmanager
def no_pixels():
    """Write one black pixel for each figure, for tests that do not read the pictures."""

    def write(figure, file, **how):
        Image.new("L", (1, 1)).save(file, format="PNG")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", write)
        yield


def axes_of(figure):
    """Return the axes of a figure by title; axes without a title are left out."""
    titled = {ax.get_title(loc="left") or ax.get_title(): ax for ax in figure.axes}
    titled.pop("", None)
    return titled


def lines_of(ax):
    """Return arrays (x, y) for each line that has markers."""
    lines = (line for line in ax.lines if line.get_marker() not in ("None", "", None))
    return [tuple(np.array(values, float) for values in line.get_data()) for line in lines]


def points_of(ax):
    """Return the sorted points of all lines that have markers, without points with NaN."""
    points = np.concatenate([np.column_stack(line) for line in lines_of(ax)])
    return np.array(sorted(points[np.isfinite(points).all(axis=1)].tolist()))


def heights_of(ax):
    """Return the heights of vertical bars."""
    return [bar.get_height() for bar in ax.patches]


def shares_of(picture, name, *, within=1e-3):
    """Return each RGB pixel's position in the colour map, 0 to 1; NaN if it is not in the map."""
    table = colormaps[name](np.arange(256))[:, :3]
    distance, index = cKDTree(table).query(np.asarray(picture, float)[..., :3])
    return np.where(distance < within, index / 255, np.nan)
