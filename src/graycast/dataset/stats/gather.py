"""Add up scenes to the statistics of a dataset, in histograms whose size stays constant."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.progress import UNWATCHED, ProgressMeter
from ...base.spawn import in_order
from ...camera.decode import pooled_shares
from ..read.scene_content import scene_content
from ..read.stored import StoredScene, open_dataset
from ..write.coco import IGNORED_BELOW
from .scene_statistics import DEPTH_BIN_MM, SceneFigures, scene_figures

VISIBILITY_BINS = 20
SIDE_EDGES_PX = 2.0 ** (np.arange(49) / 4)  # These are quarter octaves from 1 to 4096 px.
SMALL_PX2, LARGE_PX2 = 32**2, 96**2  # These limits separate COCO's classes of object area.
_SIDES = len(SIDE_EDGES_PX) - 1
_CLASS_BINS = {"visib_fract": VISIBILITY_BINS, "side_px": _SIDES, "box_px": _SIDES}
_HISTOGRAMS = ("instances", "depth_bin", "error_step", "part_error_step", "gray", "luma")
_QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFigures:
    """Errors of depth (scanner minus perfect) over the pixels that have both [mm].

    `sigma_mm` is half the width of the interval that contains the middle 68.27 % of the errors.
    Outliers change `rms_mm` but hardly `sigma_mm`. All figures are NaN if no pixel has both depths.
    """

    pixels: int
    median_mm: float
    sigma_mm: float
    rms_mm: float
    beyond_1mm: float
    beyond_5mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassFigures:
    """Instances of one object in all pictures; `scenes` counts the pictures that contain any."""

    obj_id: int
    name: str
    scenes: int
    instances: int
    visible: int  # instances of which at least 10 % is visible, as in scores of detectors
    visib_fract: Int[np.ndarray, " bins"]  # a histogram from 0 to 1
    side_px: Int[np.ndarray, " sides"]  # the root of the visible area, in bins of SIDE_EDGES_PX
    box_px: Int[np.ndarray, " sides"]  # the longer side of the visible box


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFigures:
    """Fractions of pixels with scanner depth, over all pictures with the same name."""

    pictures: int
    decoded: float
    part_decoded: float | None  # None if no part is visible


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """The statistics of a dataset. Shares are from 0 to 1; a counter maps a bin to its count."""

    scenes: dict[str, int]  # split: number of scenes
    pictures: int  # A scene may have several; the other figures count pictures.
    of_picture: dict[str, PictureFigures]  # The key is the name of a picture in its scene.
    pixels: int
    part_pixels: int
    sizes_px: dict[tuple[int, int], int]  # (width, height): number of scenes
    depth_scale_mm: float  # Histograms of errors have this step.
    classes: tuple[ClassFigures, ...]
    areas: dict[str, int]  # COCO's class of area: number of visible instances
    instances: dict[int, int]  # instances in a scene: number of scenes
    depth_bin: dict[int, int]
    reason: dict[str, float]  # reason: share of all pixels
    part_reason: dict[str, float]  # reason: share of the parts' visible pixels, if there are any
    decoded_share: Int[np.ndarray, " bins"]  # number of pictures by the parts' decoded share
    error_step: dict[int, int]
    part_error_step: dict[int, int]
    error: ErrorFigures
    part_error: ErrorFigures
    gray: dict[int, int]
    luma: dict[int, int]

    @property
    def depth_quantiles_mm(self) -> dict[str, float]:
        """Quantiles of the perfect depth, accurate to a bin of 10 mm."""
        quantiles = _quantiles(self.depth_bin, _QUANTILES)
        names = [f"p{round(100 * q):02d}" for q in _QUANTILES]
        return {n: (v + 0.5) * DEPTH_BIN_MM for n, v in zip(names, quantiles, strict=True)}


@dataclass(slots=True)
class _Sums:
    """Running totals over the pictures, which `tally` turns into `Statistics`.

    Where a total becomes a field of `Statistics`, it is stored under the name of that field.
    """

    counts: defaultdict[str, Counter] = field(default_factory=lambda: defaultdict(Counter))
    of_picture: defaultdict[str, defaultdict[str, Counter]] = field(
        default_factory=lambda: defaultdict(lambda: defaultdict(Counter))
    )
    of_class: dict[int, dict[str, Any]] = field(default_factory=dict)
    decoded_share: np.ndarray = field(default_factory=lambda: np.zeros(50, dtype=np.int64))
    pictures: int = 0
    pixels: int = 0
    scale_mm: float = 0.0
    last: tuple[str, int] | None = None  # the scene of the last picture


def dataset_statistics(
    dataset: Path,
    *,
    workers: int = 1,
    progress: ProgressMeter = UNWATCHED,
) -> Statistics:
    """Read each scene once and return the statistics.

    Args:
        workers: number of processes that read; the result does not depend on their number.
        progress: meter that counts the scenes.

    Raises:
        DatasetError: the dataset has no scene, or a scene cannot be read.
    """
    stored = open_dataset(dataset)

    def passing() -> Iterator[SceneFigures]:
        each = in_order(_read, stored.pictures, workers=workers)
        for done, figures in enumerate(each, start=1):
            progress.count("scenes", done, len(stored.pictures))
            yield figures

    return tally(passing(), stored.categories)


def tally(scenes: Iterable[SceneFigures], categories: Mapping[int, str]) -> Statistics:
    """Add up the figures of scenes one by one; `categories` are the objects' names."""
    sums = _Sums()
    for figures in scenes:
        _add(sums, figures)
    counts, part_pixels = sums.counts, sums.counts["part_reason"].total()
    return Statistics(
        scenes=dict(counts["scenes"]),
        pictures=sums.pictures,
        of_picture={name: _shares(of_name) for name, of_name in sums.of_picture.items()},
        pixels=sums.pixels,
        part_pixels=part_pixels,
        sizes_px=dict(counts["sizes_px"]),
        depth_scale_mm=sums.scale_mm,
        classes=tuple(
            ClassFigures(obj_id=obj_id, name=categories[obj_id], **of_class)
            for obj_id, of_class in sorted(sums.of_class.items())
        ),
        areas={name: counts["areas"][name] for name in ("small", "medium", "large")},
        reason=pooled_shares([counts["reason"]]),
        part_reason=pooled_shares([counts["part_reason"]]),
        decoded_share=sums.decoded_share,
        error=error_figures(counts["error_step"], sums.scale_mm),
        part_error=error_figures(counts["part_error_step"], sums.scale_mm),
        **{name: dict(sorted(counts[name].items())) for name in _HISTOGRAMS},
    )


