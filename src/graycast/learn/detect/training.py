"""Training of a detector: one loop for every network, which can be stopped and continued."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import torch

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...dataset.detections import WEIGHTS
from ...dataset.example import Example
from ...dataset.export.record import RECORD
from ...dataset.export.split import Split
from ...dataset.training import Examples, open_examples
from ...score.evaluate import Labels, labels_of, score
from ...score.evaluate.labels import MIN_VISIBILITY
from .detector import (
    ONE_CLASS,
    About,
    Detector,
    autocast,
    choose_device,
    load_detector,
    put_on,
    save_detector,
    without_denormals,
)
from .encoding import Encoding, fitting_size
from .network import Network, Recipe
from .run import Progress, Row, RunFolder
from .training_pictures import Augmentation, TrainingPictures, collate, room_for
from .weights import load_weights

SHARES = (0.8, 0.1, 0.1)
_SAVE_EVERY_S = 60.0
_WARM_UP_SHARE = 0.05
_MOST_NORM = 10.0
_RANGE_MARGIN = 0.05  # This share of the depth's span is added at both ends.


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TrainSpec:
    """How to train; what is None is the model's own choice.

    Attributes:
        model: one of `networks.MODELS`.
        input: what the network sees.
        backbone: of the model.
        longest_px: the longer side of the network's input.
        holes, relief, range_m: of the encoding; the range is measured where it is None.
        epochs: how often each picture is seen.
        batch, learning_rate: of a step.
        seed: of weights, order and augmentation.
        one_class: all parts are one class, `part`: where is something, not what is it.
        min_visibility: an instance of which a smaller share is visible is ignored.
        patience: validations without a better score after which training stops; those before the
            first score above 0 do not count.
        split: which scenes train, validate and test; exports have their own.
        augmentation: the random augmentation of every epoch.
        weights: a file of published weights to start from.
        device: `auto`, `cpu` or `cuda`.
        workers: processes that read; 0 reads in the training's own.
    """

    model: str = "mask-rcnn"
    input: str = "depth_sl"
    backbone: str | None = None
    longest_px: int = 384
    holes: str = "channel"
    relief: bool = True
    range_m: tuple[float, float] | None = None
    epochs: int = 40
    batch: int | None = None
    learning_rate: float | None = None
    seed: int = 0
    one_class: bool = False
    min_visibility: float = MIN_VISIBILITY
    patience: int = 10
    split: Split = field(default_factory=lambda: Split(shares=SHARES))
    augmentation: Augmentation = field(default_factory=Augmentation)
    weights: Path | None = None
    device: str = "auto"
    workers: int = 0

    def __post_init__(self) -> None:
        for name in ("epochs", "patience", "longest_px"):
            if getattr(self, name) < 1:
                raise GraycastError(
                    f"{name} is {getattr(self, name)}: give a whole number of at least 1"
                )
        if self.batch is not None and self.batch < 1:
            raise GraycastError(f"batch is {self.batch}: give a whole number of at least 1")
        if self.learning_rate is not None and not self.learning_rate > 0:
            raise GraycastError(
                f"learning_rate is {self.learning_rate}: give a number greater than 0"
            )

    def recipe(self, network: Network) -> Recipe:
        """The network's own, with what was said."""
        own, rate = network.recipe, self.learning_rate
        return replace(
            own,
            batch=own.batch if self.batch is None else self.batch,
            learning_rate=own.learning_rate if rate is None else rate,
        )


