"""Evaluate a file of estimated poses against a dataset, and write the results."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.tables import csv_text, markdown_table
from ...dataset.export.split import Split
from ...dataset.files.json_text import plain
from ...dataset.read.example import Example
from ...dataset.read.pose_results import PoseEstimate, read_pose_results
from ...dataset.training import Examples, open_examples
from ...dataset.write.models import read_models
from .intervals import Interval, draw_scenes, interval_of
from .judging import GroupRow, Protocol
from .pose_recall import Counts, PictureTruth, count_picture, solid_of

POSES = "poses.json"
FIGURES = (
    "AR",
    "AR_VSD",
    "AR_MSSD",
    "AR_MSPD",
    "within_5deg_3mm",
    "rotation_deg",
    "translation_mm",
)
_SHARES = FIGURES[:5]
# If the median distance of estimates from the camera differs from the true one by a larger factor,
# the two have different units.
_UNIT = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEvaluation:
    """An evaluation of one file of poses: the data, the protocol and the results.

    Attributes:
        seconds: median time per picture; NaN if the file has no times.
    """

    results: str
    dataset: str
    split: str
    scenes: int
    estimates: int
    seconds: float
    protocol: Protocol
    rows: tuple[GroupRow, ...]


def evaluate_poses(
    results: Path,
    dataset: Path,
    *,
    split: str = "train",
    division: Split | None = None,
    protocol: Protocol,
    progress: ProgressMeter = UNWATCHED,
) -> PoseEvaluation:
    """Return the evaluation of a file in BOP's format against the true poses of a dataset.

    Raises:
        GraycastError: the file or the dataset is missing or damaged, or they do not fit together.
    """
    estimates = read_pose_results(results)
    models = read_models(dataset)
    solids = {k: solid_of(m.mesh, m.symmetry, m.diameter_m) for k, m in models.items()}
    examples = open_examples(dataset, split=split, division=division)
    of_picture = _by_picture(results, estimates, _of_first_scanner(examples), solids)
    counts: list[Counts] = []
    checked = False
    for done, picture in enumerate(of_picture, start=1):
        truth = _truth(dataset, examples.read(picture), protocol.min_visibility)
        if not checked and len(truth.T_cam_part):
            _check_unit(results, estimates, truth)
            checked = True
        counts += count_picture(truth, of_picture[picture], solids)
        progress.count("scenes", done, len(of_picture))
    scene_of = {picture: examples.place_of[picture][0] for picture in of_picture}
    times = {(one.scene_id, one.im_id): one.time_s for one in estimates if one.time_s >= 0}
    return PoseEvaluation(
        results=results.name,
        dataset=dataset.resolve().name,
        split=split,
        scenes=len(set(scene_of.values())),
        estimates=len(estimates),
        seconds=float(np.median(list(times.values()))) if times else float("nan"),
        protocol=protocol,
        rows=pose_rows(counts, scene_of, dict(examples.categories), protocol),
    )


def pose_rows(
    counts: Sequence[Counts],
    scene_of: Mapping[int, int],
    categories: Mapping[int, str],
    protocol: Protocol,
) -> tuple[GroupRow, ...]:
    """Return `FIGURES` over all parts, then for each part if there are several.

    The last two figures are medians. Intervals come from draws of whole scenes. `scene_of` maps the
    number of each picture in `counts` to its scene.
    """
    times = draw_scenes(list(scene_of.values()), seed=protocol.seed, draws=protocol.draws)
    rows = [_pose_row("all", "all", counts, scene_of, times)]
    present = sorted({one.obj_id for one in counts})
    if len(present) > 1:
        for obj_id in present:
            mine = [one for one in counts if one.obj_id == obj_id]
            name = categories.get(obj_id, str(obj_id))
            rows.append(_pose_row("class", name, mine, scene_of, times))
    return tuple(rows)


def _pose_row(
    by: str,
    name: str,
    counts: Sequence[Counts],
    scene_of: Mapping[int, int],
    times: Int[np.ndarray, "draws pictures"],
) -> GroupRow:
    scenes = len(set(scene_of.values()))
    hits, to_find = np.zeros((len(scene_of), 4)), np.zeros(len(scene_of))
    angle: list[list[float]] = [[] for _ in scene_of]
    shift: list[list[float]] = [[] for _ in scene_of]
    place = {picture: k for k, picture in enumerate(scene_of)}
    for one in counts:
        k = place[one.scene_id]
        to_find[k] += one.to_find
        hits[k] += [one.vsd.mean(), one.mssd.mean(), one.mspd.mean(), one.near]
        angle[k] += np.degrees(one.angle_rad).tolist()
        shift[k] += (1000 * one.shift_m).tolist()

    def recalls(weight: Float[np.ndarray, "draws pictures"]) -> Float[np.ndarray, "draws 5"]:
        with np.errstate(invalid="ignore"):
            each = (weight @ hits) / (weight @ to_find)[:, None]
        return np.column_stack([each[:, :3].mean(axis=1), each])

    value, resampled = recalls(np.ones((1, len(scene_of))))[0], recalls(times.astype(float))
    figures = {
        figure: interval_of(float(value[k]), resampled[:, k], scenes)
        for k, figure in enumerate(_SHARES)
    }
    figures["rotation_deg"] = _median(angle, times, scenes)
    figures["translation_mm"] = _median(shift, times, scenes)
    return GroupRow(by=by, name=name, to_find=int(to_find.sum()), figures=figures)


def _median(
    of_picture: list[list[float]], times: Int[np.ndarray, "draws pictures"], scenes: int
) -> Interval:
    """Return the median error with its interval; a draw weights a picture by its scene."""
    values = np.array([x for errors in of_picture for x in errors])
    if not len(values):
        return Interval(value=float("nan"), low=float("nan"), high=float("nan"))
    picture = np.repeat(np.arange(len(of_picture)), [len(errors) for errors in of_picture])
    order = np.argsort(values, kind="stable")
    total = np.cumsum(times[:, picture[order]], axis=1)
    place = (2 * total >= total[:, -1:]).argmax(axis=1)
    medians = np.where(total[:, -1] > 0, values[order][place], np.nan)
    return interval_of(float(np.median(values)), medians, scenes)


def _of_first_scanner(examples: Examples) -> dict[tuple[int, int], int]:
    """Return pictures by scene and image; BOP's result files cannot name other scanners."""
    sensors = [sensor for _, sensor, _ in examples.place_of.values()]
    return {
        (scene_id, image): picture
        for picture, (scene_id, sensor, image) in examples.place_of.items()
        if sensor == sensors[0]
    }


