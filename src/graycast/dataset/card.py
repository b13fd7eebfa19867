"""The card of a dataset: a README with pictures that says what it contains and how it was made.

The Hugging Face Hub reads the head between the two lines `---`. Equal datasets have equal cards,
byte for byte, because a card contains no date, duration or folder. The owner chooses the licence,
so a card that is written again keeps it.
"""

import json
import re
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import UInt8
from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from ..base.color import srgb_of_bytes
from ..base.errors import GraycastError
from ..base.folder import beside
from ..camera.decode import REASON_COLOR, Reason, little_depth_note
from .files.json_text import plain
from .files.places import finished_scenes
from .files.safe_reading import Unreadable, read_json
from .read.scene_content import SceneContent, scene_content
from .read.stored import StoredDataset, StoredScene, open_dataset
from .stats import Statistics, draw_statistics, scene_figures, statistics_json, tally
from .write.claim import BESIDE_CONFIG

CARD = "README.md"
FOLDER = "card"  # The card's pictures are in this folder.
UNSTATED = "not stated"
_NO_LICENCE = "unknown"  # The Hugging Face Hub uses this word.
SAMPLED = 40  # If no statistics are given, at most this number of pictures is read.
_MOST = 3
_TILE_PX = 480
_NAMED = 4  # A title names at most this many parts.

Objects = Mapping[StoredScene, tuple[int, ...]]  # Each scene has an object id per instance.


def write_card(
    dataset: Path,
    statistics: Statistics | None = None,
    *,
    licence: str | None = None,
    title: str | None = None,
) -> Path:
    """Write `README.md`, and `card/` with its pictures and `stats.json`, into a dataset's folder.

    Scenes and instances are counted in `scene_gt.json` of every scene, which is quick.

    Args:
        statistics: the result of `dataset_statistics`. If None, only `SAMPLED` pictures are read,
            chosen with a fixed seed, which takes seconds; the card says so.
        licence: an SPDX expression such as CC-BY-4.0, or LicenseRef- and a name of your own.
            None keeps the licence of the existing card; if there is no such licence, the card
            says that none is stated.
        title: the title of the card; None names the parts.

    Returns:
        The path of the card.

    Raises:
        DatasetError: the dataset cannot be read.
        GraycastError: the folder cannot be written, or the licence is not on the SPDX list.
    """
    licence = stated_licence(dataset) if licence is None else spdx(licence)
    stored = open_dataset(dataset)
    objects = {scene: scene.obj_ids() for scene in stored.scenes}
    if statistics is None:
        figures = (scene_figures(scene_content(scene)) for scene in sampled(stored.pictures))
        statistics = tally(figures, stored.categories)
    examples = _examples(objects)
    card = card_text(
        title or _title(stored),
        statistics,
        objects,
        stored,
        licence=licence,
        pictures=[f"{FOLDER}/{scene.key}.jpg" for scene in examples],
    )
    try:
        _publish(dataset, card, statistics, len(objects), examples)
    except OSError as error:
        why = error.strerror or str(error)
        raise GraycastError(
            f"{dataset}: the card cannot be written ({why}): make the folder writable, or free "
            "disk space"
        ) from error
    return dataset / CARD


def stated_licence(dataset: Path) -> str | None:
    """Return the licence in the head of a dataset's card; None if it is missing or not in SPDX."""
    try:
        text = (dataset / CARD).read_text(encoding="utf-8")
        head = re.match(r"---\n(?:.+\n)*?license: (.+)\n", text)
        return None if head is None or head[1] == _NO_LICENCE else spdx(head[1])
    except (OSError, UnicodeDecodeError, GraycastError):
        return None


def counts_all_scenes(dataset: Path) -> bool:
    """Return whether the card counts as many scenes as the dataset has; False without a card.

    A README without a card's figures was written by its owner and is accepted (True).
    """
    figures = dataset / FOLDER / "stats.json"
    if not figures.exists():
        return (dataset / CARD).exists()
    try:
        count = read_json(figures, dict[str, Any]).get("scenes_in_dataset")
    except Unreadable:
        return False
    return (dataset / CARD).exists() and count == len(finished_scenes(dataset))


