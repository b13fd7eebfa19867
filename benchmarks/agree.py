"""Agreement of two renderers on the same scenes, for docs/measurements/renderers.md.

Both get the same layouts, patterns, path depth and, for decoding, one exposure of a sensor without
noise. Mitsuba renders without its footprint filter, which would add a bias that Cycles does not
have. The renderers then differ only in light transport and Monte Carlo noise, which is common to
all patterns in Mitsuba and independent in each frame of Cycles. Noise widens the distribution of
the ratios of single pixels but does not move their median. In dark areas, noise decides which
pixels can be decoded. The first renderer is fast and therefore uses many more samples. It is also
compared with itself at the second renderer's number of samples, which shows the effect of noise
alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from graycast.base.errors import GraycastError
from graycast.camera.scanner import Scan, scan
from graycast.cell.resolve import Cell
from graycast.rendering import Quality, Renderer, Rendering
from graycast.world.scene import Layout

from .cells import dropped, exposed_alike, materials_cell, opened
from .decoded import valid
from .figures import Figures, Show

SCENES, SIZE_PX = 5, (172, 130)
EACH = 3  # parts of each material in a scene
FIRST_FACTOR = 8  # The first rendering takes this many times the samples of the second.
FEWER_SEED = 10_000  # This offset keeps seeds different from the seeds of the scenes.
BOX = "bin"  # the class of pixels without a part
LIT_SHARE = 0.02  # Ratios are computed where the light is above this share of its 99th percentile.
RATIO_EDGES = np.linspace(0.8, 1.2, 81)
COLUMN_EDGES = np.linspace(-1.0, 1.0, 81)

# Limits of agreement: medians of the ratio of the white frames, and of decoded depth.
MEDIAN_RATIO = {"diffuse": (0.98, 1.02), "metal": (0.95, 1.05), "plastic": (0.95, 1.05)}
MEDIAN_COLUMNS = 0.25
VALID_ALIKE_SHARE = 0.97


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """The rendering of a scene by one renderer, and its scan."""

    rendering: Rendering
    scan: Scan


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """One scene rendered by both renderers; `kind` is the class of each pixel, with `BOX` last.

    `fewer` is the view of the first renderer at the number of samples of the second.
    """

    first: View
    second: View
    fewer: View
    kind: Int[np.ndarray, "h w"]


def measure(*, samples: int, show: Show) -> Figures:
    with opened(1) as (mitsuba, cycles):
        return study(mitsuba, cycles, scenes=SCENES, samples=samples, size_px=SIZE_PX, show=show)


def study(
    first: Renderer,
    second: Renderer,
    *,
    scenes: int,
    samples: int,
    size_px: tuple[int, int],
    show: Show,
) -> Figures:
    """Render and decode the scenes with both renderers, and compare the results.

    Args:
        second: ratios are the light of this renderer divided by that of the first.
        samples: number of samples of the second renderer.
        size_px: width and height of the central part of the camera's picture that is rendered.

    Raises:
        GraycastError: no pixel could be decoded in both pictures.
    """
    cell = materials_cell(size_px)
    quality = Quality(samples=samples, footprint=False)
    pairs = []
    for seed in range(scenes):
        show(f"scene {seed + 1} of {scenes}")
        layout = dropped(cell, EACH, seed=seed)
        pairs.append(_pair(cell, layout, first, second, quality, seed))
    return {
        "first": first.name,
        "second": second.name,
        "devices": {one.name: one.device for one in (first, second)},
        "scenes": scenes,
        "samples": samples,
        "first_samples": FIRST_FACTOR * samples,
        "width_px": size_px[0],
        "height_px": size_px[1],
        "patterns": len(cell.code.frames),
        **compare(pairs, tuple(part.name for part in cell.scene.parts)),
    }


def _pair(
    cell: Cell, layout: Layout, first: Renderer, second: Renderer, quality: Quality, seed: int
) -> Pair:
    more = replace(quality, samples=FIRST_FACTOR * quality.samples)
    plans = ((first, more, seed), (second, quality, seed), (first, quality, seed + FEWER_SEED))
    renderings = [
        one.render(cell.scene, layout, cell.patterns(), quality=each, seed=own)
        for one, each, own in plans
    ]
    scanner = exposed_alike(cell.scanner, renderings[0].radiance)
    views = [
        View(rendering=rendering, scan=scan(scanner, rendering.radiance, seed=0))
        for rendering in renderings
    ]
    instance = renderings[0].truth.instance
    kind = np.where(instance < 0, len(cell.scene.parts), layout.part_index[instance])
    return Pair(first=views[0], second=views[1], fewer=views[2], kind=kind)


def compare(pairs: Sequence[Pair], names: tuple[str, ...]) -> Figures:
    """Return the results for pairs of views; `names` are the names of the classes of parts."""
    rows, histograms = [], {"ratio_edges": RATIO_EDGES.tolist()}
    for light in ("white", "ambient"):
        for index, name in enumerate((*names, BOX)):
            one, other = _lit(pairs, light, index)
            if len(one):
                rows.append({"light": light, "class": name} | _ratios(one, other))
                counts = np.histogram(other / np.maximum(one, 1e-9), RATIO_EDGES)[0]
                histograms[f"{light} {name}"] = counts.tolist()
    depth, columns = _depth(pairs)
    histograms["column_edges"] = COLUMN_EDGES.tolist()
    histograms["columns"] = np.histogram(columns, COLUMN_EDGES)[0].tolist()
    noise, _ = _depth([replace(pair, second=pair.fewer) for pair in pairs])
    figures = {"ratios": rows, "depth": depth, "noise_alone": noise, "truth": _truth(pairs)}
    return figures | {"accepted": _accepted(rows, depth), "histograms": histograms}


def _lit(
    pairs: Sequence[Pair], light: str, kind: int
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the light of both renderers at the pixels of a class whose mean light is high enough.

    The selection uses the mean of both pictures, because the noise of one would bias it.
    """
    lights = []
    for pair in pairs:
        one, other = (
            getattr(view.rendering.radiance, light).astype(np.float64)
            for view in (pair.first, pair.second)
        )
        mean = 0.5 * (one + other)
        enough = (pair.kind == kind) & (mean > LIT_SHARE * np.percentile(mean, 99))
        lights.append((one[enough], other[enough]))
    first, second = (np.concatenate(arrays) for arrays in zip(*lights, strict=True))
    return first, second


