"""Measurements of the named scanners next to their makers' figures, for docs/reference/shelf.md."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float

from graycast.base.tables import markdown_table
from graycast.camera.scanner import Scanner, preset
from graycast.rendering import Renderer, open_renderer
from graycast.rig import shelf
from graycast.rig.pair import Rig
from graycast.rig.shelf import (
    MEASURED,
    SHELF,
    ShelfEntry,
    ShelfFigures,
    class_of,
    measured,
    shelf_entry,
)
from graycast.score.metrology import Certificate, Scope, certify
from graycast.show.report import draw_rig
from graycast.show.report.rig_picture import common_field
from graycast.show.report.shelf_list import stored_noise_m

SCOPE = Scope(distances=3, tilts_deg=(), spheres=1, bars=1, captures=4)
READOUT_S = 0.01  # time to read out a frame, as in the design study
START, END = "<!-- by python -m benchmarks shelf -->", "<!-- end -->"
HEAD = (
    "scanner", "range [m]", "points", "field near / middle / far [mm]", "stated field; here [mm]",
    "stated noise; here [mm]", "stated spacing; here [mm]", "stated trueness; length error here",
    "stated capture; here [s]",
)  # fmt: skip


def measure_all(
    names: list[str], resolution: str, commit: str, show: Callable[[str], None]
) -> dict[str, ShelfFigures]:
    """Measure the named scanners; take the others' results from the package, if they are stored."""
    stored = measured()
    figures = dict(stored.scanners) if stored.resolution == resolution else {}
    origin = f"commit {commit}, python -m benchmarks shelf"
    with open_renderer("mitsuba", device="cpu") as renderer:
        for name in names:
            show(f"{name} is measured")
            figures[name] = _measure(preset(name, resolution), renderer)
            _store(figures, origin, resolution)
    return figures


def _measure(scanner: Scanner, renderer: Renderer) -> ShelfFigures:
    sheet: Certificate = certify(scanner, renderer=renderer, seed=0, scope=SCOPE)
    times_s = sheet.middle.exposures_s
    frame_s = sum(times_s) + READOUT_S * len(times_s)
    return ShelfFigures(
        z_m=tuple(round(plane.z_m, 4) for plane in sheet.facing),
        noise_m=tuple(_rounded(plane.noise_m) for plane in sheet.facing),
        spacing_m=tuple(_rounded(plane.spacing_m) for plane in sheet.facing),
        plane_std_m=tuple(_rounded(plane.std_m) for plane in sheet.facing),
        length_error=_rounded(sheet.spacing[0].error_m / sheet.bar_length_m),
        capture_s=_rounded(len(scanner.light_code().frames) * frame_s),
    )


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _store(figures: dict[str, ShelfFigures], origin: str, resolution: str) -> None:
    """Store the results in the package, where `graycast rig list --noise` reads them."""
    rows = {name: figures[name].model_dump(mode="json") for name in SHELF if name in figures}
    content = {"origin": origin, "resolution": resolution, "scanners": rows}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    path = Path(shelf.__file__).with_name(MEASURED)
    path.write_text(f"# Written by python -m benchmarks shelf: docs/reference/shelf.md.\n{text}")


def draw_all(names: list[str], folder: Path) -> None:
    """Draw the measuring volume of each scanner like `graycast rig show`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        draw_rig(preset(name, "full").rig, folder / f"{name}.png")


def with_table(page: str, figures: dict[str, ShelfFigures]) -> str:
    """Return the page with a new table between its markers `START` and `END`."""
    before, rest = page.split(START)
    _, after = rest.split(END)
    rows = [_row(name, shelf_entry(name), figures.get(name)) for name in SHELF]
    return f"{before}{START}\n\n{markdown_table(HEAD, rows)}\n\n{END}{after}"


def _row(name: str, entry: ShelfEntry, own: ShelfFigures | None) -> list[str]:
    rig, claims = preset(name, "full").rig, entry.claims
    near_m, far_m = rig.near_m, rig.far_m
    fields = " / ".join(_field(rig, z_m) for z_m in (near_m, (near_m + far_m) / 2, far_m))
    field_text = "; ".join(
        f"{_size(claim.size_m)} at {claim.at_m:g} m{_mark(name, f'claims.fields.{i}.size_m')}; "
        f"{_field(rig, claim.at_m)}"
        for i, claim in enumerate(claims.fields)
    )
    at_m = claims.noise.at_m if claims.noise else entry.focus_m or (near_m + far_m) / 2
    noise_m = stored_noise_m(name, at_m)
    noise = "?" if own is None or noise_m is None else f"{1e3 * noise_m:.3f}"
    says = "?"
    if claims.noise:
        says = f"{1e3 * claims.noise.value_m:g}{_mark(name, 'claims.noise.value_m')}"
    spacing = "?"
    if claims.spacing:
        here_m = claims.spacing.at_m / rig.camera.fx_px
        mark = _mark(name, "claims.spacing.value_m")
        spacing = f"{1e3 * claims.spacing.value_m:g}{mark}; {1e3 * here_m:.3f}"
    share = span = "?"
    if claims.trueness_share:
        share = f"{claims.trueness_share:.1%}{_mark(name, 'claims.trueness_share')}"
    if claims.trueness:
        share = f"{1e3 * claims.trueness.value_m:g} mm{_mark(name, 'claims.trueness.value_m')}"
    if claims.capture_s:
        span = "-".join(f"{value:g}" for value in claims.capture_s)
        span += _mark(name, "claims.capture_s")
    return [
        f"`{name}`",
        f"{near_m:g}-{far_m:g}{_mark(name, 'near_m', 'far_m')}",
        f"{rig.camera.width_px} x {rig.camera.height_px}{_mark(name, 'camera.size_px')}",
        fields,
        field_text or "?",
        f"{says}; {noise} at {at_m:.2f} m",
        spacing,
        f"{share}; {'?' if own is None else f'{round(own.length_error, 5) + 0.0:.3%}'}",
        f"{span}; {'?' if own is None else f'{own.capture_s:.2f}'}",
    ]


def _mark(name: str, *keys: str) -> str:
    """Return the first letter of the class of a stated figure, in parentheses."""
    return f" ({class_of(name, *keys)[0]})"


def _field(rig: Rig, z_m: float) -> str:
    """Return the size of the bounding rectangle of the common field as text."""
    return _size(np.ptp(common_field(rig, z_m), axis=0))


def _size(size_m: Sequence[float] | Float[np.ndarray, "2"]) -> str:
    return f"{1e3 * size_m[0]:.0f} x {1e3 * size_m[1]:.0f}"