def spdx(licence: str) -> str:
    """Return a licence as the SPDX list spells it, because programs know only these spellings.

    Raises:
        GraycastError: the licence is not on the list.
    """
    try:
        return canonicalize_license_expression(licence)
    except InvalidLicenseExpression as error:
        raise GraycastError(
            f"licence {licence!r} is not an SPDX expression: give an identifier of "
            "spdx.org/licenses such as CC-BY-4.0 or MIT, several joined by AND or OR, or "
            "LicenseRef- and a name for your own terms"
        ) from error


def escaped(text: str) -> str:
    """Escape a user's text so that Markdown shows it literally, on one line."""
    return re.sub(r"([\\`*_{}\[\]<>()#|~&!$])", r"\\\1", " ".join(text.split()))


def fenced(text: str) -> str:
    """Return a YAML code block whose fence is longer than any run of backticks in the text."""
    longest = max((len(row) for row in re.findall("`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}yaml\n{text}{fence}"


def sampled(scenes: Sequence[StoredScene]) -> list[StoredScene]:
    """Return at most `SAMPLED` of the scenes, in order; the choice depends only on their number.

    The choice is random, because evenly spaced scenes could all have the same part.
    """
    order = np.random.default_rng(0).permutation(len(scenes))[:SAMPLED]
    return [scenes[k] for k in sorted(order)]


def _examples(objects: Objects) -> list[StoredScene]:
    """Return up to `_MOST` scenes: first one of each combination of objects, then any others."""
    first: dict[frozenset[int], StoredScene] = {}
    for scene, obj_ids in objects.items():
        first.setdefault(frozenset(obj_ids), scene)
    return list(dict.fromkeys([*first.values(), *objects]))[:_MOST]


def _title(stored: StoredDataset) -> str:
    kind = "Real scans" if stored.real else "Simulated scans"
    names = list(stored.categories.values())
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{kind} of {', '.join(names[:_NAMED])}{more}" if names else kind


def _publish(
    dataset: Path, card: str, statistics: Statistics, scenes: int, examples: Sequence[StoredScene]
) -> None:
    """Write the card's files under temporary names and rename them, so that all are complete."""
    with beside(dataset / CARD) as written, beside(dataset / FOLDER) as folder:
        folder.mkdir()
        draw_statistics(statistics, folder / "stats.png")
        figures = {"scenes_in_dataset": scenes} | statistics_json(statistics)
        text = json.dumps(figures, indent=1, allow_nan=False)
        (folder / "stats.json").write_text(text + "\n", encoding="utf-8")
        for scene in examples:
            picture = scene_strip(scene_content(scene))[..., ::-1]
            (folder / f"{scene.key}.jpg").write_bytes(cv2.imencode(".jpg", picture)[1].tobytes())
        written.write_text(card, encoding="utf-8")
        shutil.rmtree(dataset / FOLDER, ignore_errors=True)


def card_text(
    title: str,
    statistics: Statistics,
    objects: Objects,
    stored: StoredDataset,
    *,
    licence: str | None,
    pictures: list[str],
) -> str:
    """Return the card as Markdown."""
    head = {
        "pretty_name": title,
        "license": licence or _NO_LICENCE,
        "task_categories": ["object-detection", "image-segmentation", "depth-estimation"],
        "tags": ["bop", "bin-picking", "structured-light", "graycast"],
    }
    blocks = [
        "---\n" + yaml.safe_dump(head, sort_keys=False) + "---",
        f"# {escaped(title)}",
        _introduction(stored),
        f"Licence: {licence or UNSTATED}.",
        *(f"![colour, white frame, scanner depth, reasons]({name})" for name in pictures[:_MOST]),
        _CAPTION if pictures else "",
        "## Figures",
        _figures(statistics, objects, stored),
        _sample_text(statistics, len(objects), len(stored.images)),
        f"![statistics]({FOLDER}/stats.png)",
        f"All of them as numbers: `{FOLDER}/stats.json`.",
        "## How it was made",
        _making(stored),
    ]
    return "\n\n".join(block for block in blocks if block) + "\n"


_CAPTION = (
    "Colour picture, the scanner's white frame, its depth, and why pixels have none: "
    + ", ".join(reason.words for reason in Reason)
    + "."
)


def _introduction(stored: StoredDataset) -> str:
    if stored.real:
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


def _sample_text(s: Statistics, scenes: int, of: int) -> str:
    pictures = scenes * of
    if s.pictures == pictures:
        return ""
    what = "scenes" if of == 1 else "pictures"
    return (
        f"The numbers of scenes and instances are of the whole dataset. All other figures and the "
        f"plots are of {s.pictures} {what}, drawn at random of {pictures:,}. "
        "`graycast dataset stats --card` reads all."
    )


def _figures(s: Statistics, objects: Objects, stored: StoredDataset) -> str:
    splits = Counter(scene.split for scene in objects)
    instances = Counter(obj_id for of_scene in objects.values() for obj_id in of_scene)
    each = "" if len(stored.images) == 1 else f", each of {len(stored.images)} pictures"
    rows = [
        ("scenes", ", ".join(f"{count:,} {split}" for split, count in splits.items()) + each),
        ("pictures", ", ".join(f"{w} x {h} px" for w, h in s.sizes_px)),
    ]
    for obj_id, number in sorted(instances.items()):
        scenes = sum(obj_id in of_scene for of_scene in objects.values())
        count = f"{number:,} instances in {scenes:,} scene{'' if scenes == 1 else 's'}"
        rows.append((f"part {escaped(stored.categories[obj_id])}", count))
    if s.depth_bin:
        depth = s.depth_quantiles_mm
        rows.append(("perfect depth (1 to 99 %)", f"{depth['p01']:.0f} to {depth['p99']:.0f} mm"))
    if "decoded" in s.reason:
        of_parts = f"{s.part_reason['decoded']:.1%} of the parts' pixels, " if s.part_reason else ""
        rows.append(("with a scanner depth", f"{of_parts}{s.reason['decoded']:.1%} of all"))
    missing = {n: v for n, v in s.part_reason.items() if n != "decoded" and v >= 5e-4}
    if missing:
        shares_text = ", ".join(
            f"{escaped(name.replace('_', ' '))} {share:.1%}" for name, share in missing.items()
        )
        rows.append(("without, on parts", shares_text))
    if note := little_depth_note(s.part_reason):
        rows.append(("note", f"{note}; `graycast preview` tries what helps"))
    if s.part_error.pixels:
        error = s.part_error
        figures = f"sigma {error.sigma_mm:.3f} mm, median {error.median_mm:+.3f} mm"
        rows.append(("scanner less perfect depth, on parts", figures))
    extras = stored.claim.get("config", {}).get("store", {})
    names = {"frames": "every captured frame", "columns": "projector columns"}
    also = [words for key, words in names.items() if extras.get(key)]
    rows += [("kept beside", ", ".join(also))] if also else []
    lines = [f"| {name} | {value} |" for name, value in rows]
    return "\n".join(["| | |", "|---|---|", *lines])


def _making(stored: StoredDataset) -> str:
    claim = stored.claim
    front_matter: dict[str, Any] = {
        key: claim[key] for key in ("seed", "versions", "sources") if key in claim
    }
    config = {k: v for k, v in claim.get("config", {}).items() if k not in BESIDE_CONFIG}
    text = yaml.safe_dump(plain(front_matter), sort_keys=True, default_flow_style=None, width=96)
    blocks = [fenced(text)]
    if config:
        text = yaml.safe_dump(plain(config), sort_keys=True, default_flow_style=None, width=96)
        blocks.append(f"The configuration; `graycast.json` has it with the rig:\n\n{fenced(text)}")
    return "\n\n".join(blocks)


def scene_strip(scene: SceneContent) -> UInt8[np.ndarray, "h w 3"]:
    """Return colour, white frame, scanner depth and reasons side by side; skip missing pictures."""
    tiles = [scene.rgb] if scene.rgb is not None else []
    if scene.gray is not None:
        tiles.append(np.repeat(srgb_of_bytes(scene.gray)[..., None], 3, axis=2))
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


def _reason_picture(scene: SceneContent) -> UInt8[np.ndarray, "h w 3"]:
    table = np.full((256, 3), 90, dtype=np.uint8)
    for number, name in scene.reason_name.items():
        if name in REASON_COLOR:
            table[number] = list(bytes.fromhex(REASON_COLOR[name][1:]))
    return table[scene.reason]