def error_figures(step: dict[int, int], scale_mm: float) -> ErrorFigures:
    """Return the figures of a histogram of errors, whose bins are steps of `scale_mm`."""
    pixels = sum(step.values())
    if not pixels:
        nan = float("nan")
        return ErrorFigures(
            pixels=0, median_mm=nan, sigma_mm=nan, rms_mm=nan, beyond_1mm=nan, beyond_5mm=nan
        )
    value = np.array(list(step), dtype=np.float64) * scale_mm
    weight = np.array(list(step.values())) / pixels
    low, median, high = _quantiles(step, (0.15866, 0.5, 0.84134), continuous=True)
    return ErrorFigures(
        pixels=pixels,
        median_mm=float(median * scale_mm),
        sigma_mm=float((high - low) / 2 * scale_mm),
        rms_mm=float(np.sqrt(weight @ value**2)),
        beyond_1mm=float(weight[np.abs(value) > 1 + 1e-9].sum()),
        beyond_5mm=float(weight[np.abs(value) > 5 + 1e-9].sum()),
    )


def _quantiles(
    counts: dict[int, int], shares: tuple[float, ...], *, continuous: bool = False
) -> Float[np.ndarray, " shares"]:
    """Return quantiles of a histogram over whole numbers; NaN if it is empty.

    `continuous` spreads the count of each k evenly from k - 1/2 to k + 1/2, which undoes the
    rounding of a smooth distribution.
    """
    if not counts:
        return np.full(len(shares), np.nan)
    value = np.array(sorted(counts), dtype=np.float64)
    weight = np.array([counts[int(v)] for v in value], dtype=np.float64)
    total = weight.cumsum()
    wanted = np.array(shares) * total[-1]
    k = np.searchsorted(total, wanted).clip(max=len(value) - 1)
    inside = (wanted - (total[k] - weight[k])) / weight[k] - 0.5
    return value[k] + inside if continuous else value[k]


