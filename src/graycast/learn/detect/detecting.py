"""Detection in a dataset or in pictures: COCO results, drawings and times."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, final

import cv2
import numpy as np

from ...base.errors import GraycastError
from ...base.file_limits import parse_json
from ...base.folder import refuse_foreign, whole_folder
from ...base.progress import UNWATCHED, ProgressMeter
from ...dataset.export.record import RECORD, read_record
from ...dataset.export.split import Split
from ...dataset.files.json_text import json_bytes
from ...dataset.files.places import CLAIM
from ...dataset.read.detections import DETECT_JSON, RESULTS, Detections, results_bytes
from ...dataset.read.example import Example, display_image
from ...dataset.training import Examples, open_examples
from ...dataset.training.foreign import is_foreign
from ...real.depth_file import FileOptions
from ...real.depth_sense import filled_holes
from ...real.picture_pairs import RealPicture, find_shots, read_shot
from .detector import About, Detector
from .drawing import LEAST_SCORE, draw_detections
from .encoding import Encoding

DRAWINGS = "drawings"
LEAST_INSIDE = 0.5  # A note warns if less of a picture's depth is in the range of the training set.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionResult:
    """Detections in pictures, the time for each picture [ms], and notes on depth and drawings."""

    found: tuple[Detections, ...]
    ms_per_picture: tuple[float, ...]
    notes: tuple[str, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PictureSelection:
    """Pictures for detection, which are read one by one, and a record of their source.

    `class_ids` has the id of each class in the results; `record` is written to `detect.json`.
    """

    examples: Iterable[Example]
    scene_ids: tuple[int, ...]
    class_ids: Mapping[str, int]
    record: Mapping[str, Any]


def detect(
    detector: Detector,
    pictures: PictureSelection,
    out: Path | str,
    *,
    most: int = 300,
    least_score: float = 0.05,
    drawings: int = 12,
    progress: ProgressMeter = UNWATCHED,
) -> DetectionResult:
    """Detect parts in pictures; write `results.json`, `detect.json` and drawings to `out`.

    Args:
        drawings: number of pictures that are drawn with their detections.
        progress: meter that counts the pictures.

    Raises:
        GraycastError: a picture lacks the detector's input, or `out` holds other files or cannot be
            written.
    """
    out = Path(out)
    refuse_foreign(out, DETECT_JSON)
    detections, times_ms, notes = [], [], list[str]()
    names = {number: name for name, number in pictures.class_ids.items()}
    with whole_folder(out) as folder:
        (folder / DRAWINGS).mkdir()
        for example in pictures.examples:
            begun = time.perf_counter()
            detections.append(
                detector.detect(
                    example, obj_ids=pictures.class_ids, most=most, least_score=least_score
                )
            )
            times_ms.append(1e3 * (time.perf_counter() - begun))
            notes += _notes(example, detector.about.encoding)
            if len(detections) <= drawings:
                path = folder / DRAWINGS / f"{example.scene_id:06d}.jpg"
                image = draw_detections(display_image(example), detections[-1], names)
                path.write_bytes(cv2.imencode(".jpg", image[..., ::-1])[1].tobytes())
            progress.count("pictures", len(detections), len(pictures.scene_ids))
        about = detector.about
        content = {
            "model": about.model,
            "backbone": about.backbone,
            "input": about.encoding.input,
            "names": list(about.names),
            "scene_ids": [each.scene_id for each in detections],
            "ms_per_picture": [round(ms, 3) for ms in times_ms],
            "most": most,
            "least_score": least_score,
            **pictures.record,
        }
        (folder / DETECT_JSON).write_bytes(json_bytes(content))
        (folder / RESULTS).write_bytes(results_bytes(detections))
    first = detections[:drawings]
    if bare := sum(len(one) > 0 and one.score.max() < LEAST_SCORE for one in first):
        words = f"{bare} of {len(first)} drawings show no outline"
        notes.insert(0, f"{words}: detections are drawn from a score of {LEAST_SCORE:g} on")
    return DetectionResult(
        found=tuple(detections), ms_per_picture=tuple(times_ms), notes=tuple(notes)
    )


def _notes(example: Example, encoding: Encoding) -> Iterator[str]:
    """Yield notes on depth that the detector may misread: filled holes, or an unknown range."""
    if encoding.near_m is None or encoding.far_m is None:
        return
    name, depth_m = f"scene {example.scene_id}", encoding.depth_m(example)
    if note := filled_holes(depth_m, name):
        yield note
    known = depth_m[np.isfinite(depth_m)]
    inside = np.mean((known >= encoding.near_m) & (known <= encoding.far_m)) if known.size else 1.0
    if inside < LEAST_INSIDE:
        yield (
            f"{name}: only {inside:.0%} of the depth lies in the range that the detector learnt, "
            f"{encoding.near_m:.4g} to {encoding.far_m:.4g} m, and the rest is cut off there"
        )


def _examples(shots: Sequence[RealPicture], scale_m: float | None) -> Iterator[Example]:
    """Yield pictures as read by `import_real`, without labels, numbered in the order of names.

    Raises:
        DatasetError: a picture is damaged.
    """
    for i, shot in enumerate(shots):
        # The detector works in pixels and along the axis, so it needs no intrinsics.
        images = read_shot(shot, FileOptions(K=np.eye(3), scale_m=scale_m))
        depth_m = None if images.depth_m is None else images.depth_m.astype(np.float32)
        yield Example(scene_id=i, rgb=images.rgb, gray=images.gray, scanner_depth_m=depth_m)


def detection_record(folder: Path) -> dict[str, Any]:
    """Return the scenes and settings of an earlier `detect` in a folder; else an empty dictionary.

    Raises:
        GraycastError: the file `detect.json` is damaged.
    """
    try:
        return dict(parse_json((folder / DETECT_JSON).read_bytes()))
    except FileNotFoundError:
        return {}
    except (OSError, TypeError, ValueError) as error:
        raise GraycastError(
            f"{folder}: has no readable {DETECT_JSON}: remove the folder"
        ) from error


def pictures_of(
    folder: Path | str,
    about: About,
    *,
    split: str,
    scale_m: float | None = None,
    as_real: bool = False,
) -> PictureSelection:
    """Return the pictures of a dataset, of an export, or of a folder of real pictures.

    Args:
        split: a set, or `all`. A dataset's scenes are divided as in the detector's training.
        scale_m: metres per unit of integer depth files.
        as_real: whether to hide perfect depth, which a real camera does not have: a detector that
            was trained on it then gets the scanner's depth.

    Raises:
        GraycastError: the folder has no such pictures, or none of the detector's parts.
    """
    folder = Path(folder)
    if not (any((folder / name).is_file() for name in (CLAIM, RECORD)) or is_foreign(folder)):
        if split != "all":
            raise GraycastError(f"{folder}: is not a dataset, so it has no set {split}: choose all")
        shots = find_shots(folder)
        return PictureSelection(
            examples=_examples(shots, scale_m),
            scene_ids=tuple(range(len(shots))),
            class_ids={name: i for i, name in enumerate(about.names, start=1)},
            record={"pictures": [shot.stem for shot in shots], "split": None, "division": None},
        )
    division_record = about.trained["settings"]["split"]
    division = Split(shares=tuple(division_record["shares"]), seed=division_record["seed"])
    sets, record = sets_of(folder, split, division)
    examples: Iterable[Example] = chain.from_iterable(sets)
    return PictureSelection(
        examples=(replace(each, depth_m=None) for each in examples) if as_real else examples,
        scene_ids=tuple(scene_id for each in sets for scene_id in each.scene_ids),
        class_ids=about.obj_ids(sets[0].categories, folder),
        record={
            "dataset": str(folder),
            "as_real": as_real,
            "content": [each.content_sum() for each in sets],
            **record,
        },
    )


def sets_of(folder: Path, split: str, division: Split) -> tuple[list[Examples], dict[str, Any]]:
    """Return the examples of one set, or of all sets (`all`), and a record of this choice."""
    if (folder / RECORD).is_file():
        splits = read_record(folder).splits if split == "all" else (split,)
        record: dict[str, Any] = {"split": None if split == "all" else split, "division": None}
        return [open_examples(folder, split=name) for name in splits], record
    if split == "all":
        return [open_examples(folder)], {"split": "train", "division": None}
    record = {"split": split, "division": {"shares": division.shares, "seed": division.seed}}
    return [open_examples(folder, split=split, division=division)], record