def train(
    datasets: Sequence[Path | str],
    out: Path | str,
    spec: TrainSpec,
    *,
    progress: ProgressMeter = UNWATCHED,
    on_row: Callable[[Row], None] = lambda row: None,
) -> Detector:
    """Train a detector on datasets, or continue a training that was stopped.

    Args:
        datasets: folders that `open_examples` reads; classes are their parts' names.
        out: the run's folder: new, empty, or one in which the same training was stopped.
        progress: counts the pictures that are read, the steps, and the pictures of a validation.
        on_row: takes the history of each epoch that has ended, a result.

    Returns:
        The detector of the best validation, which is also `out/detector.pt`.

    Raises:
        GraycastError: datasets, settings and folder do not fit together, the loss is no number,
            or the disk is full.
    """
    device = choose_device(spec.device)
    sets = [_Sets.of(Path(folder), spec.split) for folder in datasets]
    parts = dict.fromkeys(name for each in sets for name in each.train.categories.values())
    names = (ONE_CLASS,) if spec.one_class else tuple(parts)
    about = About(
        model=spec.model,
        backbone=spec.backbone,
        encoding=_encoding(sets[0].train, [each.train for each in sets], spec),
        names=names,
        trained={
            "datasets": [each.as_dict() for each in sets],
            "settings": _settings(spec),
        },
    )
    torch.manual_seed(spec.seed)
    network = about.open_network()
    if spec.weights is not None:
        load_weights(network, spec.weights)
    run = RunFolder(Path(out))
    with run.claimed(about.as_dict()):
        put_on(network, device)
        return _Training(
            spec=spec,
            about=about,
            run=run,
            network=network,
            device=device,
            sets=sets,
            meter=progress,
            on_row=on_row,
        ).go()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Sets:
    """One dataset's scenes: those to learn from, and those to choose the best weights by."""

    folder: Path
    train: Examples
    val: Examples

    @staticmethod
    def of(folder: Path, split: Split) -> "_Sets":
        division = None if (folder / RECORD).is_file() else split  # an export is divided
        train, val = (open_examples(folder, split=n, division=division) for n in ("train", "val"))
        return _Sets(folder=folder, train=train, val=val)

    def as_dict(self) -> dict[str, Any]:
        return {
            "folder": str(self.folder),
            "train": list(self.train.scene_ids),
            "val": list(self.val.scene_ids),
        }


def _settings(spec: TrainSpec) -> dict[str, Any]:
    """The settings that the weights depend on, without device and reading processes."""
    settings = asdict(spec)
    for name in ("device", "workers"):
        del settings[name]
    return settings | {"weights": None if spec.weights is None else spec.weights.name}


def _encoding(first: Examples, sets: Sequence[Examples], spec: TrainSpec) -> Encoding:
    example = first[0]
    probe = Encoding(input=spec.input, size_px=(32, 32), near_m=1.0, far_m=2.0)
    near_m, far_m = (None, None)
    if probe.deep:
        near_m, far_m = spec.range_m or _range_m(sets, probe)
    return Encoding(
        input=spec.input,
        size_px=fitting_size(probe.picture_px(example), spec.longest_px),
        near_m=near_m,
        far_m=far_m,
        holes=spec.holes,
        relief=spec.relief,
    )


