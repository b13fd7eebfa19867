"""Files of a twin: a configuration, its rig, and a report with a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...base.folder import whole_folder
from ...base.plotting import save_png
from ...base.settings import read_text
from ...base.tables import markdown_table
from ...camera.rig_file import ScannerSections, save_scanner
from ...cell.resolve import Cell
from ...world.scene import bin_of
from ..fitted_config import fitted_text, refuse_there
from ..realism import two_sample_table
from ..realism.two_sample import PLACES, Auc
from .making import Twin
from .parameters import BIN_COLOR, BIN_GLOSS, BIN_ROUGHNESS
from .rows import Row
from .searching import Fit

_BRIGHTEST = 0.9


def files_of(out: Path) -> tuple[Path, Path, Path]:
    """Return the paths of the rig file, report and picture of a twin's configuration."""
    return tuple(out.with_name(out.stem + end) for end in (".rig.yaml", ".twin.md", ".twin.png"))  # type: ignore[return-value]


def write_twin(twin: Twin, cell: Cell, base: Path, out: Path) -> list[Path]:
    """Write configuration, rig, report and picture, without overwriting any file.

    Raises:
        GraycastError: a file exists already, or cannot be written.
    """
    rig, report, picture = files_of(out)
    named = replace(twin.fit.scanner.rig, name=f"{cell.scanner.rig.name}-twin")
    text = fitted_text(
        read_text(base),
        base,
        {"rig": rig.name} | _bin(twin.fit, cell),
        {"rig": f"Fitted by graycast real twin to {twin.scans} real scans, from {base.name}."},
        dropped=tuple(ScannerSections.model_fields),
    )
    refuse_there(rig, report, picture, out)
    with whole_folder(out.parent) as aside:
        draw_twin(twin, aside / picture.name)
        (aside / report.name).write_text(report_text(twin), encoding="utf-8")
        save_scanner(replace(twin.fit.scanner, rig=named), aside / rig.name)
        (aside / out.name).write_text(text, encoding="utf-8")
        refuse_there(rig, report, picture, out)  # Another process may have written the files.
    return [out, rig, report, picture]


def report_text(twin: Twin) -> str:
    """Return the report in Markdown: statistics, parameters, codes and the classifier's results."""
    fit = twin.fit
    lines = [
        "# The twin's report",
        "",
        f"The search made {fit.trials} trials on the scenes of {twin.scans} real scans.",
        f"Statistics within two spreads of the real scans: {_met(fit.before)} before, "
        f"{_met(fit.after)} of {len(fit.after)} after.",
        "",
        "## Statistics",
        "",
        _statistics(fit.before, fit.after),
        "",
        "## What was fitted",
        "",
        f"The misfit is {fit.loss:.2f}: the mean square of the statistics' errors in spreads. "
        "Between `from` and `to`, other parameters can make up for a parameter, as far as the "
        "statistics change in proportion to the parameters (docs/how-to/twin.md).",
        "",
        markdown_table(
            ["key", "twin", "from", "to"],
            [
                [one.parameter.key, *(f"{value:.4g}" for value in (one.value, one.low, one.high))]
                for one in fit.estimates
            ],
        ),
        "",
        markdown_table(
            ["period of the code [px]", "least misfit"],
            [[str(period or "-"), f"{loss:.3f}"] for period, loss in fit.by_code.items()],
        ),
        "",
        "## Can a classifier distinguish the twin from the real scans?",
        "",
    ]
    for name, test in twin.classified.items():
        lines += [f"### {name.capitalize()}", "", two_sample_table(test)]
    return "\n".join(lines)


def summary(twin: Twin) -> list[str]:
    """Return a few lines that describe the twin."""
    fit = twin.fit
    lines = [
        f"statistics met: {_met(fit.before)} of {len(fit.before)} as configured, "
        f"{_met(fit.after)} of {len(fit.after)} by the twin",
    ]
    for place in PLACES:
        before, after = (_mean(twin.classified[k].auc, place) for k in ("before", "after"))
        own = _mean(twin.classified["after"].itself, place)
        lines.append(
            f"AUC of the classifier, {place}: {before} as configured, {after} by the twin; "
            f"real against itself {own}"
        )
    return lines