def _by_picture(
    results: Path,
    estimates: Sequence[PoseEstimate],
    pictures: Mapping[tuple[int, int], int],
    solids: Mapping[int, object],
) -> dict[int, list[PoseEstimate]]:
    of_picture: dict[int, list[PoseEstimate]] = {picture: [] for picture in pictures.values()}
    for one in estimates:
        if (one.scene_id, one.im_id) not in pictures:
            raise GraycastError(
                f"{results}: has scene {one.scene_id}, image {one.im_id}, which the dataset's set "
                "does not have: give results of the same dataset and set (only images of the "
                "first scanner are judged)"
            )
        if one.obj_id not in solids:
            raise GraycastError(
                f"{results}: has object {one.obj_id}, the dataset has "
                f"{', '.join(map(str, sorted(solids)))}: give results of this dataset"
            )
        of_picture[pictures[one.scene_id, one.im_id]].append(one)
    return of_picture


def _check_unit(results: Path, estimates: Sequence[PoseEstimate], truth: PictureTruth) -> None:
    """Refuse poses whose distances from the camera suggest a unit other than millimetres."""
    if not estimates:
        return
    estimated_m = np.median([np.linalg.norm(one.T_cam_part[:3, 3]) for one in estimates])
    true_m = np.median(np.linalg.norm(truth.T_cam_part[:, :3, 3], axis=1))
    if true_m / _UNIT <= estimated_m <= true_m * _UNIT:
        return
    unit = "metres" if true_m / 2000 < estimated_m < true_m / 500 else "another unit or frame"
    raise GraycastError(
        f"{results}: the poses have a median distance of {1000 * estimated_m:.4g} mm from the "
        f"camera, and the parts {1000 * true_m:.4g} mm: t seems to be in {unit}; write it in "
        "millimetres, in the camera's frame"
    )