def _range_m(sets: Sequence[Examples], probe: Encoding) -> tuple[float, float]:
    """The working volume: the span of depth in up to 20 scenes of each set, a little more, in cm.

    One pixel in a thousand may lie beyond either end: a scanner's spikes say nothing of a cell.
    """
    ends = []
    for examples in sets:
        for i in np.unique(np.linspace(0, len(examples) - 1, min(20, len(examples))).astype(int)):
            depth_m = probe.depth_m(examples[int(i)])
            known_m = depth_m[np.isfinite(depth_m)]
            if known_m.size:
                ends.append(np.quantile(known_m, [0.001, 0.999]))
    if not ends:
        raise GraycastError(f"{sets[0].folder}: has no depth at all: choose --input rgb")
    near_m, far_m = np.min(ends), np.max(ends)
    margin_m = _RANGE_MARGIN * (far_m - near_m)
    return (
        max(0.01, math.floor(100 * (near_m - margin_m)) / 100),
        math.ceil(100 * (far_m + margin_m)) / 100,
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Training:
    """The loop. Every random number follows from seed, epoch, picture and step, so a training
    that goes on draws what it would have drawn."""

    spec: TrainSpec
    about: About
    run: RunFolder
    network: Network
    device: torch.device
    sets: Sequence[_Sets]
    meter: ProgressMeter
    on_row: Callable[[Row], None]

    def go(self) -> Detector:
        recipe = self.spec.recipe(self.network)
        optimizer = _optimizer(self.network, recipe)
        progress = self.run.resume(self.network, optimizer)
        count = sum(len(each.train) for each in self.sets)
        batch = min(recipe.batch, count)
        steps = count // batch
        every = max(1, self.spec.epochs // 25)
        if self._ended(progress, steps):
            return self._best()
        pictures, judge = self._pictures(), _Judge.of(self)
        detector = Detector(about=self.about, network=self.network, device=self.device)
        while not self._ended(progress, steps):
            epoch = progress.step // steps
            self._epoch(pictures.at(epoch), epoch, steps, batch, recipe, optimizer, progress)
            row: Row = {"epoch": epoch + 1, "step": progress.step}
            row |= {name: total / steps for name, total in progress.sums.items()}
            if (epoch + 1) % every == 0 or epoch + 1 == self.spec.epochs:
                row |= self._validated(judge, detector, progress)
            progress.rows.append(row)
            progress.sums = {}
            self.run.save(progress, self.network, optimizer)
            self.run.tell(progress.rows)
            self.on_row(row)
        return self._best()

    def _ended(self, progress: Progress, steps: int) -> bool:
        return progress.step >= self.spec.epochs * steps or progress.since >= self.spec.patience

    def _epoch(
        self,
        pictures: TrainingPictures,
        epoch: int,
        steps: int,
        batch: int,
        recipe: Recipe,
        optimizer: torch.optim.Optimizer,
        progress: Progress,
    ) -> None:
        """Train for the remaining steps of an epoch."""
        self.network.train()
        saved = time.monotonic()
        total = self.spec.epochs * steps
        order = np.random.default_rng([self.spec.seed, epoch]).permutation(len(pictures))
        left = order[: steps * batch].reshape(steps, batch)[progress.step - epoch * steps :]
        for image, targets in self._loaded(pictures, left):
            torch.manual_seed((self.spec.seed << 32) + progress.step)
            rate = recipe.learning_rate * _shape(progress.step / total)
            for group in optimizer.param_groups:
                group["lr"] = rate
            with autocast(self.device), without_denormals():
                losses = self.network.losses(image, targets)
                loss = torch.stack(list(losses.values())).sum()
            if not torch.isfinite(loss):
                raise GraycastError(
                    f"the loss is not a number after {progress.step} steps: lower --learning-rate "
                    f"(it is {recipe.learning_rate})"
                )
            optimizer.zero_grad(set_to_none=True)
            with without_denormals():
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.network.parameters(), _MOST_NORM)
                optimizer.step()
            progress.step += 1
            for name, value in {"loss": loss, **_named(losses)}.items():
                progress.sums[name] = progress.sums.get(name, 0.0) + float(value.detach())
            self.meter.count("training steps", progress.step, total)
            if time.monotonic() - saved > _SAVE_EVERY_S:
                self.run.save(progress, self.network, optimizer)
                saved = time.monotonic()

    def _loaded(self, pictures: TrainingPictures, batches: np.ndarray) -> Iterator:
        loader = torch.utils.data.DataLoader(
            pictures,
            batch_sampler=batches.tolist(),
            collate_fn=collate,
            num_workers=self.spec.workers,
            pin_memory=self.device.type == "cuda",
        )
        for image, targets in loader:
            yield (
                image.to(self.device, non_blocking=True),
                [target.to(self.device) for target in targets],
            )

    def _pictures(self) -> TrainingPictures:
        return TrainingPictures(
            [(each.train, self.about.classes(each.train.categories)) for each in self.sets],
            self.about.encoding,
            self.run.cache / "train.npy",
            masks=self.network.finds_masks,
            min_visibility=self.spec.min_visibility,
            augmentation=self.spec.augmentation,
            seed=self.spec.seed,
            progress=self.meter,
        )

    def _validated(self, judge: "_Judge", detector: Detector, progress: Progress) -> Row:
        row = judge.figures_of(detector, self.meter)
        figure = np.mean([value for name, value in row.items() if name.endswith("_ap")])
        if figure > progress.best or progress.best <= 0:  # the latest, while none finds a thing
            progress.best, progress.since = max(float(np.nan_to_num(figure)), 0.0), 0
            save_detector(self.run.path / WEIGHTS, self.about, self.network.state_dict())
        else:
            progress.since += 1
        return row

    def _best(self) -> Detector:
        return load_detector(self.run.path, device=self.spec.device)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judge:
    """The validation set, encoded once; scenes and classes of all datasets in one numbering."""

    encoded: np.ndarray
    labels: tuple[Labels, ...]
    names: tuple[str, ...]
    masks: bool

    @staticmethod
    def of(training: _Training) -> "_Judge":
        about, encoding = training.about, training.about.encoding
        count = sum(len(each.val) for each in training.sets)
        shape = (count, encoding.channels, *encoding.size_px)
        file = training.run.cache / "val.npy"
        encoded = room_for(file, shape)
        labels: list[Labels] = []
        for each in training.sets:
            class_of = about.classes(each.val.categories)
            for example in each.val:
                encoded[len(labels)] = encoding.encode(example, seed=example.scene_id)
                labels.append(_renumbered(example, len(labels), class_of, training.spec))
                training.meter.count("pictures read", len(labels), count)
        return _Judge(
            encoded=encoded,
            labels=tuple(labels),
            names=about.names,
            masks=training.network.finds_masks,
        )

    def figures_of(self, detector: Detector, meter: ProgressMeter) -> Row:
        detector.network.eval()
        ids = {name: i for i, name in enumerate(self.names)}
        found = []
        for i, labels in enumerate(self.labels):
            if labels.size_px is None:
                raise ValueError(f"scene {i} of the validation has no picture")
            image = self.encoded[i].astype(np.float32)
            found.append(detector.look(image, i, labels.size_px, obj_ids=ids))
            meter.count("pictures validated", i + 1, len(self.labels))
        row: Row = {}
        for kind in ("box", "mask") if self.masks else ("box",):
            scores = score(self.labels, found, kind=kind)
            row |= {f"{kind}_ap": scores.ap, f"{kind}_ap50": scores.ap50}
        return row


def _renumbered(
    example: Example, number: int, class_of: Mapping[int, int], spec: TrainSpec
) -> Labels:
    labels = labels_of(example, min_visibility=spec.min_visibility)
    ids = np.array([class_of[int(obj_id)] for obj_id in labels.obj_id], np.int64)
    return replace(labels, scene_id=number, obj_id=ids)


def _optimizer(network: torch.nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Matrices and kernels decay, biases and norms do not."""
    weights = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in weights if p.ndim > 1], "weight_decay": recipe.weight_decay},
        {"params": [p for p in weights if p.ndim <= 1], "weight_decay": 0.0},
    ]
    match recipe.optimizer:
        case "adamw":
            return torch.optim.AdamW(groups, lr=recipe.learning_rate)
        case "sgd":
            return torch.optim.SGD(groups, lr=recipe.learning_rate, momentum=0.9)
    raise GraycastError(f"no optimizer {recipe.optimizer!r}: choose 'adamw' or 'sgd'")


def _shape(done: float) -> float:
    """The learning rate over its highest: a straight rise, then half a cosine down to 1 %."""
    if done < _WARM_UP_SHARE:
        return max(1e-3, done / _WARM_UP_SHARE)
    falling = (done - _WARM_UP_SHARE) / (1 - _WARM_UP_SHARE)
    return 0.01 + 0.99 * (1 + math.cos(math.pi * falling)) / 2


def _named(losses: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name if name.startswith("loss") else f"loss_{name}": v for name, v in losses.items()}
