"""Plots of the statistics of one or several sets of depth maps."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...base.plotting import save_png
from .realism_record import BinRecord, Realism

_LEAST_PATCHES = 5  # A bin with fewer patches is in the table, but not in the curves.
_DIRECTIONS = ("right", "left", "below", "above")


def draw_realism(records: Sequence[Realism], path: Path) -> None:
    """Write a PNG with six plots that have a curve or bars for each record.

    Raises:
        GraycastError: the file cannot be written.
    """
    figure = Figure(figsize=(15, 9), layout="constrained")
    axes = figure.subplots(2, 3)
    _draw_missing(axes[0, 0], records)
    _draw_noise_over_brightness(axes[0, 1], records)
    _draw_noise_over_incidence(axes[0, 2], records)
    _draw_percentiles(axes[1, 0], records)
    _draw_autocorrelation(axes[1, 1], records)
    _draw_jumps(axes[1, 2], records)
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    save_png(figure, path, dpi=100)


def _draw_missing(ax: Axes, records: Sequence[Realism]) -> None:
    for i, record in enumerate(records):
        ax.plot(*_curve(record.missing.by_brightness, 1e2), "o-", color=f"C{i}")
        if drop := record.missing.drop_out:
            ax.axvline(drop.brightness, color=f"C{i}", ls=":")
    ax.set(title="missing pixels (dotted: drop-out step)", ylabel="missing [%]", ylim=(-3, 103))
    _brightness_axis(ax)


def _draw_noise_over_brightness(ax: Axes, records: Sequence[Realism]) -> None:
    for i, record in enumerate(records):
        ax.plot(*_curve(record.fine.by_brightness, 1e3, _LEAST_PATCHES), "o-", color=f"C{i}")
    ax.set(title="fine noise against brightness, under 45°", ylabel="median sigma of z [mm]")
    ax.set_ylim(bottom=0)
    _brightness_axis(ax)


def _draw_noise_over_incidence(ax: Axes, records: Sequence[Realism]) -> None:
    for i, record in enumerate(records):
        bins = [b for b in record.fine.by_incidence if b.count >= _LEAST_PATCHES]
        middle = [(b.low + b.high) / 2 for b in bins]
        ax.plot(middle, [1e3 * b.value for b in bins if b.value is not None], "o-", color=f"C{i}")
    ax.set(
        title="fine noise against incidence", xlabel="angle to the camera's ray [°]", xlim=(0, 90)
    )
    ax.set(ylabel="median sigma of z [mm]")
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3)


def _draw_percentiles(ax: Axes, records: Sequence[Realism]) -> None:
    for i, record in enumerate(records):
        if record.noise.percentiles_m:
            value_mm = [1e3 * value for value in record.noise.percentiles_m]
            ax.plot(value_mm, (5, 25, 50, 75, 95), "o-", color=f"C{i}", label=record.name)
        else:
            ax.plot([], [], "o-", color=f"C{i}", label=f"{record.name} (no flat patch)")
    ax.set(title="noise about planes", xlabel="sigma of z [mm]", ylabel="patches below [%]")
    ax.set_xlim(left=0)
    ax.grid(alpha=0.3)


def _draw_autocorrelation(ax: Axes, records: Sequence[Realism]) -> None:
    for i, record in enumerate(records):
        of = record.autocorrelation
        for values, style in ((of.along_rows, "o-"), (of.along_columns, "s--")):
            if values:
                ax.plot(range(4), [1.0, *values], style, color=f"C{i}")
    ax.axhline(0, color="gray", lw=0.8)
    ax.set(title="autocorrelation (dashed: along columns)", xlabel="lag [px]", xticks=range(4))
    ax.grid(alpha=0.3)


def _draw_jumps(ax: Axes, records: Sequence[Realism]) -> None:
    width = 0.8 / len(records)
    for i, record in enumerate(records):
        counts = [getattr(record.jumps, f"{direction}_farther") for direction in _DIRECTIONS]
        place = [j - 0.4 + (i + 0.5) * width for j in range(len(counts))]
        ax.bar(place, counts, width, color=f"C{i}")
    ax.set(title="jumps between valid neighbours", ylabel="per map", xlabel="far side")
    ax.set_xticks(range(len(_DIRECTIONS)), _DIRECTIONS)


def _curve(bins: list[BinRecord], factor: float, least: int = 1) -> tuple[list[float], list[float]]:
    """Return the middle and the value of each known bin; the middle is geometric except from 0."""
    known = [b for b in bins if b.value is not None and b.count >= least]
    middle = [(b.low * b.high) ** 0.5 if b.low > 0 else b.high / 2 for b in known]
    return middle, [factor * b.value for b in known if b.value is not None]


def _brightness_axis(ax: Axes) -> None:
    ax.set_xscale("log", base=2)
    ax.set(xlabel="brightness, share of the range", xlim=(2**-9.5, 1.1))
    ax.grid(alpha=0.3)
