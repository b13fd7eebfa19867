"""Runs of a study: each is trained once, scored on all test sets, and kept on disk."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path
from typing import final

from ...base.errors import GraycastError
from ...base.file_limits import parse_json
from ...base.progress import UNWATCHED, ProgressMeter
from ...dataset.files.json_text import json_bytes
from ...dataset.files.seal import sha256
from ...dataset.read.detections import RESULTS, WEIGHTS, Detections, read_results
from ...dataset.read.example import Example
from ...score.evaluate import Labels, Scores, labels_of, score
from ...score.evaluate.intervals import BootstrapFigure, bootstrap, mean
from ...score.evaluate.judging import KINDS
from ...score.evaluate.matching import Kind
from ...score.evaluate.task import as_one_class
from ..detect import Detector, TrainSpec, detect, pictures_of, train
from ..detect.detecting import detection_record, sets_of
from ..detect.encoding import Encoding
from ..detect.networks import network_class
from ..study_file import EncodingSection, ModelSection, StudySpec, TestSection

FIGURE = "ap50"  # The study uses the same figure as the paper.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StudyRun:
    """One combination of a study: model, input, encoding, training and seed."""

    model: ModelSection
    input: str
    encoding: EncodingSection
    training: str
    seed: int

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        words = [self.model.model, self.model.backbone, self.input, self.encoding.name]
        words += [self.training, f"seed{self.seed}"]
        return "_".join(word for word in words if word)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """A run's scores for each test set ("world") and kind of shape, one per dataset."""

    run: StudyRun
    figures: dict[tuple[str, str], tuple[BootstrapFigure, ...]]

    def of(self, world: str, kind: str, number: int | None = None) -> BootstrapFigure | None:
        """Return the score on dataset `number` of a world; without a number, the mean over all.

        The result is None if the run or the world has no masks, or if there is no such dataset.
        """
        figures = self.figures.get((world, kind))
        if figures is None or number is None:
            return None if figures is None else mean(figures)
        return figures[number] if number < len(figures) else None


def runs_of(spec: StudySpec) -> Iterator[StudyRun]:
    """Yield all combinations; the input rgb has no encodings of depth, so it comes once."""
    for training, model, input_name, encoding in product(
        spec.training, spec.models, spec.inputs, spec.encodings
    ):
        if input_name == "rgb" and encoding is not spec.encodings[0]:
            continue
        for seed in model.seeds or spec.seeds:
            yield StudyRun(
                model=model, input=input_name, encoding=encoding, training=training, seed=seed
            )