def draw_twin(twin: Twin, path: Path) -> None:
    """Draw a real scan and its two simulations, and below them the deviation of each statistic."""
    figure = Figure(figsize=(15, 11), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=[1, 1.2])
    known = np.concatenate([s.depth_m[s.valid] for s in twin.examples])
    low, high = np.percentile(known, [1, 99])
    names = ("a real scan", "its scene as configured", "its scene as the twin scans it")
    for k, (name, scan) in enumerate(zip(names, twin.examples, strict=True)):
        ax = figure.add_subplot(grid[0, k])
        ax.imshow(scan.depth_m, vmin=low, vmax=high, cmap="viridis")
        ax.set_facecolor("black")
        ax.set(title=name, xticks=[], yticks=[])
    ax = figure.add_subplot(grid[1, :])
    for rows, marker, label in (
        (twin.fit.before, "o", "as configured"),
        (twin.fit.after, "D", "twin"),
    ):
        off = [float(np.clip(row.off, -10, 10)) for row in rows]
        ax.plot(range(len(off)), off, marker, label=label)
    ax.axhspan(-2, 2, color="0.9", zorder=0)
    ax.set_xticks(range(len(twin.fit.after)), [r.name for r in twin.fit.after], rotation=60)
    for text in ax.get_xticklabels():
        text.set_horizontalalignment("right")
    ax.set(title="off by so many spreads of the real scans (cut at 10; grey: met)", ylim=(-11, 11))
    ax.legend()
    save_png(figure, path, dpi=80)


def _met(rows: Sequence[Row]) -> int:
    return sum(row.is_met for row in rows)


def _statistics(before: Sequence[Row], after: Sequence[Row]) -> str:
    old = {row.name: row for row in before}
    rows = []
    for row in after:
        was = f"{old[row.name].twin:.3g}" if row.name in old else "-"
        unit = f" [{row.unit}]" if row.unit else ""
        verdict = "yes" if row.is_met else f"no, {row.off:+.1f} spreads"
        figures = f"{row.real:.3g}", f"{row.spread:.2g}", was, f"{row.twin:.3g}"
        rows.append([f"{row.name}{unit}", *figures, verdict])
    return markdown_table(["statistic", "real", "spread", "as configured", "twin", "met"], rows)


def _mean(auc: Mapping[str, Auc], place: str) -> str:
    mean = auc[place].mean
    return "-" if mean is None else f"{mean:.2f}"


def _bin(fit: Fit, cell: Cell) -> dict[str, Any]:
    """Return the bin's section with fitted colours and gloss; empty if colours are not fitted."""
    color, gloss = (fit.values.get(key) for key in (BIN_COLOR, BIN_GLOSS))
    if color is None:
        return {}
    section = cell.config.bin.model_dump(mode="json", exclude_none=True)
    box = bin_of(cell.scene)
    for key, material in (("material", box.material), ("floor", box.floor)):
        if material is not None:
            own = section.setdefault(key, {})
            own["base_color"] = [_scaled(band, color) for band in material.base_color]
            if material.projector_reflectance is not None:  # used in the projector's light
                own["projector_reflectance"] = _scaled(material.projector_reflectance, color)
            if gloss is not None:
                own["specular"] = round(min(material.specular * gloss, 1.0), 4)
                own["roughness"] = round(material.roughness + fit.values[BIN_ROUGHNESS], 4)
    return {"bin": section}


def _scaled(reflectance: float, factor: float) -> float:
    """Return a reflectance times a factor, at most `_BRIGHTEST`."""
    return round(min(reflectance * factor, _BRIGHTEST), 4)
