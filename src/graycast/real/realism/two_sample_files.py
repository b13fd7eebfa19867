"""The two-sample test as a table, as JSON, and as pictures of the squares that gave a set away."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ...base.plotting import save_png
from ...base.tables import markdown_table
from .patches import GROUPS, PARABOLOID, SQUARE_PX, Squares
from .scan import DepthScan
from .two_sample import PLACES, TwoSample

CLASSIFIER = "classifier.md"
_COLUMNS = 8  # A row of the picture has this many squares of one set.
_RELIEF_MM = 0.8  # It goes from black to white.
_PLACE = {"smooth": "smooth places", "floor": "floor"}


def two_sample_table(test: TwoSample) -> str:
    """Return the table in Markdown, which reads as plain text, too."""
    lines = []
    for place in PLACES:
        rows = []
        for name, places in test.row.items():
            aucs = [places[place][group] for group in GROUPS]
            cells = ["-" if a.mean is None else f"{a.mean:.2f} ± {a.spread:.2f}" for a in aucs]
            first, second = places[place]["sensor"].squares
            rows.append([name, *cells, f"{first}, {second}"])
        lines += [
            f"AUC on {_PLACE[place]} (0.5: the sets cannot be distinguished; 1: they are always "
            "distinguished)",
            "",
            markdown_table(["sets", *GROUPS, "squares"], rows),
            "",
        ]
        if telling := test.telling[place][:5]:
            lines += [f"What tells them apart on {_PLACE[place]}, each feature alone:", ""]
            lines += [
                f"- {one.feature}: AUC {one.auc:.2f}, median {one.median[0]:.3g} of the first "
                f"set, {one.median[1]:.3g} of the second"
                for one in telling
            ]
            lines.append("")
    return "\n".join(lines)


def write_two_sample(
    test: TwoSample, first: Sequence[DepthScan], second: Sequence[DepthScan], folder: Path
) -> None:
    """Write `classifier.md`, `classifier.json` and a picture of each place that has squares.

    Raises:
        GraycastError: a file cannot be written.
    """
    (folder / CLASSIFIER).write_text(two_sample_table(test), encoding="utf-8")
    content = {"auc": test.row, "telling": test.telling}
    text = json.dumps(content, indent=1, default=asdict) + "\n"
    (folder / "classifier.json").write_text(text, encoding="utf-8")
    for place in PLACES:
        if not np.isnan(test.score[place][0]).all() and not np.isnan(test.score[place][1]).all():
            _draw(test, place, first, second, folder / f"gave-away-{place}.png")


def _draw(
    test: TwoSample, place: str, first: Sequence[DepthScan], second: Sequence[DepthScan], path: Path
) -> None:
    """Squares as relief over their own paraboloid, holes in red: the surest of each set, and the
    second set's that pass best."""
    a, b = (squares.at(place) for squares in test.squares)
    of_first, of_second = test.score[place]
    rows = (
        ("first set, most certain", a, first, _best(-of_first)),
        ("second set, most certain", b, second, _best(of_second)),
        ("second set, classified as the first", b, second, _best(-of_second)),
    )
    figure = Figure(figsize=(1.6 * _COLUMNS, 5.6), layout="constrained")
    axes = figure.subplots(len(rows), _COLUMNS, squeeze=False)
    for line, (name, squares, scans, order) in zip(axes, rows, strict=True):
        for ax in line:
            ax.set_axis_off()
        for ax, k in zip(line, order, strict=False):
            ax.imshow(_relief(squares, int(k), scans))
        line[0].set_title(name, loc="left", fontsize=9)
    figure.suptitle(f"{_PLACE[place]}: ±{_RELIEF_MM / 2:g} mm from dark to bright, holes red")
    save_png(figure, path, dpi=90)


def _best(score: Float[np.ndarray, " n"]) -> list[int]:
    """Return the indices of the highest scores, without NaN."""
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
