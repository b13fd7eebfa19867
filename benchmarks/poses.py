"""Success rate and time of pose estimation, for the table of docs/measurements/pose.md."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from pycocotools import mask as coco_mask

from graycast.base.errors import GraycastError
from graycast.base.folder import new_folder
from graycast.base.frames import transform_points
from graycast.dataset.export.split import Split
from graycast.dataset.read.detections import Detections
from graycast.dataset.read.pose_results import PoseEstimate, pose_results_text
from graycast.dataset.training import Example, Examples, open_examples
from graycast.dataset.write.models import StoredModel, read_models
from graycast.rig.meshdepth import rasterize
from graycast.robot.pose import PoseMatch, PoseModel, find_pose, find_pose_in_box, pose_model
from graycast.score.evaluate import rotation_translation, wilson
from graycast.world.parts import Mesh
from graycast.world.parts.symmetry import joined, motions, shape_symmetry

from .figures import Figures, Show

MIN_VISIBILITY, SEED = 0.7, 0  # limit and seed for sampling instances
NEAR_DEG, NEAR_MM = 5.0, 3.0  # largest errors of a correct pose
BOXES = {"box": 1.0, "box +20%": 1.2, "box -20%": 0.8}  # scale factors of boxes about their middle
CASES = (
    *(("scanner", region) for region in ("mask", *BOXES)),
    ("perfect", "mask"),
    ("perfect", "box"),
)
DETECTED = (("scanner", "detected mask"), ("scanner", "detected box"))  # cases with a detector
LEAST_IOU = 0.5  # least IoU of the boxes of an instance and its detection
SHEET, COLUMNS, TILE_PX = 24, 6, 220  # number of instances on a sheet; layout of the sheet
OUTLINE_M = 0.004  # An outline is drawn where the second difference of depth is larger.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Subject:
    """A dataset with the models and symmetries of its parts."""

    name: str
    examples: Examples
    stored: dict[int, StoredModel]
    model: dict[int, PoseModel]
    strict: dict[int, Float[np.ndarray, "_ 4 4"]]
    shape: dict[int, Float[np.ndarray, "_ 4 4"]]
    obj_ids: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Trial:
    """One instance in one case: the estimated pose and its error."""

    example: Example
    instance: int
    estimate: PoseMatch
    cpu_s: float
    detected: bool = True
    angle_deg: float = math.inf
    shift_mm: float = math.inf
    strict: bool = False

    @property
    def near(self) -> bool:
        return self.angle_deg <= NEAR_DEG and self.shift_mm <= NEAR_MM


def measure(
    *,
    datasets: Sequence[Path],
    instances: int,
    detector: Path | None = None,
    out: Path | None = None,
    min_visibility: float = MIN_VISIBILITY,
    show: Show,
) -> Figures:
    """Return a row for each dataset and case: the share of poses within 5 degrees and 3 mm.

    `share` allows for the symmetry of the part's shape, because depth shows only the shape.
    `strict` allows only for the symmetry that the dataset states, in which print may distinguish
    sides.

    Args:
        instances: number of instances sampled from each dataset.
        detector: the folder of a trained detector. The instances are then from its test scenes, and
            its masks and boxes are two further cases. An instance is matched to the detection of
            its class whose box has the largest IoU with its box, at least `LEAST_IOU`.
        out: a new folder for the poses in BOP's result format and for pictures of the poses.
        min_visibility: least visible share of a sampled instance.

    Raises:
        GraycastError: a dataset is missing or damaged, or has no such instances.
    """
    opened = None if detector is None else _opened(detector)
    rows, texts, sheets = [], {}, {}
    for k, folder in enumerate(datasets):
        subject = _subject(folder, opened)
        selection = _selection(subject.examples, instances, min_visibility)
        cases = CASES if opened is None else (*CASES, *DETECTED)
        trials: dict[tuple[str, str], list[_Trial]] = {case: [] for case in cases}
        for scene_id, places in selection.items():
            show(f"{subject.name}, scene {scene_id}")
            example = subject.examples.read(scene_id)
            for case in CASES:
                trials[case] += _trials(subject, example, places, case)
            if opened is not None:
                detections = opened.detect(example, obj_ids=subject.obj_ids)
                for case in DETECTED:
                    trials[case] += _trials(subject, example, places, case, detections)
        for case, case_trials in trials.items():
            rows.append(
                {"dataset": subject.name, "depth": case[0], "region": case[1]} | _row(case_trials)
            )
            name = f"{k}_{subject.name}_{case[0]}_{case[1].replace(' ', '').replace('%', '')}"
            texts[f"{name}.csv"] = pose_results_text(list(_estimates(case_trials)))
        worst = sorted(trials[CASES[0]], key=lambda trial: trial.near)[:SHEET]
        sheets[f"{k}_{subject.name}.png"] = _sheet(subject, worst)
    if out is not None:
        with new_folder(out) as aside:
            for name, text in texts.items():
                (aside / name).write_text(text, encoding="utf-8")
            for name, picture in sheets.items():
                cv2.imwrite(str(aside / name), picture[..., ::-1])
    settings = {"instances": instances, "min_visibility": min_visibility, "seed": SEED}
    return settings | {"rows": rows}


def _subject(folder: Path, detector: Any | None) -> _Subject:
    stored = read_models(folder)
    if detector is None:
        examples = open_examples(folder)
    else:
        split = detector.about.trained["settings"]["split"]
        division = Split(shares=tuple(split["shares"]), seed=split["seed"])
        examples = open_examples(folder, split="test", division=division)
    shapes = {k: joined(one.symmetry, shape_symmetry(one.mesh)) for k, one in stored.items()}
    return _Subject(
        name=folder.resolve().name,
        examples=examples,
        stored=stored,
        model={k: pose_model(one.mesh, shapes[k]) for k, one in stored.items()},
        strict={k: motions(one.symmetry) for k, one in stored.items()},
        shape={k: motions(symmetry) for k, symmetry in shapes.items()},
        obj_ids={} if detector is None else detector.about.obj_ids(examples.categories, folder),
    )


def _opened(run: Path) -> Any:
    from graycast.learn.detect import load_detector  # This import needs torch.

    return load_detector(run)


def _selection(examples: Examples, instances: int, min_visibility: float) -> dict[int, list[int]]:
    """Sample instances that are visible enough; return their indices by scene."""
    there = []
    for scene_id in examples.scene_ids:
        example = examples.read(scene_id)
        if example.T_cam_part is None or example.scanner_depth_m is None or example.depth_m is None:
            raise GraycastError(
                f"{examples.folder}: scene {scene_id} lacks poses or one of the depths: give a "
                "dataset that graycast generate made"
            )
        if example.visib_fract is None:
            raise GraycastError(
                f"{examples.folder}: scene {scene_id} does not know what share of each instance is "
                "visible: give a dataset that graycast generate made"
            )
        there += [(scene_id, i) for i in np.flatnonzero(example.visib_fract >= min_visibility)]
    if not there:
        raise GraycastError(
            f"{examples.folder}: no instance is visible for {min_visibility:.0%} or more: "
            "give another dataset"
        )
    rng = np.random.default_rng(SEED)
    order = sorted(rng.permutation(len(there))[:instances].tolist())
    selection: dict[int, list[int]] = {}
    for k in order:
        selection.setdefault(there[k][0], []).append(int(there[k][1]))
    return selection


def _trials(
    subject: _Subject,
    example: Example,
    places: Sequence[int],
    case: tuple[str, str],
    detections: Detections | None = None,
) -> Iterator[_Trial]:
    depth_m = _needed(example.scanner_depth_m if case[0] == "scanner" else example.depth_m, example)
    T_cam_part = _needed(example.T_cam_part, example)
    camera = example.camera
    for place in places:
        obj_id = _obj_id(example, place)
        model = subject.model[obj_id]
        region = _region(example, place, case[1], detections)
        began = time.process_time()
        if region is None:
            estimate = PoseMatch(T_cam_part=None, score=0.0)
        elif region.ndim == 2:
            estimate = find_pose(model, depth_m, camera, region)
        else:
            estimate = find_pose_in_box(model, depth_m, camera, region)
        cpu_s = time.process_time() - began
        trial = _Trial(
            example=example,
            instance=place,
            estimate=estimate,
            cpu_s=cpu_s,
            detected=region is not None,
        )
        if estimate.T_cam_part is None:
            yield trial
            continue
        true, middle = T_cam_part[place], subject.stored[obj_id].mesh.bounds_m.mean(axis=0)
        off = [
            rotation_translation(estimate.T_cam_part, true, one[obj_id], middle_m=middle)
            for one in (subject.shape, subject.strict)
        ]
        (angle, shift), (strict_angle, strict_shift) = off
        yield replace(
            trial,
            angle_deg=math.degrees(angle),
            shift_mm=1000 * shift,
            strict=math.degrees(strict_angle) <= NEAR_DEG and 1000 * strict_shift <= NEAR_MM,
        )


def _region(
    example: Example, place: int, region: str, detections: Detections | None
) -> np.ndarray | None:
    """Return a mask or a box [x, y, columns, rows]; None if the detector missed the instance."""
    if region == "mask":
        return _needed(example.mask, example)[place]
    box_px = _needed(example.box_px, example)[place]
    if detections is None:
        return scaled(box_px.astype(np.float64), BOXES[region])
    alike = np.flatnonzero(detections.obj_id == _obj_id(example, place))
    if not len(alike):
        return None
    true = box_px.astype(float).tolist()
    overlap = np.asarray(coco_mask.iou(detections.box_px[alike].tolist(), [true], [0]))[:, 0]
    if overlap.max() < LEAST_IOU:
        return None
    best = alike[overlap.argmax()]
    if region == "detected box" or detections.mask is None:
        return detections.box_px[best]
    return np.asarray(coco_mask.decode(dict(detections.mask[best]))).astype(bool)


def _needed(value: np.ndarray | None, example: Example) -> np.ndarray:
    if value is None:
        raise GraycastError(
            f"scene {example.scene_id} lacks a picture, a depth or labels: give a dataset that "
            "graycast generate made"
        )
    return value


def _obj_id(example: Example, place: int) -> int:
    return int(_needed(example.obj_id, example)[place])


def scaled(box_px: Float[np.ndarray, "4"], factor: float) -> Float[np.ndarray, "4"]:
    """Return a box [x, y, columns, rows] with its sides scaled about its middle."""
    middle, size = box_px[:2] + box_px[2:] / 2, box_px[2:] * factor
    return np.concatenate([middle - size / 2, size])


def _row(trials: Sequence[_Trial]) -> Figures:
    near = [trial.near for trial in trials]
    low, high = wilson(sum(near), len(near))
    return {
        "n": len(trials),
        "share": sum(near) / len(near),
        "low": low,
        "high": high,
        "detected": sum(trial.detected for trial in trials) / len(trials),
        "strict": sum(trial.strict for trial in trials) / len(trials),
        "rotation_deg": median(trial.angle_deg for trial in trials),
        "translation_mm": median(trial.shift_mm for trial in trials),
        "cpu_s": median(trial.cpu_s for trial in trials),
    }


def _estimates(trials: Sequence[_Trial]) -> Iterator[PoseEstimate]:
    """Yield the estimated poses; as in BOP, their time is that of the whole picture."""
    seconds: dict[int, float] = {}
    for trial in trials:
        scene_id = trial.example.scene_id
        seconds[scene_id] = seconds.get(scene_id, 0.0) + trial.cpu_s
    for trial in trials:
        if trial.estimate.T_cam_part is not None:
            yield PoseEstimate(
                scene_id=trial.example.scene_id,
                im_id=0,
                obj_id=_obj_id(trial.example, trial.instance),
                score=trial.estimate.score,
                T_cam_part=trial.estimate.T_cam_part.copy(),
                time_s=round(seconds[trial.example.scene_id], 6),
            )


def _sheet(subject: _Subject, trials: Sequence[_Trial]) -> UInt8[np.ndarray, "h w 3"]:
    """Return a sheet of crops with the part's outline at the estimated pose, red if it is wrong."""
    tiles = [_tile(subject, trial) for trial in trials]
    blank = np.zeros((TILE_PX, TILE_PX, 3), np.uint8)
    tiles += [blank] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def _tile(subject: _Subject, trial: _Trial) -> UInt8[np.ndarray, "t t 3"]:
    example = trial.example
    picture = example.rgb
    if picture is None:
        picture = np.repeat(_needed(example.gray, example)[..., None], 3, 2)
    x, y, columns, rows = map(int, _needed(example.box_px, example)[trial.instance])
    half = int(0.75 * max(columns, rows)) + 4
    grown = cv2.copyMakeBorder(picture, half, half, half, half, cv2.BORDER_CONSTANT)
    at = (x + columns // 2, y + rows // 2)
    crop = grown[at[1] : at[1] + 2 * half, at[0] : at[0] + 2 * half]
    big = cv2.resize(crop, (TILE_PX, TILE_PX), interpolation=cv2.INTER_LINEAR)
    T_cam_part = trial.estimate.T_cam_part
    if T_cam_part is not None:
        mesh = subject.stored[_obj_id(example, trial.instance)].mesh
        origin = (at[0] - half, at[1] - half)
        _outline(big, mesh, trial, T_cam_part, origin, TILE_PX / (2 * half))
    text = f"{trial.angle_deg:.1f} deg {trial.shift_mm:.1f} mm"
    cv2.putText(big, text, (4, TILE_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return big


def _outline(
    big: np.ndarray,
    mesh: Mesh,
    trial: _Trial,
    T_cam_part: Float[np.ndarray, "4 4"],
    origin: tuple[int, int],
    zoom: float,
) -> None:
    """Draw the outline and the depth steps of the part at the resolution of the tile."""
    camera = trial.example.camera
    fine = replace(
        camera,
        width_px=TILE_PX,
        height_px=TILE_PX,
        fx_px=camera.fx_px * zoom,
        fy_px=camera.fy_px * zoom,
        cx_px=(camera.cx_px - origin[0] + 0.5) * zoom - 0.5,
        cy_px=(camera.cy_px - origin[1] + 0.5) * zoom - 0.5,
    )
    vertices = transform_points(T_cam_part, mesh.vertices_m.astype(np.float64))
    z = np.nan_to_num(rasterize(vertices, mesh.faces, fine).over(fine)[1], nan=10.0)
    bend = np.zeros(z.shape, bool)  # True at steps and creases, but not on a steep plane.
    bend[1:-1] |= np.abs(np.diff(z, n=2, axis=0)) > OUTLINE_M
    bend[:, 1:-1] |= np.abs(np.diff(z, n=2, axis=1)) > OUTLINE_M
    big[bend] = (61, 220, 132) if trial.near else (255, 77, 77)