def _read(scene: StoredScene) -> SceneFigures:
    return scene_figures(scene_content(scene))


def _add(sums: _Sums, figures: SceneFigures) -> None:
    counts, here = sums.counts, (figures.split, figures.scene_id)
    counts["scenes"][figures.split] += here != sums.last  # A scene's pictures are consecutive.
    sums.last = here
    sums.pictures += 1
    sums.pixels += figures.pixels
    of_picture = sums.of_picture[figures.picture]
    of_picture["pictures"].update(all=1)
    of_picture["reason"].update(figures.reason_px)
    of_picture["part_reason"].update(figures.part_reason_px)
    counts["sizes_px"][figures.width_px, figures.height_px] += 1
    counts["instances"][len(figures.obj_id)] += 1
    counts["depth_bin"].update(figures.depth_bin)
    counts["reason"].update(figures.reason_px)
    counts["part_reason"].update(figures.part_reason_px)
    counts["gray"].update(figures.gray)
    counts["luma"].update(figures.luma)
    if (decoded := figures.part_reasons.get("decoded")) is not None:
        sums.decoded_share[min(int(decoded * 50), 49)] += 1
    sums.scale_mm = sums.scale_mm or figures.depth_scale_mm
    for name in ("error_step", "part_error_step"):
        own = getattr(figures, name)
        if figures.depth_scale_mm == sums.scale_mm:
            counts[name].update(own)
        else:  # Scenes of real pictures may differ in depth scale.
            ratio = figures.depth_scale_mm / sums.scale_mm
            for step, count in own.items():
                counts[name][round(step * ratio)] += count
    _add_instances(sums, figures)


def _shares(counts: Mapping[str, Counter]) -> PictureFigures:
    return PictureFigures(
        pictures=counts["pictures"].total(),
        decoded=pooled_shares([counts["reason"]]).get("decoded", 0.0),
        part_decoded=pooled_shares([counts["part_reason"]]).get("decoded"),
    )


def _add_instances(sums: _Sums, figures: SceneFigures) -> None:
    for obj_id in set(figures.obj_id):
        of_class = sums.of_class.setdefault(
            obj_id,
            {"scenes": 0, "instances": 0, "visible": 0}
            | {name: np.zeros(bins, dtype=np.int64) for name, bins in _CLASS_BINS.items()},
        )
        of_class["scenes"] += 1
    each = zip(figures.obj_id, figures.visib_fract, figures.area_px, figures.box_px, strict=True)
    for obj_id, share, area_px, box_px in each:
        of_class = sums.of_class[obj_id]
        of_class["instances"] += 1
        of_class["visible"] += share is None or share >= IGNORED_BELOW
        if share is not None:
            k = min(int(share * VISIBILITY_BINS), VISIBILITY_BINS - 1)
            of_class["visib_fract"][k] += 1
        if area_px:
            of_class["side_px"][_side_bin(area_px**0.5)] += 1
            of_class["box_px"][_side_bin(float(max(box_px)))] += 1
            size = "small" if area_px < SMALL_PX2 else "large" if area_px > LARGE_PX2 else "medium"
            sums.counts["areas"][size] += 1


def _side_bin(side_px: float) -> int:
    k = int(np.searchsorted(SIDE_EDGES_PX, side_px, side="right")) - 1
    return min(max(k, 0), _SIDES - 1)
