"""Bias, noise, spikes and holes of the scanner's depth by angle of incidence.

`graycast dataset stats` prints the same figures over all angles and over the parts. The angle is
between the camera's ray and the normal of the perfect surface, which comes from central differences
of the surface's points (exact for planes). A pixel has no such angle if its neighbours are not on
one surface (at a step, a crease, or the border of the picture or of the perfect depth). These
pixels have a separate row.
"""

import itertools
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes

from ...base.errors import GraycastError
from ...base.plotting import (
    ACCENT,
    INK,
    SECOND,
    SOFT,
    caption,
    legend_below,
    plain_figure,
    save_png,
)
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.tables import csv_text, markdown_table
from ...dataset.files.json_text import plain
from ...dataset.read.scene_content import SceneContent, scene_content
from ...dataset.read.stored import open_dataset
from ...dataset.stats.gather import ErrorFigures, error_figures
from ...rig.optics import undistort

ANGLE_EDGES_DEG = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90)
DEPTH = "depth.json"
EDGE = len(ANGLE_EDGES_DEG) - 1  # row of the pixels without an angle
_COLUMNS = (
    "of", "angle", "pixels", "decoded", "bias_mm", "sigma_mm", "rms_mm", "beyond_1mm", "beyond_5mm"
)  # fmt: skip
_KINK = 0.5  # largest distance of a smooth pixel from its neighbours' mean, in pixel spacings


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthRow:
    """Figures of the pixels in a range of angles; all of them have perfect depth.

    Attributes:
        name: name of the range, such as `10 to 20 deg`, or `edges`.
        reason: share of the pixels for each reason; `decoded` is the share with a depth.
        error: errors of the pixels with a depth; errors beyond 1 and 5 mm are spikes.
    """

    name: str
    pixels: int
    reason: dict[str, float]
    error: ErrorFigures


Tables = Mapping[str, Sequence[DepthRow]]


def evaluate_depth(
    dataset: Path, *, progress: ProgressMeter = UNWATCHED
) -> dict[str, list[DepthRow]]:
    """Return depth errors of a dataset over all pixels (`all`) and over the parts (`parts`).

    Raises:
        DatasetError: the dataset cannot be read.
        GraycastError: the dataset does not have both measured and perfect depth.
    """
    stored = open_dataset(dataset)
    if lacks := sorted({"depth", "depth_sl"} - stored.holds):
        raise GraycastError(
            f"{dataset}: has no {' and no '.join(lacks)}: the scanner's depth is compared with "
            "perfect depth, so give a simulated dataset"
        )

    def read() -> Iterator[SceneContent]:
        pictures = stored.pictures
        for done, picture in enumerate(pictures, start=1):
            yield scene_content(picture)
            progress.count("scenes", done, len(pictures))

    return depth_rows(read())


def depth_rows(scenes: Iterable[SceneContent]) -> dict[str, list[DepthRow]]:
    """Return rows for each range of angles and for edges: over all pixels, and over the parts.

    Each scene is read only once.
    """
    everything, parts, scale_mm = _Tally(), _Tally(), 0.0
    for scene in scenes:
        if scene.depth is None or scene.scanner is None:
            continue
        scale_mm = scale_mm or scene.depth_scale_mm
        row = rows_of_pixels(scene)
        everything.add(scene, row, scale_mm)
        parts.add(scene, np.where(scene.label >= 0, row, -1), scale_mm)
    return {"all": everything.rows(scale_mm), "parts": parts.rows(scale_mm)}


def rows_of_pixels(scene: SceneContent) -> Int[np.ndarray, "h w"]:
    """Return the index of each pixel's row; -1 for pixels without perfect depth."""
    assert scene.depth is not None
    angle = incidence_rad(
        np.where(scene.depth > 0, scene.depth * (scene.depth_scale_mm / 1000), np.nan),
        K=np.array(scene.view["cam_K"], float).reshape(3, 3),
        distortion=tuple(scene.view["distortion"]),
    )
    edges = np.radians(ANGLE_EDGES_DEG[1:-1])
    row = np.where(np.isnan(angle), EDGE, np.searchsorted(edges, angle, side="right"))
    return np.where(scene.depth > 0, row, -1)


