"""Table of the statistics of one or several sets of depth maps, in plain text."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from .realism_record import Autocorrelation, BinRecord, Pairs, Realism

_UNKNOWN = "-"
_PERCENTILES = ("5 %", "25 %", "median", "75 %", "95 %")


class Figure(NamedTuple):
    """One line of the table; `text` contains the value and its unit."""

    section: str
    name: str
    text: str


def figures(record: Realism) -> Iterator[Figure]:
    """Yield the lines of the table for one record, without empty bins."""
    noise, jumps, steps, islands = record.noise, record.jumps, record.steps, record.islands
    yield Figure("depth maps", "number", f"{record.scans}")
    yield Figure("depth maps", "pixels", f"{record.pixels}")
    yield Figure("depth maps", "median depth", _mm(record.median_depth_m, 1))
    yield from _missing(record)
    section = f"noise about planes ({noise.patch_px} x {noise.patch_px} px patches)"
    yield Figure(section, "flat patches", f"{noise.patches}")
    yield Figure(section, "left out as bent", _percent(noise.bent))
    yield from _percentiles(section, noise.percentiles_m)
    relative = _UNKNOWN if noise.relative is None else f"{1e6 * noise.relative:.0f} ppm"
    yield Figure(section, "median over depth", relative)
    yield Figure(section, "pixels beyond 5 sigma", _percent(noise.outliers, 2))
    yield from _fine(record)
    yield from _pairs(record)
    yield from _lags("autocorrelation of the noise", "along", record.autocorrelation)
    section = "jumps between valid neighbours, per map"
    yield Figure(section, "left near, right far", f"{jumps.right_farther:.1f}")
    yield Figure(section, "left far, right near", f"{jumps.left_farther:.1f}")
    yield Figure(section, "upper near, lower far", f"{jumps.below_farther:.1f}")
    yield Figure(section, "upper far, lower near", f"{jumps.above_farther:.1f}")
    section = "pixels at a step"
    yield Figure(section, "per map", f"{steps.pixels:.0f}")
    yield Figure(section, "flying", _percent(steps.flying))
    yield from _baseline(record)
    section = f"islands of at most {islands.largest_px} px"
    yield Figure(section, "holes, per map", f"{islands.holes:.1f}")
    for size, count in islands.holes_by_size.items():
        yield Figure(section, f"holes of {size} px, per map", f"{count:.1f}")
    yield Figure(section, "specks, per map", f"{islands.specks:.1f}")
    for size, count in islands.specks_by_size.items():
        yield Figure(section, f"specks of {size} px, per map", f"{count:.1f}")
    yield Figure(section, "holes, share of pixels", _percent(islands.hole_share, 3))
    yield Figure(section, "specks, share of pixels", _percent(islands.speck_share, 3))


def table(*records: Realism) -> str:
    """Return a table with a column for each record."""
    columns = [{(f.section, f.name): f.text for f in figures(r)} for r in records]
    keys = _merged([list(column) for column in columns])
    sections = list(dict.fromkeys(section for section, _ in keys))
    head = [record.name for record in records]
    rows: list[tuple[str, list[str]]] = []
    for section in sections:
        rows.append((section, []))
        for key in keys:
            if key[0] == section:
                rows.append((f"  {key[1]}", [c.get(key, _UNKNOWN) for c in columns]))
    widths = [
        max(len(text) for text in (head[i], *(texts[i] for _, texts in rows if texts)))
        for i in range(len(records))
    ]
    left = max(len(name) for name, texts in rows if texts)
    lines = [_line("", head, left, widths)] + [_line(n, t, left, widths) for n, t in rows]
    return "\n".join(line.rstrip() for line in lines)


def _missing(record: Realism) -> Iterator[Figure]:
    missing = record.missing
    yield Figure("missing pixels", "all", _percent(missing.share))
    for reason, share in missing.by_reason.items():
        yield Figure("missing pixels", reason.replace("_", " "), _percent(share))
    section = "missing against brightness (share of the range)"
    yield from _bins(section, missing.by_brightness, 100.0, "%", _percent)
    drop = missing.drop_out
    if missing.by_brightness:
        text = _UNKNOWN if drop is None else f"{100 * drop.brightness:.2f} %"
        yield Figure(section, "drop-out steps at", text)
    if drop is not None:
        width = f"{100 * drop.first:.2f} to {100 * drop.last:.2f} %"
        yield Figure(section, "quarter to three quarters", width)
        yield Figure(section, "missing below, above", f"{_percent(drop.missing_below)}, "
                     f"{_percent(drop.missing_above)}")  # fmt: skip


def _fine(record: Realism) -> Iterator[Figure]:
    fine = record.fine
    section = f"fine noise (second differences, {fine.tile_px} x {fine.tile_px} px tiles)"
    yield Figure(section, "smooth tiles", f"{fine.tiles}")
    yield Figure(section, "left out as rough", _percent(fine.rough))
    yield from _percentiles(section, fine.percentiles_m)
    section = "fine noise against brightness (share of the range, under 45 deg)"
    yield from _bins(section, fine.by_brightness, 100.0, "%", _mm)
    yield Figure(section, "darkest over brightest", _plain(fine.dark_to_bright))
    section = "fine noise against incidence"
    yield from _bins(section, fine.by_incidence, 1.0, "deg", _mm)
    yield Figure(section, "40-50 over 0-10 deg", _plain(fine.steep_to_facing))


def _pairs(record: Realism) -> Iterator[Figure]:
    pairs = record.pairs
    section = "noise between each map and the next, where they show the same"
    yield Figure(section, "pairs of maps", f"{pairs.pairs}")
    yield Figure(section, "sigma of z", _mm(pairs.sigma_m))
    yield from _lags(section, "common along", pairs)


def _percentiles(section: str, values_m: Sequence[float | None] | None) -> Iterator[Figure]:
    for name, value in zip(_PERCENTILES, values_m or [None] * 5, strict=True):
        yield Figure(section, f"sigma of z, {name}", _mm(value))


def _lags(section: str, along: str, noise: Pairs | Autocorrelation) -> Iterator[Figure]:
    for name, values in (("rows", noise.along_rows), ("columns", noise.along_columns)):
        for lag, value in enumerate(values or [None] * 3, start=1):
            yield Figure(section, f"{along} {name}, lag {lag}", _plain(value))


def _baseline(record: Realism) -> Iterator[Figure]:
    section, baseline = "projector, from the widths of shadows", record.baseline
    if baseline is None:
        yield Figure(section, "side", "not found")
        return
    yield Figure(section, "side", baseline.side)
    length = f"{1e3 * baseline.baseline_m:.1f} +- {1e3 * baseline.error_m:.1f} mm"
    yield Figure(section, "baseline", length)
    if baseline.known_m is not None:
        yield Figure(section, "baseline of the rig", _mm(baseline.known_m, 1))
    yield Figure(section, "sideways", _mm(baseline.across_m, 1))
    yield Figure(section, "forwards (z)", _mm(baseline.forward_m, 1))
    yield Figure(section, "taken for beside the camera", _mm(baseline.plain_m, 1))
    yield Figure(section, "gaps wider than shadows by", f"{baseline.eaten_px:.2f} px")
    yield Figure(section, "edges (gaps)", f"{baseline.edges:.0f} ({baseline.gaps})")
    yield Figure(section, "edges that agree", _percent(baseline.agreeing))


def _bins(
    section: str,
    bins: list[BinRecord],
    factor: float,
    unit: str,
    show: Callable[[float | None], str],
) -> Iterator[Figure]:
    """Yield a line for each bin with samples; brackets contain their number and the interval."""
    for one in bins:
        if one.count:
            limits = f"{factor * one.low:.3g} to {factor * one.high:.3g} {unit}"
            known = f", {show(one.interval[0])} to {show(one.interval[1])}" if one.interval else ""
            yield Figure(section, limits, f"{show(one.value)} ({one.count}{known})")


def _merged(lists: list[list[tuple[str, str]]]) -> list[tuple[str, str]]:
    """Merge lists of keys; a new key comes after the key that precedes it in its list."""
    merged = list(lists[0])
    for keys in lists[1:]:
        at = 0
        for key in keys:
            if key in merged:
                at = merged.index(key) + 1
            else:
                merged.insert(at, key)
                at += 1
    return merged


def _line(name: str, texts: list[str], left: int, widths: list[int]) -> str:
    cells = [text.rjust(width) for text, width in zip(texts, widths, strict=False)]
    return "  ".join([name.ljust(left), *cells])


def _percent(value: float | None, digits: int = 1) -> str:
    return _UNKNOWN if value is None else f"{100 * value:.{digits}f} %"


def _mm(value_m: float | None, digits: int = 4) -> str:
    return _UNKNOWN if value_m is None else f"{1e3 * value_m:.{digits}f} mm"


def _plain(value: float | None) -> str:
    return _UNKNOWN if value is None else f"{value:.2f}"
