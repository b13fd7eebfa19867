"""Format a dataset's statistics as JSON and as a table for the terminal."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from ...base.folder import whole_folder
from ...camera.decode import little_depth_note
from ..files.json_text import plain
from .gather import SIDE_EDGES_PX, VISIBILITY_BINS, ErrorFigures, Statistics
from .scene_statistics import DEPTH_BIN_MM
from .stats_plots import draw_statistics


def statistics_json(statistics: Statistics) -> dict[str, Any]:
    """Return all statistics for JSON, with the bin edges of the histograms."""
    s = statistics
    return plain(
        {
            "scenes": s.scenes,
            "pictures": s.pictures,
            "of_picture": {name: asdict(one) for name, one in s.of_picture.items()},
            "image_sizes_px": [[*size, count] for size, count in s.sizes_px.items()],
            "pixels": s.pixels,
            "part_pixels": s.part_pixels,
            "classes": [asdict(one) for one in s.classes],
            "visib_fract_edges": [k / VISIBILITY_BINS for k in range(VISIBILITY_BINS + 1)],
            "side_edges_px": SIDE_EDGES_PX,
            "areas_coco": s.areas,
            "instances_per_scene": s.instances,
            "depth_bin_mm": DEPTH_BIN_MM,
            "depth_counts": s.depth_bin,
            "depth_mm": s.depth_quantiles_mm,
            "reasons": s.reason,
            "part_reasons": s.part_reason,
            "decoded_share_counts": s.decoded_share,
            "error_step_mm": s.depth_scale_mm,
            "error_counts": s.error_step,
            "part_error_counts": s.part_error_step,
            "error": asdict(s.error),
            "part_error": asdict(s.part_error),
            "white_frame_counts": s.gray,
            "luma_counts": s.luma,
        }
    )


def write_statistics(statistics: Statistics, out: Path) -> None:
    """Write `stats.json` and `stats.png` into a folder, either both or neither.

    Raises:
        GraycastError: the folder cannot be written.
    """
    with whole_folder(out) as folder:
        text = json.dumps(statistics_json(statistics), indent=1, allow_nan=False)
        (folder / "stats.json").write_text(text + "\n", encoding="utf-8")
        draw_statistics(statistics, folder / "stats.png")


def statistics_table(statistics: Statistics) -> Table:
    """Return a table for the terminal: quantity, amount and distribution."""
    s = statistics
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="bold")
    table.add_column()
    splits = ", ".join(f"{count} {split}" for split, count in s.scenes.items())
    sizes = ", ".join(f"{w} x {h} px" for w, h in s.sizes_px)
    table.add_row("scenes", f"{splits}; {sizes}")
    if s.pictures > sum(s.scenes.values()):
        table.add_row("pictures", f"{s.pictures}, all figures below are of these")
        for name, entry in s.of_picture.items():
            of_all = f"{entry.decoded:.2%} of all"
            if entry.part_decoded is None:
                table.add_row(f"  {name}", f"{of_all} pixels decoded")
            else:
                seen = f"{entry.part_decoded:.2%} of the parts' pixels decoded, {of_all}"
                table.add_row(f"  {name}", seen)
    what = "scenes" if s.pictures == sum(s.scenes.values()) else "pictures"
    for one in s.classes:
        visible = f"{one.visible} visible by 10 % or more, in {one.scenes} {what}"
        table.add_row(one.name, f"{one.instances} instances, {visible}")
    areas = ", ".join(f"{count} {name}" for name, count in s.areas.items())
    table.add_row("mask areas", f"{areas} (COCO: below 32^2, above 96^2 px)")
    if s.depth_bin:
        low, middle, high = (s.depth_quantiles_mm[k] for k in ("p01", "p50", "p99"))
        table.add_row("depth", f"{low:.0f} to {high:.0f} mm (1 to 99 %), median {middle:.0f} mm")
    for name, share in s.reason.items():
        if share or s.part_reason.get(name):
            of_parts = s.part_reason.get(name, 0)
            cell = f"{of_parts:7.2%} of the parts' pixels, {share:7.2%} of all pixels"
            table.add_row(name.replace("_", " "), cell)
    if note := little_depth_note(s.part_reason):
        table.add_row("note", f"{note}; graycast preview tries what helps")
    for name, error in (("scanner error on parts", s.part_error), ("  everywhere", s.error)):
        if error.pixels:
            table.add_row(name, _error_line(error))
    for name, counts in (("white frame", s.gray), ("colour", s.luma)):
        if counts:
            table.add_row(name, _brightness_line(counts))
    return table


def _error_line(error: ErrorFigures) -> str:
    return (
        f"median {error.median_mm:+.3f} mm, sigma {error.sigma_mm:.3f} mm, "
        f"rms {error.rms_mm:.2f} mm, {error.beyond_1mm:.2%} beyond 1 mm, "
        f"{error.beyond_5mm:.2%} beyond 5 mm"
    )


def _brightness_line(counts: dict[int, int]) -> str:
    total = sum(counts.values())
    mean = sum(level * count for level, count in counts.items()) / total
    return f"mean {mean:.0f} of 255, {counts.get(255, 0) / total:.2%} at the top"
