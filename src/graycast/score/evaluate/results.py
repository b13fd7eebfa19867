"""Detections to evaluate: a file of COCO results, or a folder of `graycast detector find`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import GraycastError
from ...base.file_limits import parse_json
from ...base.public_value import public_value
from ...dataset.export.split import Split
from ...dataset.read.detections import DETECT_JSON, RESULTS, Detections, read_results


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionRun:
    """The content of `detect.json`; fields are None for a single file of results.

    Attributes:
        path: path of the results.
        scene_ids: ids of the scenes in which the detector searched.
        split: name of the set of these scenes; `division` divides the dataset into such sets.
        ms_per_picture: milliseconds per picture, in the order of the scenes.
    """

    path: Path
    scene_ids: tuple[int, ...] | None = None
    split: str | None = None
    division: Split | None = None
    model: str | None = None
    input: str | None = None
    ms_per_picture: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Name of the folder of `graycast detector find`, or of the file of results."""
        path = self.path.resolve()
        return path.parent.name if self.scene_ids is not None else path.name

    @property
    def median_ms(self) -> float:
        return float(np.median(self.ms_per_picture)) if self.ms_per_picture else float("nan")


def open_run(path: Path) -> DetectionRun:
    """Open results, with the record of their run.

    Raises:
        GraycastError: there are no results, or `detect.json` is missing or damaged.
    """
    if not path.is_dir():
        return DetectionRun(path=path)
    if not (path / RESULTS).is_file():
        raise GraycastError(
            f"{path}: has no {RESULTS}: give a folder that graycast detector find wrote, or a "
            "file of COCO results"
        )
    if not (path / DETECT_JSON).is_file():
        raise GraycastError(
            f"{path}: has no {DETECT_JSON}, which lists the scenes of the detections: give "
            f"{path / RESULTS} itself, and state its set of scenes with --split"
        )
    return _run(path / RESULTS, path / DETECT_JSON)


def read_detections(
    run: DetectionRun, scene_ids: Sequence[int], categories: Mapping[int, str]
) -> list[Detections]:
    """Return the detections in the given scenes.

    Raises:
        GraycastError: the results are damaged, or have other scenes or objects.
    """
    scene_ids_of_run = scene_ids if run.scene_ids is None else run.scene_ids
    if odd := set(scene_ids) - set(scene_ids_of_run):
        raise GraycastError(
            f"{run.path}: scene {min(odd)} was not used by graycast detector find: score the set "
            "of scenes that it used"
        )
    detections = read_results(run.path, scene_ids_of_run, obj_ids=set(categories))
    wanted = set(scene_ids)
    return [one for one in detections if one.scene_id in wanted]


def _run(results: Path, path: Path) -> DetectionRun:
    try:
        record = parse_json(path.read_bytes())
        division = record["division"]
        return DetectionRun(
            path=results,
            scene_ids=tuple(_whole(scene_id) for scene_id in record["scene_ids"]),
            split=record["split"],
            division=None
            if division is None
            else Split(shares=tuple(division["shares"]), seed=_whole(division["seed"])),
            model=record["model"],
            input=record["input"],
            ms_per_picture=tuple(float(ms) for ms in record["ms_per_picture"]),
        )
    except OSError as error:
        raise GraycastError(f"{path}: cannot be read ({error.strerror})") from error
    except KeyError as error:
        raise GraycastError(f"{path}: lacks {error}: run graycast detector find again") from error
    except (ValueError, TypeError) as error:
        raise GraycastError(
            f"{path}: is damaged ({error}): run graycast detector find again"
        ) from error


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"{value!r} is not a whole number")
    return value