def _truth(dataset: Path, example: Example, min_visibility: float) -> PictureTruth:
    measured = example.scanner_depth_m if example.scanner_depth_m is not None else example.depth_m
    if example.obj_id is None or example.T_cam_part is None or measured is None:
        raise GraycastError(
            f"{dataset}: scene {example.scene_id} has no poses or no depth: give a dataset that "
            "graycast generate made"
        )
    return PictureTruth(
        scene_id=example.scene_id,
        camera=example.camera,
        measured_m=measured.astype(np.float64),
        obj_id=example.obj_id,
        T_cam_part=example.T_cam_part,
        to_find=~example.hidden(min_visibility),
    )


# --- files ----------------------------------------------------------------------------------------


def write_poses(evaluation: PoseEvaluation, folder: Path) -> None:
    """Write `poses.json`, `poses.csv` and `poses.md` into a folder."""
    content = plain(
        {
            "results": evaluation.results,
            "dataset": evaluation.dataset,
            "split": evaluation.split,
            "scenes": evaluation.scenes,
            "estimates": evaluation.estimates,
            "median_s": evaluation.seconds,
            "min_visibility": evaluation.protocol.min_visibility,
            "draws": evaluation.protocol.draws,
            "seed": evaluation.protocol.seed,
            "rows": [
                {"name": row.name, "to_find": row.to_find}
                | {name: asdict(figure) for name, figure in row.figures.items()}
                for row in evaluation.rows
            ],
        }
    )
    text = json.dumps(content, indent=1, allow_nan=False)
    (folder / POSES).write_text(text + "\n", encoding="utf-8")
    table = csv_text(
        ["part", "to_find", "figure", "value", "low", "high"],
        (
            [row.name, row.to_find, name, *figure.cells()]
            for row in evaluation.rows
            for name, figure in row.figures.items()
        ),
    )
    (folder / "poses.csv").write_text(table, encoding="utf-8")
    (folder / "poses.md").write_text(poses_markdown(evaluation), encoding="utf-8")


def poses_markdown(evaluation: PoseEvaluation) -> str:
    """Return a Markdown paragraph and a table with the figures."""
    time = (
        "" if np.isnan(evaluation.seconds) else f" {evaluation.seconds:.2f} s a picture (median)."
    )
    sentence = (
        f"{evaluation.estimates} poses of {evaluation.results} in {evaluation.scenes} scenes of "
        f"{evaluation.dataset} (set {evaluation.split}), {evaluation.rows[0].to_find} instances to "
        f"find; those of less than {evaluation.protocol.min_visibility:.0%} visibility are "
        f"ignored.{time}"
    )
    heads = ["part", "to find", *_SHARES[:-1], "within 5 deg, 3 mm"]
    heads += ["rotation (median)", "translation (median)"]
    rows = [
        [
            *(row.name, str(row.to_find)),
            *(row.figures[name].text() for name in _SHARES),
            row.figures["rotation_deg"].text(".2f", unit=" deg"),
            row.figures["translation_mm"].text(".2f", unit=" mm"),
        ]
        for row in evaluation.rows
    ]
    return f"{sentence}\n\n{markdown_table(heads, rows)}\n"