def run_study(
    spec: StudySpec,
    out: Path,
    *,
    device: str = "auto",
    progress: ProgressMeter = UNWATCHED,
    on_done: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Train and score all runs, and reuse finished trainings and detections.

    Args:
        out: folder of the study, with a folder for each run in `out/runs`; it can be continued.
        progress: meter that counts runs, shows the current run, and counts as in `train`.
        on_done: receives each run's result.

    Raises:
        GraycastError: a dataset is missing or lacks data for the runs (checked before the first
            training), or a run cannot be trained.
    """
    worlds = {name: _world(spec, section) for name, section in spec.tests.items()}
    for datasets in spec.training.values():
        _check_training(spec, datasets)
    results = []
    runs = list(runs_of(spec))
    for run in runs:
        folder = out / "runs" / run.name
        folder.parent.mkdir(parents=True, exist_ok=True)
        detector = _trained(spec, run, folder, device, progress)
        figures: dict[tuple[str, str], tuple[BootstrapFigure, ...]] = {}
        for number, (name, world) in enumerate(worlds.items()):
            detections = [
                _detections(detector, dataset, spec.tests[name], folder / f"found_{name}_{i}")
                for i, dataset in enumerate(spec.tests[name].datasets)
            ]
            progress.stage(f"{run.name}: scored in {name}")
            for kind in world.kinds if detector.network.finds_masks else ("box",):
                scores = [
                    _score(spec, *pair, kind) for pair in zip(world.labels, detections, strict=True)
                ]
                figures[name, kind] = tuple(
                    bootstrap(each, FIGURE, seed=1000 * number + i) for i, each in enumerate(scores)
                )
        results.append(Result(run=run, figures=figures))
        on_done(results[-1])
        progress.count("runs", len(results), len(runs))
    return results


def _trained(
    spec: StudySpec, run: StudyRun, folder: Path, device: str, progress: ProgressMeter
) -> Detector:
    model = run.model
    training = TrainSpec(
        model=model.model,
        backbone=model.backbone,
        input=run.input,
        holes=run.encoding.holes,
        relief=run.encoding.relief,
        p_wrong=run.encoding.p_wrong,
        epochs=model.epochs or spec.epochs,
        learning_rate=model.learning_rate,
        batch=spec.batch,
        longest_px=spec.longest_px,
        seed=run.seed,
        one_class=spec.one_class,
        min_visibility=spec.min_visibility,
        split=spec.division,
        device=device,
    )
    progress.stage(f"{run.name}: training")
    return train(spec.training[run.training], folder, training, progress=progress)


def _detections(
    detector: Detector, dataset: Path, world: TestSection, folder: Path
) -> list[Detections]:
    """Return stored detections from a folder; detect again if the inputs have changed."""
    pictures = pictures_of(
        dataset, detector.about, split=world.split, scale_m=None, as_real=world.as_real
    )
    weights = sha256((folder.parent / WEIGHTS).read_bytes())
    pictures = replace(pictures, record={**pictures.record, "weights": weights})
    record = parse_json(json_bytes({"scene_ids": pictures.scene_ids, **pictures.record}))
    before = detection_record(folder)  # Empty if there is none.
    if any(key not in before or before[key] != value for key, value in record.items()):
        detect(detector, pictures, folder, drawings=4)
    return read_results(folder / RESULTS, pictures.scene_ids)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _World:
    """The labels of a world's datasets, and the kinds of shapes that have labels."""

    labels: tuple[tuple[Labels, ...], ...]
    kinds: tuple[Kind, ...]


def _world(spec: StudySpec, section: TestSection) -> _World:
    labels = []
    for dataset in section.datasets:
        sets, _ = sets_of(dataset, section.split, spec.division)
        of_dataset: list[Labels] = []
        for example in chain.from_iterable(sets):
            if not of_dataset:
                view = replace(example, depth_m=None) if section.as_real else example
                _check_inputs(spec, dataset, view)
            of_dataset.append(labels_of(example, min_visibility=spec.min_visibility))
        if not of_dataset:
            raise GraycastError(f"{dataset}: has no scene in the set {section.split}")
        labels.append(tuple(of_dataset))
    masks = all(one.mask is not None for of_set in labels for one in of_set)
    return _World(labels=tuple(labels), kinds=KINDS if masks else ("box",))


def _check_training(spec: StudySpec, datasets: Sequence[Path]) -> None:
    """Check that the training sets have the data for the study's inputs and models."""
    for dataset in datasets:
        sets, _ = sets_of(dataset, "train", spec.division)
        first = next(chain.from_iterable(sets), None)
        if first is None:
            raise GraycastError(f"{dataset}: has no scene in the set train")
        _check_inputs(spec, dataset, first)
        for model in spec.models:
            if first.mask is None and network_class(model.model).finds_masks:
                raise GraycastError(
                    f"{dataset}: scene {first.scene_id} has no masks, which {model.model} needs: "
                    "give masks, or choose a model that needs only boxes, such as yolov3"
                )


def _check_inputs(spec: StudySpec, dataset: Path, example: Example) -> None:
    for name in spec.inputs:
        try:
            Encoding(input=name, size_px=(32, 32), near_m=1.0, far_m=2.0).encode(example, seed=0)
        except GraycastError as error:
            raise GraycastError(f"{dataset}: {error}") from error


def _score(
    spec: StudySpec, labels: Sequence[Labels], detections: Sequence[Detections], kind: Kind
) -> Scores:
    if spec.one_class:
        labels = [as_one_class(one) for one in labels]
        detections = [as_one_class(one) for one in detections]
    return score(labels, detections, kind=kind)