def _ratios(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> Figures:
    with np.errstate(divide="ignore"):
        # Interpolation between infinite ratios (pixels without light) would give NaN.
        low, median, high = np.percentile(other / one, [5, 50, 95], method="inverted_cdf")
    return {
        "pixels": len(one),
        "median": float(median),
        "p5": float(low),
        "p95": float(high),
        "of_means": float(other.sum() / one.sum()),
    }


def _depth(pairs: Sequence[Pair]) -> tuple[Figures, Float[np.ndarray, " n"]]:
    """Compare decoded depth, second minus first; return also the differences in columns."""
    columns, depth_mm, alike, only = [], [], [], {"first": 0, "second": 0}
    for pair in pairs:
        one, other = pair.first.scan, pair.second.scan
        first, second = valid(one), valid(other)
        both = first & second
        columns.append((other.codes.column - one.codes.column)[both])
        depth_mm.append(1e3 * (other.depth.depth_m - one.depth.depth_m)[both])
        alike.append(float((first == second).mean()))
        only["first"] += int((first & ~second).sum())
        only["second"] += int((second & ~first).sum())
    off, off_mm = np.concatenate(columns), np.concatenate(depth_mm)
    if not len(off):
        raise GraycastError("no pixel could be decoded in both pictures: use more samples")
    total = sum(pair.kind.size for pair in pairs)
    figures = {
        "median_abs_columns": float(np.median(np.abs(off))),
        "p95_abs_columns": float(np.percentile(np.abs(off), 95)),
        "median_columns": float(np.median(off)),
        "over_one_column_share": float((np.abs(off) > 1).mean()),
        "median_abs_mm": float(np.median(np.abs(off_mm))),
        "valid_alike_share": float(np.mean(alike)),
        "valid_in_first_only": only["first"] / total,
        "valid_in_second_only": only["second"] / total,
        "valid_in_both": len(off) / total,
    }
    return figures, off


def _truth(pairs: Sequence[Pair]) -> Figures:
    """Compare the ground truth of both: instance ids, and depth and normals where ids agree."""
    same, depth_m, cosine = [], [], []
    for pair in pairs:
        one, other = pair.first.rendering.truth, pair.second.rendering.truth
        alike = one.instance == other.instance
        same.append(float(alike.mean()))
        known = alike & np.isfinite(one.depth_m) & np.isfinite(other.depth_m)
        depth_m.append(np.abs(one.depth_m - other.depth_m)[known])
        cosine.append((one.normal * other.normal).sum(axis=-1)[known])
    off_m = np.concatenate(depth_m)
    return {
        "same_instance_share": float(np.mean(same)),
        "median_abs_mm": 1e3 * float(np.median(off_m)),
        "over_a_tenth_mm_share": float((off_m > 1e-4).mean()),
        "normal_over_1_deg_share": float((np.concatenate(cosine) < np.cos(np.pi / 180)).mean()),
    }


def _accepted(rows: list[Figures], depth: Figures) -> Figures:
    """Return whether each result is within its limit."""
    accepted = {}
    for row in rows:
        if row["light"] == "white" and row["class"] in MEDIAN_RATIO:
            low, high = MEDIAN_RATIO[row["class"]]
            accepted[f"{row['class']}_ratio"] = low <= row["median"] <= high
    accepted["depth"] = depth["median_abs_columns"] <= MEDIAN_COLUMNS
    accepted["valid"] = depth["valid_alike_share"] >= VALID_ALIKE_SHARE
    return accepted
