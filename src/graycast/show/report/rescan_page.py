"""The page of a rescan, which shows perfect and measured depth of each image next to each other.

The page is one HTML file without scripts; its pictures are in the same folder. If there are too
many images, it shows evenly spaced images.
"""

import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ...base.color import srgb_of_bytes
from ...base.folder import refuse_foreign, whole_folder
from ...base.progress import UNWATCHED, ProgressMeter
from ...camera.decode import Reason, pooled_shares
from ...dataset.files.scene_folder import SceneFolder, scene_folders
from ...dataset.read.rescanned import RECORDS, ImageRecord, RescanClaim, image_records, read_rescan
from .page import WIDTH_PX
from .page.packing import jpeg, palette_picture, shrunk
from .preview import painted

PAGE = "rescan.html"
_MOST = 60  # largest number of images on the page
_QUALITY = 88
_BLACK = (0.0, 0.0, 0.0)
_ERROR_MM = 1.0  # error at the ends of the colour scale of error maps
_HEADS = (
    "picture",
    "white frame",
    "perfect depth",
    "scanner depth",
    "scanner - perfect",
    "reasons",
)
_STYLE = """\
body { font: 14px/1.4 system-ui, sans-serif; margin: 16px; background: #fbfbfa; color: #1d2228; }
table { border-collapse: collapse; } td, th { padding: 2px 6px; text-align: left; }
img { width: 100%; display: block; } .images td { width: 16.6%; vertical-align: top; }
i { display: inline-block; width: 10px; height: 10px; margin-right: 5px; }
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class RescanPage:
    """The written page, and the number of images that it shows."""

    page: Path
    images: int
    of: int


def write_rescan_page(
    out: Path, folder: Path, *, width_px: int = WIDTH_PX, progress: ProgressMeter = UNWATCHED
) -> RescanPage:
    """Write the page of the rescan `out` to a folder.

    Args:
        width_px: the largest width of the page's pictures.

    Raises:
        GraycastError: `out` is not a rescan or is damaged, or the folder holds something else or
            cannot be written.
    """
    claim = read_rescan(out)
    refuse_foreign(folder, PAGE)
    places = [
        (scene, number, record)
        for scene in scene_folders(out / claim.split, RECORDS)
        for number, record in image_records(scene).items()
    ]
    index = np.unique(np.linspace(0, len(places) - 1, _MOST).round().astype(int)).tolist()
    rows, errors_mm = [], []
    with whole_folder(folder) as aside:
        (aside / "images").mkdir()
        for done, k in enumerate(index, start=1):
            scene, number, record = places[k]
            pictures, error_mm = _pictures(scene, number, record, claim)
            errors_mm.append(error_mm)
            cells = []
            for name, picture in pictures.items():
                file = f"images/{scene.name}-{number:06d}-{_HEADS.index(name)}.jpg"
                (aside / file).write_bytes(jpeg(shrunk(picture, width_px), _QUALITY))
                cells.append(f'<td><a href="{file}"><img src="{file}" alt="{name}"></a></td>')
            share = f"{record.reasons['decoded']:.1%} of all pixels decoded"
            if record.part_reasons:
                share = f"{record.part_reasons['decoded']:.1%} of the objects' pixels, {share}"
            rows.append(f'<tr><td colspan="6">{scene.name}/{number:06d}: {share}</td></tr>')
            rows.append(f"<tr>{''.join(cells)}</tr>")
            progress.count("images", done, len(index))
        records = [record for _, _, record in places]
        text = _page(out, claim, records, np.concatenate(errors_mm), rows)
        (aside / PAGE).write_text(text, encoding="utf-8")
    return RescanPage(page=folder / PAGE, images=len(index), of=len(places))


def _pictures(
    scene: Path, number: int, record: ImageRecord, claim: RescanClaim
) -> tuple[dict[str, UInt8[np.ndarray, "h w 3"]], Float[np.ndarray, " n"]]:
    """Return the pictures of an image by column heading, and its depth errors [mm]."""
    own, original = SceneFolder(scene), SceneFolder(scene, claim.config["sensor"])
    scanned_mm = _depth_mm(own.png("depth_sl", number), claim.depth_scale_mm)
    gray = srgb_of_bytes(own.png("gray_sl", number))
    white = np.repeat(gray[..., None], 3, axis=2)
    colors = {reason.value: reason.color for reason in Reason}
    reasons = palette_picture(own.png("reason_sl", number), colors)
    colour = original.picture("rgb", number)
    picture = white if colour is None else np.ascontiguousarray(colour[..., 2::-1])
    steps = original.picture("depth", number)
    step_mm = record.perfect_step_mm
    if steps is None or not step_mm or steps.shape != scanned_mm.shape:
        perfect_mm = np.full(scanned_mm.shape, np.nan)
    else:
        perfect_mm = _depth_mm(steps, step_mm)
    error_mm = scanned_mm - perfect_mm
    known = perfect_mm if np.isfinite(perfect_mm).any() else scanned_mm
    low, high = np.nanquantile(np.where(np.isfinite(scanned_mm), known, np.nan), [0.01, 0.99])
    span = float(low), float(high)
    pictures = (
        picture,
        white,
        painted(perfect_mm, "viridis", span, unknown=_BLACK),
        painted(scanned_mm, "viridis", span, unknown=_BLACK),
        painted(error_mm, "RdBu_r", (-_ERROR_MM, _ERROR_MM), unknown=_BLACK),
        reasons,
    )
    return dict(zip(_HEADS, pictures, strict=True)), error_mm[np.isfinite(error_mm)]


def _depth_mm(steps: np.ndarray, step_mm: float) -> Float[np.ndarray, "h w"]:
    return np.where(steps > 0, steps * step_mm, np.nan)


def _page(
    out: Path,
    claim: RescanClaim,
    records: list[ImageRecord],
    errors_mm: Float[np.ndarray, " n"],
    rows: Iterable[str],
) -> str:
    facts = {
        "original": claim.sources[0],
        "rig": str(claim.rig["name"]),
        "camera": f"of the {claim.config['camera']}",
        "images": str(len(records)),
    }
    if errors_mm.size:
        names = ("median", "90 %", "99 %")
        off_mm = np.quantile(np.abs(errors_mm), [0.5, 0.9, 0.99])
        words = (f"{name} {value:.3g} mm" for name, value in zip(names, off_mm, strict=True))
        facts["error of depth"] = ", ".join(words)
    title = f"Scanner depth of {html.escape(out.name)}"
    heads = "".join(f"<th>{name}</th>" for name in _HEADS)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>"
        f"<table>{_rows(facts)}</table><h2>Pixels</h2><table>{_reasons(records)}</table>"
        f"<h2>Images</h2><p>The difference is red where the scanner measures {_ERROR_MM:g} mm too "
        "far, and blue where it measures as much too near.</p>"
        f'<table class="images"><tr>{heads}</tr>{"".join(rows)}</table></body></html>\n'
    )


def _rows(facts: Mapping[str, str]) -> str:
    return "".join(f"<tr><th>{k}</th><td>{html.escape(v)}</td></tr>" for k, v in facts.items())


def _reasons(records: list[ImageRecord]) -> str:
    """Return an HTML table row for each reason, with its colour and shares of pixels."""
    of_all = pooled_shares(record.reason_px for record in records)
    of_parts = pooled_shares(record.part_reason_px for record in records)
    lines = ["<tr><th></th><th>objects</th><th>all</th></tr>"]
    for reason in Reason:
        color = f'<i style="background: {reason.color}"></i>{html.escape(reason.label)}'
        shares = (f"{own.get(reason.label, 0):.1%}" if own else "" for own in (of_parts, of_all))
        cells = "".join(f"<td>{cell}</td>" for cell in (color, *shares))
        lines.append(f'<tr title="{html.escape(reason.meaning)}">{cells}</tr>')
    return "".join(lines)
