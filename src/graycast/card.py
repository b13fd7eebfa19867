"""The card of a dataset: a README that says what it is, how it was made and how it looks.

The head between two lines `---` is what the Hugging Face Hub reads of a dataset's README. The same
dataset gives the same card: no date, no duration.
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import UInt8

from .dataset.bop import plain
from .decode import REASON_COLOR, Reason
from .folder import whole_folder
from .stats import (
    DatasetFacts,
    Statistics,
    StoredScene,
    draw_statistics,
    find_scenes,
    load_scene,
    read_facts,
    statistics_json,
)

CARD = "README.md"
FOLDER = "card"  # of its pictures
UNSTATED = "not stated"
_SHOWN = 3
_TILE_PX = 480


def write_card(
    dataset: Path, statistics: Statistics, *, licence: str | None = None, title: str | None = None
) -> Path:
    """Write `README.md`, and `card/` with its pictures and `stats.json`, into a dataset's folder.

    Args:
        licence: an SPDX identifier or words; left out, the card says that none is stated.
        title: left out, the folder's name.

    Returns:
        The card.

    Raises:
        DatasetError: the dataset cannot be read.
        GraycastError: its folder cannot be written.
    """
    places, facts = find_scenes(dataset), read_facts(dataset)
    chosen = [places[k * len(places) // _SHOWN] for k in range(min(_SHOWN, len(places)))]
    with whole_folder(dataset / FOLDER) as folder:
        draw_statistics(statistics, folder / "stats.png")
        text = json.dumps(statistics_json(statistics), indent=1, allow_nan=False)
        (folder / "stats.json").write_text(text + "\n", encoding="utf-8")
        for place in chosen:
            picture = scene_strip(load_scene(place))
            cv2.imwrite(str(folder / f"{place.key}.jpg"), picture[..., ::-1])
    card = card_text(
        title or dataset.resolve().name,
        statistics,
        facts,
        licence=licence,
        pictures=[f"{FOLDER}/{place.key}.jpg" for place in chosen],
    )
    with whole_folder(dataset) as folder:
        (folder / CARD).write_text(card, encoding="utf-8")
    return dataset / CARD


def card_text(
    title: str,
    statistics: Statistics,
    facts: DatasetFacts,
    *,
    licence: str | None,
    pictures: list[str],
) -> str:
    """The card as Markdown."""
    head = {
        "pretty_name": title,
        "license": licence or "unknown",
        "task_categories": ["object-detection", "image-segmentation", "depth-estimation"],
        "tags": ["bop", "bin-picking", "structured-light", "graycast"],
    }
    blocks = [
        "---\n" + yaml.safe_dump(head, sort_keys=False) + "---",
        f"# {title}",
        _introduction(facts),
        f"Licence: {licence or UNSTATED}.",
        *(f"![colour, white frame, scanner depth, reasons]({name})" for name in pictures[:_SHOWN]),
        _CAPTION if pictures else "",
        "## Figures",
        _figures(statistics),
        f"![statistics]({FOLDER}/stats.png)",
        f"All of them as numbers: `{FOLDER}/stats.json`.",
        "## How it was made",
        _making(facts),
    ]
    return "\n\n".join(block for block in blocks if block) + "\n"


_CAPTION = (
    "Colour picture, the scanner's white frame, its depth, and why pixels have none: "
    + ", ".join(reason.name.lower().replace("_", " ") for reason in Reason)
    + "."
)


def _introduction(facts: DatasetFacts) -> str:
    if facts.claim.get("kind") == "real":
        return (
            "Real pictures in the files of a [BOP](https://bop.felk.cvut.cz) dataset, brought in "
            "by Graycast. Poses and perfect depth are not known."
        )
    return (
        "Simulated by Graycast: parts dropped into a bin, coded light projected on them by path "
        "tracing, pictures taken through a sensor's noise and decoded as a scanner does. Perfect "
        "depth, masks and poses stand beside what the scanner measured. The files are those of a "
        "[BOP](https://bop.felk.cvut.cz) dataset (scenewise); lengths are millimetres."
    )


def _figures(s: Statistics) -> str:
    splits = ", ".join(f"{count:,} {split}" for split, count in s.scenes.items())
    rows = [
        ("scenes", splits),
        ("pictures", ", ".join(f"{w} x {h} px" for w, h in s.sizes_px)),
    ]
    for one in s.classes:
        plural = "" if one.scenes == 1 else "s"
        told = f"{one.instances:,} instances in {one.scenes:,} scene{plural}"
        rows.append((f"part `{one.name}`", told))
    if s.depth_bin:
        depth = s.depth_quantiles_mm
        rows.append(("perfect depth (1 to 99 %)", f"{depth['p01']:.0f} to {depth['p99']:.0f} mm"))
    if "decoded" in s.reason:
        shares = (
            f"{s.reason['decoded']:.1%} of all pixels, {s.part_reason['decoded']:.1%} of parts'"
        )
        rows.append(("with a scanner depth", shares))
    missing = {n: v for n, v in s.part_reason.items() if n != "decoded" and v >= 5e-4}
    if missing:
        told = ", ".join(f"{name.replace('_', ' ')} {share:.1%}" for name, share in missing.items())
        rows.append(("without, on parts", told))
    if s.part_error.pixels:
        error = s.part_error
        told = f"sigma {error.sigma_mm:.3f} mm, median {error.median_mm:+.3f} mm"
        rows.append(("scanner less perfect depth, on parts", told))
    lines = [f"| {name} | {value} |" for name, value in rows]
    return "\n".join(["| | |", "|---|---|", *lines])


def _making(facts: DatasetFacts) -> str:
    claim = facts.claim
    if not claim:
        return "The folder does not say."
    said: dict[str, Any] = {
        key: claim[key] for key in ("seed", "versions", "sources") if key in claim
    }
    config = {k: v for k, v in claim.get("config", {}).items() if k not in ("files", "scanner")}
    text = yaml.safe_dump(plain(said), sort_keys=True, default_flow_style=None, width=96)
    blocks = [f"```yaml\n{text}```"]
    if config:
        text = yaml.safe_dump(plain(config), sort_keys=True, default_flow_style=None, width=96)
        blocks.append(
            f"The configuration; `graycast.json` has it with the rig:\n\n```yaml\n{text}```"
        )
    return "\n\n".join(blocks)


def scene_strip(scene: StoredScene) -> UInt8[np.ndarray, "h w 3"]:
    """Colour, white frame, scanner depth and reasons side by side; what is missing is left out."""
    tiles = [scene.rgb] if scene.rgb is not None else []
    if scene.gray is not None:
        tiles.append(np.repeat(scene.gray[..., None], 3, axis=2))
    if scene.scanner is not None:
        tiles += [_depth_picture(scene.scanner), _reason_picture(scene)]
    height_px = round(_TILE_PX * scene.reason.shape[0] / scene.reason.shape[1])
    size = (_TILE_PX, max(height_px, 1))
    small = [cv2.resize(tile, size, interpolation=cv2.INTER_AREA) for tile in tiles]
    return np.concatenate(small, axis=1)


def _depth_picture(step: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    known = step > 0
    low, high = np.quantile(step[known], (0.01, 0.99)) if known.any() else (0.0, 1.0)
    share = np.clip((step.astype(np.float64) - low) / max(high - low, 1.0), 0, 1)
    near_bright = np.round(255 * (1 - share)).astype(np.uint8)
    colored = cv2.applyColorMap(near_bright, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.where(known[..., None], colored, 58).astype(np.uint8)


def _reason_picture(scene: StoredScene) -> UInt8[np.ndarray, "h w 3"]:
    table = np.full((256, 3), 90, dtype=np.uint8)
    colors = {reason.name.lower(): color for reason, color in REASON_COLOR.items()}
    for number, name in scene.reason_name.items():
        if name in colors:
            table[number] = list(bytes.fromhex(colors[name][1:]))
    return table[scene.reason]
