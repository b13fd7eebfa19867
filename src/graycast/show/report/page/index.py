"""The script that all pages share: the dataset, its statistics, and a row for each scene."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ....base.version import __version__
from ....camera.decode import little_depth_note
from ....dataset.read.scene_content import NO_REASON
from ....dataset.read.stored import StoredDataset
from ....dataset.stats import SceneFigures, Statistics, statistics_json, tally
from ....dataset.stats.gather import error_figures
from ....dataset.stats.scene_statistics import DEPTH_BIN_MM
from ....rig.pattern import Code, CodeSpec
from .packing import color_table, plain_text, reason_records, report_script
from .scene_files import MISSING_COLOR

_COLORMAPS = ("viridis_r", "viridis", "RdBu_r", "gray")


def index_script(
    stored: StoredDataset,
    figures: Iterable[SceneFigures],
    detections: Mapping[str, Any] | None = None,
    walls: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the content of `index.js`; `figures` may be a generator.

    Args:
        detections: the result of `detection_index`; None if no results were evaluated.
        walls: the result of `dataset_walls`.
    """
    rows: list[list[Any]] = []

    def passing() -> Iterator[SceneFigures]:
        for one in figures:
            rows.append(_scene_row(one))
            yield one

    statistics = tally(passing(), stored.categories)
    content = {
        "name": stored.folder.resolve().name,
        "fingerprint": stored.claim.get("fingerprint", ""),
        "graycast": __version__,
        "claim": _claim(stored.claim),
        "classes": {str(one.obj_id): one.name for one in statistics.classes},
        "reasons": _reasons(statistics),
        "colormaps": {name: color_table(name) for name in _COLORMAPS},
        "scanners": _scanners(stored),
        "statistics": statistics_json(statistics),
        "note": little_depth_note(statistics.part_reason),
        "columns": _COLUMNS,
        "scenes": rows,
        "detections": detections,
        "bin": walls,
    }
    return report_script(content)


_COLUMNS = (
    "split", "id", "picture", "objects", "instances", "visibility", "decoded", "part_decoded",
    "reasons", "part_reasons", "depth_mm", "sigma_mm", "bias_mm", "brightness",
)  # fmt: skip


def _scene_row(one: SceneFigures) -> list[Any]:
    """Return a scene's row for filters and sorting, which is short because pages load all rows."""
    error = error_figures(one.part_error_step or one.error_step, one.depth_scale_mm)
    visible = [share for share in one.visib_fract if share is not None]
    return [
        one.split,
        one.scene_id,
        one.picture,
        Counter(one.obj_id),
        len(one.obj_id),
        _short(sum(visible) / len(visible) if visible else None),
        _short(one.reasons.get("decoded")),
        _short(one.part_reasons.get("decoded")),
        {name: _short(share) for name, share in one.reasons.items() if share},
        {name: _short(share) for name, share in one.part_reasons.items() if share} or None,
        _short(_median_depth_mm(one), 1),
        _short(error.sigma_mm),
        _short(error.median_mm),
        _short(_mean(one.gray), 1),
    ]


def _short(value: float | None, digits: int = 4) -> float | None:
    return None if value is None or np.isnan(value) else round(value, digits)


def _mean(counts: dict[int, int]) -> float | None:
    total = sum(counts.values())
    return sum(k * n for k, n in counts.items()) / total if total else None


def _median_depth_mm(one: SceneFigures) -> float | None:
    if not one.depth_bin:
        return None
    bins = np.array(sorted(one.depth_bin))
    total = np.cumsum([one.depth_bin[int(k)] for k in bins])
    return float(bins[np.searchsorted(total, total[-1] / 2)] + 0.5) * DEPTH_BIN_MM


def _claim(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a dataset's claim without digests."""
    keys = ("config", "seed", "depth_scale_mm", "rig", "sources", "versions")
    claim = {key: content[key] for key in keys if key in content}
    if "config" in claim:
        claim["config"] = {k: v for k, v in claim["config"].items() if k != "files"}
    return claim


def _reasons(statistics: Statistics) -> list[dict[str, Any]]:
    if "missing" not in statistics.reason:
        return reason_records()
    meaning = "no scanner depth; the dataset does not say why"
    missing = {"number": NO_REASON, "name": "missing", "color": MISSING_COLOR, "meaning": meaning}
    return [*reason_records(), missing]


def _scanners(stored: StoredDataset) -> dict[str, Any]:
    """Return rig and code of each scanner by the scanner's name; None for unknown values."""
    takers = {sensor: stored.taker(sensor) for sensor in stored.sizes_px}
    return {name: {"rig": taker.get("rig"), "code": _code(taker)} for name, taker in takers.items()}


def _code(taker: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the levels of all frames along their axes; None if the code is unknown."""
    rig, settings = taker.get("rig"), taker.get("scanner", {}).get("code")
    if not rig or not settings:
        return None
    spec = CodeSpec(**{**settings, "axes": tuple(settings["axes"])})
    code = spec.code(rig["projector"]["width_px"], rig["projector"]["height_px"])
    return {"codec": spec.codec, "frames": list(_frames(code))}


def _frames(code: Code) -> Iterator[dict[str, Any]]:
    for frame, image in zip(code.frames, code.render(), strict=True):
        level = image[:, 0] if frame.axis == "row" else image[0]
        yield {"name": frame.name, "axis": frame.axis, "levels": plain_text(level)}