def incidence_rad(
    depth_m: Float[np.ndarray, "h w"],
    *,
    K: Float[np.ndarray, "3 3"],
    distortion: tuple[float, ...],
) -> Float[np.ndarray, "h w"]:
    """Return the angle between camera ray and surface normal; NaN at edges of the surface.

    Args:
        depth_m: z in the camera frame; NaN without depth.
        K: camera matrix in pixels; the centre of the top-left pixel is (0, 0).
        distortion: OpenCV's coefficients k1, k2, p1, p2, k3.
    """
    y, x = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]].astype(float)
    direction = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]], axis=-1)
    k1, k2, p1, p2, k3 = distortion
    ideal = undistort(direction, (k1, k2, p1, p2, k3))
    ray = np.concatenate([ideal, np.ones((*depth_m.shape, 1))], axis=-1)
    point = _with_border(depth_m[..., None].astype(float) * ray)
    # Vectors from the previous to the next pixel; they are NaN at the border.
    across, down = point[1:-1, 2:] - point[1:-1, :-2], point[2:, 1:-1] - point[:-2, 1:-1]
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs((normal * ray).sum(axis=-1)) / length
    return np.where(_smooth(depth_m, K), np.arccos(np.minimum(cosine, 1.0)), np.nan)


def _smooth(
    depth_m: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"]
) -> Bool[np.ndarray, "h w"]:
    """Return whether each pixel is on one plane with its neighbours (on a plane, 1/z is linear).

    The difference between a pixel's 1/z and the mean of its neighbours is converted to depth. It is
    compared with the spacing of the pixels on a surface that faces the camera, which is z / f.
    """
    inverse = _with_border(1 / depth_m.astype(float))
    middle = inverse[1:-1, 1:-1]
    beside = (inverse[1:-1, :-2] + inverse[1:-1, 2:]) / 2
    above = (inverse[:-2, 1:-1] + inverse[2:, 1:-1]) / 2
    spacing_m = 1 / (middle * K[0, 0]), 1 / (middle * K[1, 1])
    return (np.abs(middle - beside) / middle**2 < _KINK * spacing_m[0]) & (
        np.abs(middle - above) / middle**2 < _KINK * spacing_m[1]
    )


def _with_border(image: Float[np.ndarray, "h w *n"]) -> Float[np.ndarray, "h2 w2 *n"]:
    """Return the image with a border of NaN, one pixel wide."""
    return np.pad(image, ((1, 1), (1, 1), *[(0, 0)] * (image.ndim - 2)), constant_values=np.nan)


class _Tally:
    """Counts of errors (in steps of depth) and of reasons for each row."""

    def __init__(self) -> None:
        self._steps = [Counter[int]() for _ in range(EDGE + 1)]
        self._reasons = [Counter[str]() for _ in range(EDGE + 1)]

    def add(self, scene: SceneContent, row: Int[np.ndarray, "h w"], scale_mm: float) -> None:
        assert scene.depth is not None and scene.scanner is not None
        ratio = scene.depth_scale_mm / scale_mm
        for k in range(EDGE + 1):
            here = row == k
            counts = np.bincount(scene.reason[here], minlength=256)
            self._reasons[k].update({n: int(counts[i]) for i, n in scene.reason_name.items()})
            both = here & (scene.scanner > 0)
            error = scene.scanner[both].astype(np.int64) - scene.depth[both]
            value, times = np.unique(np.rint(error * ratio).astype(np.int64), return_counts=True)
            self._steps[k].update(dict(zip(value.tolist(), times.tolist(), strict=True)))

    def rows(self, scale_mm: float) -> list[DepthRow]:
        names = [f"{low} to {high} deg" for low, high in itertools.pairwise(ANGLE_EDGES_DEG)]
        return [
            DepthRow(
                name=name,
                pixels=reasons.total(),
                reason={
                    n: count / max(reasons.total(), 1) for n, count in reasons.items() if count
                },
                error=error_figures(dict(steps), scale_mm),
            )
            for name, steps, reasons in zip(
                [*names, "edges"], self._steps, self._reasons, strict=True
            )
        ]


# --- files ----------------------------------------------------------------------------------------


def write_depth(tables: Tables, folder: Path, *, colors: Mapping[str, str]) -> None:
    """Write `depth.json`, `depth.csv`, `depth.md` and `depth.png` into a folder.

    Args:
        colors: colour of each reason, in the order of the legend.

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
    """Return Markdown tables for all pixels and for the parts, without rows that have no pixels."""
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
    """Return the reasons that occur: first those in `order`, then the rest."""
    reasons_there = {name for rows in tables.values() for row in rows for name in row.reason}
    first = [name for name in order if name in reasons_there and name != "decoded"]
    return first + sorted(reasons_there - {"decoded", *first})


def _draw(tables: Tables, colors: Mapping[str, str], path: Path) -> None:
    figure, axes = plain_figure(13.2, 4.5, (1, 1, 1, 1))
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
        legend_below(ax, columns=2)
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
    legend_below(ax, columns=2)
