"""Table of a two-sample test, and picture of the squares that distinguish the sets."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ...base.plotting import save_png
from ...base.tables import markdown_table
from .patches import PARABOLOID, SQUARE_PX, Squares
from .scan import DepthScan
from .two_sample import PLACES, Auc, TwoSample

CLASSIFIER = "classifier.md"
_COLUMNS = 8  # number of squares in each row of the picture
_RELIEF_MM = 0.8  # range of heights from black to white
_PLACE = {"smooth": "smooth places", "floor": "floor"}


def two_sample_table(test: TwoSample) -> str:
    """Return the results as a Markdown table, which is also readable as plain text."""
    first, second = test.names
    rows = [
        [f"{first} against {name}", _PLACE[place], *_cells(auc[place])]
        for place in PLACES
        for name, auc in ((second, test.auc), ("itself", test.itself))
    ]
    table = markdown_table(["sets", "place", "AUC", "squares"], rows)
    return (
        f"AUC is 0.5 if a classifier cannot distinguish the sets, 1 if it always can.\n\n{table}\n"
    )


def _cells(auc: Auc) -> tuple[str, str]:
    mean = "-" if auc.mean is None else f"{auc.mean:.2f} ± {auc.spread:.2f}"
    return mean, f"{auc.squares[0]}, {auc.squares[1]}"


def write_two_sample(
    test: TwoSample, first: Sequence[DepthScan], second: Sequence[DepthScan], folder: Path
) -> None:
    """Write the table to `classifier.md`, and a picture of squares to `classifier.png`.

    The picture shows squares as relief over a fitted paraboloid, with holes in red. Its rows have
    the squares of each set that the classifier classifies with most certainty, and the squares of
    the second set that it most often assigns to the first.

    Raises:
        GraycastError: a file cannot be written.
    """
    (folder / CLASSIFIER).write_text(two_sample_table(test), encoding="utf-8")
    rows = []
    for place in PLACES:
        a, b = (squares.at(place) for squares in test.squares)
        of_first, of_second = test.score[place]
        rows += [
            (f"{_PLACE[place]}: first set, most certain", a, first, _best(-of_first)),
            (f"{_PLACE[place]}: second set, most certain", b, second, _best(of_second)),
            (f"{_PLACE[place]}: second set, taken for the first", b, second, _best(-of_second)),
        ]
    figure = Figure(figsize=(1.6 * _COLUMNS, 1.9 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), _COLUMNS, squeeze=False)
    for line, (name, squares, scans, order) in zip(axes, rows, strict=True):
        for ax in line:
            ax.set_axis_off()
        for ax, k in zip(line, order, strict=False):
            ax.imshow(_relief(squares, k, scans))
        line[0].set_title(name, loc="left", fontsize=9)
    figure.suptitle(f"±{_RELIEF_MM / 2:g} mm from dark to bright, holes red")
    save_png(figure, folder / "classifier.png", dpi=90)


def _best(score: Float[np.ndarray, " n"]) -> list[int]:
    """Return the indices of the highest scores; NaN is left out."""
    order = np.argsort(np.where(np.isnan(score), -np.inf, score))[::-1]
    return [int(k) for k in order[:_COLUMNS] if not np.isnan(score[k])]


def _relief(squares: Squares, k: int, scans: Sequence[DepthScan]) -> Float[np.ndarray, "s s 3"]:
    y, x = squares.corner_px[k]
    z_m = scans[int(squares.scan[k])].depth_m[y : y + SQUARE_PX, x : x + SQUARE_PX]
    known = ~np.isnan(z_m)
    rest_m = np.where(known, z_m, 0.0)
    fit = np.linalg.lstsq(PARABOLOID[known], rest_m[known], rcond=None)[0]
    rest_m = rest_m - PARABOLOID @ fit
    rest_m -= np.median(rest_m[known])
    grey = np.clip(0.5 + 1e3 * rest_m / _RELIEF_MM, 0, 1)
    return np.where(known[..., None], grey[..., None], np.array([0.8, 0.1, 0.1]))
