"""Training of a detector: one loop for all networks, which can be stopped and continued."""

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import torch

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...dataset.export.split import Split
from ...dataset.read.detections import WEIGHTS
from ...dataset.training import Examples
from ...dataset.write.claim import claimed_options
from ...score.evaluate import Labels, labels_of, score
from ...score.evaluate.labels import MIN_VISIBILITY
from .backbones import load_weights
from .detecting import sets_of
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
from .network import Network
from .run import Row, RunFolder
from .training_pictures import Augmentation, TrainingPictures, collate, room_for

SHARES = (0.8, 0.1, 0.1)
_SAVE_EVERY_S = 60.0
_WARM_UP_SHARE = 0.05
_MOST_NORM = 10.0
_RANGE_MARGIN = 0.05  # This share of the depth's span is added at both ends.


@final
@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class TrainSpec:
    """Options of a training; None selects the model's default.

    Attributes:
        model, backbone: name of the network, one of `networks.MODELS`, and of its backbone.
        input, longest_px: kind of the network's input, and its longer side.
        holes, relief, p_wrong, range_m: fields of the encoding; a range of None is measured.
        epochs: number of passes over all pictures.
        batch, learning_rate: number of pictures in a step, and highest learning rate.
        seed: seed for the initial weights, the order of pictures, and the augmentation.
        one_class: whether all parts are one class, `part`, so that their kind is ignored.
        min_visibility: smallest visible share of an instance that is not ignored.
        patience: number of consecutive validations without a better score that end the training.
        split: division of scenes into train, val and test; exports have their own division.
        augmentation: random augmentation of the pictures in every epoch.
        weights: file of weights with which the training starts.
        device: `auto`, `cpu` or `cuda`.
        workers: number of processes that read pictures; with 0, the training reads them itself.
    """

    model: str = "mask-rcnn"
    input: str = "depth_sl"
    backbone: str | None = None
    longest_px: int = 384
    holes: str = "channel"
    relief: bool = True
    p_wrong: bool = False
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
        check_fields(self)
        for name in ("epochs", "patience", "longest_px", "batch"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise GraycastError(f"{name} is {value}: give a whole number of at least 1")
        if self.learning_rate is not None and not self.learning_rate > 0:
            raise GraycastError(
                f"learning_rate is {self.learning_rate}: give a number greater than 0"
            )


def train(
    datasets: Sequence[Path | str],
    out: Path | str,
    spec: TrainSpec,
    *,
    network: type[Network] | None = None,
    progress: ProgressMeter = UNWATCHED,
    on_row: Callable[[Row], None] = lambda row: None,
) -> Detector:
    """Train a detector on datasets, or continue a training that was stopped.

    Args:
        datasets: folders that `open_examples` reads; the classes are the names of their parts.
        out: folder of the training: new, empty, or with the same training, which was stopped.
        network: class of the user's own network, instead of `spec.model`.
        progress: meter that counts read pictures, steps, and validated pictures.
        on_row: receives the row of the history after each epoch.

    Returns:
        The detector with the best validation score, which is also `out/detector.pt`.

    Raises:
        GraycastError: datasets, settings and folder do not fit together, the loss is not a number,
            or the disk is full.
    """
    device = choose_device(spec.device)
    spec = spec if network is None else replace(spec, model=network.__name__)
    train_sets, val_sets = (  # Exports are already split into sets.
        [sets_of(Path(folder), split, spec.split)[0][0] for folder in datasets]
        for split in ("train", "val")
    )
    parts = dict.fromkeys(name for each in train_sets for name in each.categories.values())
    about = About(
        model=spec.model,
        backbone=spec.backbone,
        encoding=_encoding(train_sets, spec),
        names=(ONE_CLASS,) if spec.one_class else tuple(parts),
        trained={
            "datasets": [
                {
                    "folder": str(training.folder),
                    "train": list(training.scene_ids),
                    "val": list(validation.scene_ids),
                    "content": [training.content_sum(), validation.content_sum()],
                }
                for training, validation in zip(train_sets, val_sets, strict=True)
            ],
            "settings": _settings(spec),
        },
    )
    torch.manual_seed(spec.seed)
    opened = about.open_network(network)
    if spec.weights is not None:
        load_weights(opened, spec.weights)
    run = RunFolder(Path(out))
    with run.claimed(about.as_dict()):
        detector = Detector(about=about, network=put_on(opened, device), device=device)
        training = _Training(spec, detector, run, train_sets, progress)
        if not training.ended:
            training.go(val_sets, on_row)
        return load_detector(run.path, device=spec.device, network=network)


def _settings(spec: TrainSpec) -> dict[str, Any]:
    """Return the settings that affect the weights, without the device and reading processes."""
    settings = claimed_options(spec, without=("device", "workers", "weights"))
    if spec.weights is None:
        return settings | {"weights": None}
    return settings | {"weights": spec.weights.name, "weights_sha256": _file_sum(spec.weights)}


def _file_sum(path: Path) -> str:
    """Return the SHA-256 of a file of weights, which may be larger than the memory."""
    if not path.is_file():
        raise GraycastError(f"{path}: does not exist: give a file of weights")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _encoding(sets: Sequence[Examples], spec: TrainSpec) -> Encoding:
    probe = Encoding(input=spec.input, size_px=(32, 32), near_m=1.0, far_m=2.0)
    near_m, far_m = (None, None)
    if probe.deep:
        near_m, far_m = spec.range_m or _range_m(sets, probe)
    size_px = fitting_size(probe.picture_px(sets[0][0]), spec.longest_px)
    full = replace(probe, holes=spec.holes, relief=spec.relief, p_wrong=spec.p_wrong)
    return replace(full, size_px=size_px, near_m=near_m, far_m=far_m)


def _range_m(sets: Sequence[Examples], probe: Encoding) -> tuple[float, float]:
    """Return the range of depth in up to 20 scenes of each set, with a margin, in whole cm.

    One pixel in a thousand at each end is ignored, because it may be a spike.
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
class _Training:
    """The training loop. A resumed training has the same random numbers as one without a stop."""

    def __init__(
        self,
        spec: TrainSpec,
        detector: Detector,
        run: RunFolder,
        sets: Sequence[Examples],
        meter: ProgressMeter,
    ) -> None:
        """Start a training, or resume the training in the folder."""
        self.spec, self.detector, self.run, self.sets, self.meter = spec, detector, run, sets, meter
        self.network = detector.network
        recipe, count = self.network.recipe, sum(map(len, sets))
        self.batch = min(spec.batch or recipe.batch, count)
        self.steps = count // self.batch  # steps per epoch
        self.rate = spec.learning_rate or recipe.learning_rate
        self.optimizer = _optimizer(self.network, self.rate, recipe.weight_decay)
        self.progress = run.resume(self.network, self.optimizer)

    @property
    def ended(self) -> bool:
        done, since = self.progress.step, self.progress.since
        return done >= self.spec.epochs * self.steps or since >= self.spec.patience

    def go(self, val_sets: Sequence[Examples], on_row: Callable[[Row], None]) -> None:
        """Train until the last epoch, or until validations no longer improve."""
        progress, epochs = self.progress, self.spec.epochs
        pictures, validation = self._pictures(), _Validation.of(val_sets, self)
        every = max(1, epochs // 25)
        while not self.ended:
            epoch = progress.step // self.steps
            self._epoch(pictures.at(epoch), epoch)
            row: Row = {"epoch": epoch + 1, "step": progress.step}
            row |= {name: total / self.steps for name, total in progress.sums.items()}
            if (epoch + 1) % every == 0 or epoch + 1 == epochs:
                figures = validation.figures(self.detector, self.meter)
                self._compare(figures)
                row |= figures
            progress.rows.append(row)
            progress.sums = {}
            self._save()
            self.run.tell(progress.rows)
            on_row(row)

    def _epoch(self, pictures: TrainingPictures, epoch: int) -> None:
        """Train for the remaining steps of an epoch."""
        self.network.train()
        progress, saved = self.progress, time.monotonic()
        total = self.spec.epochs * self.steps
        order = np.random.default_rng([self.spec.seed, epoch]).permutation(len(pictures))
        batches = order[: self.steps * self.batch].reshape(self.steps, self.batch)
        for image, targets in self._loaded(pictures, batches[progress.step - epoch * self.steps :]):
            torch.manual_seed((self.spec.seed << 32) + progress.step)
            for group in self.optimizer.param_groups:
                group["lr"] = self.rate * _shape(progress.step / total)
            with autocast(self.detector.device), without_denormals():
                losses = self.network.losses(image, targets)
                loss = torch.stack(list(losses.values())).sum()
            if not torch.isfinite(loss):
                raise GraycastError(
                    f"the loss is not a number after {progress.step} steps: lower --learning-rate "
                    f"(it is {self.rate})"
                )
            self.optimizer.zero_grad(set_to_none=True)
            with without_denormals():
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.network.parameters(), _MOST_NORM)
                self.optimizer.step()
            progress.step += 1
            terms = {f"loss_{name.removeprefix('loss_')}": value for name, value in losses.items()}
            for name, value in {"loss": loss, **terms}.items():
                progress.sums[name] = progress.sums.get(name, 0.0) + float(value.detach())
            self.meter.count("training steps", progress.step, total)
            if time.monotonic() - saved > _SAVE_EVERY_S:
                self._save()
                saved = time.monotonic()

    def _loaded(self, pictures: TrainingPictures, batches: np.ndarray) -> Iterator:
        device = self.detector.device
        loader = torch.utils.data.DataLoader(
            pictures,
            batch_sampler=batches.tolist(),
            collate_fn=collate,
            num_workers=self.spec.workers,
            pin_memory=device.type == "cuda",
        )
        for image, targets in loader:
            yield image.to(device, non_blocking=True), [target.to(device) for target in targets]

    def _pictures(self) -> TrainingPictures:
        about = self.detector.about
        return TrainingPictures(
            [(each, about.classes(each.categories)) for each in self.sets],
            about.encoding,
            self.run.cache / "train.npy",
            masks=self.network.finds_masks,
            min_visibility=self.spec.min_visibility,
            augmentation=self.spec.augmentation,
            seed=self.spec.seed,
            progress=self.meter,
        )

    def _compare(self, figures: Row) -> None:
        """Save the weights if their validation score is the best so far."""
        progress = self.progress
        figure = np.mean([value for name, value in figures.items() if name.endswith("_ap")])
        if figure > progress.best or progress.best <= 0:  # Before any detection, keep the latest.
            progress.best, progress.since = max(float(np.nan_to_num(figure)), 0.0), 0
            weights = self.network.state_dict()
            save_detector(self.run.path / WEIGHTS, self.detector.about, weights)
        else:
            progress.since += 1

    def _save(self) -> None:
        self.run.save(self.progress, self.network, self.optimizer)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Validation:
    """The encoded validation set, with scenes and classes of all datasets numbered together."""

    encoded: np.ndarray
    labels: tuple[Labels, ...]

    @staticmethod
    def of(sets: Sequence[Examples], training: _Training) -> "_Validation":
        about, encoding = training.detector.about, training.detector.about.encoding
        count = sum(map(len, sets))
        shape = (count, encoding.channels, *encoding.size_px)
        encoded = room_for(training.run.cache / "val.npy", shape)
        labels: list[Labels] = []
        for each in sets:
            class_of = about.classes(each.categories)
            for example in each:
                encoded[len(labels)] = encoding.encode(example, seed=example.scene_id)
                own = labels_of(example, min_visibility=training.spec.min_visibility)
                ids = np.array([class_of[int(obj_id)] for obj_id in own.obj_id], np.int64)
                labels.append(replace(own, scene_id=len(labels), obj_id=ids))
                training.meter.count("pictures read", len(labels), count)
        return _Validation(encoded=encoded, labels=tuple(labels))

    def figures(self, detector: Detector, meter: ProgressMeter) -> Row:
        """Return the average precision of boxes, and of masks if the network has them."""
        detector.network.eval()
        ids = {name: i for i, name in enumerate(detector.about.names)}
        detections = []
        for i, labels in enumerate(self.labels):
            if labels.size_px is None:
                raise ValueError(f"scene {i} of the validation has no picture")
            image = self.encoded[i].astype(np.float32)
            detections.append(detector.look(image, i, labels.size_px, obj_ids=ids))
            meter.count("pictures validated", i + 1, len(self.labels))
        row: Row = {}
        for kind in ("box", "mask") if detector.network.finds_masks else ("box",):
            scores = score(self.labels, detections, kind=kind)
            row |= {f"{kind}_ap": scores.ap, f"{kind}_ap50": scores.ap50}
        return row


def _optimizer(
    network: torch.nn.Module, learning_rate: float, weight_decay: float
) -> torch.optim.Optimizer:
    """Return AdamW with weight decay for matrices and kernels, but not for biases and norms."""
    weights = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in weights if p.ndim > 1], "weight_decay": weight_decay},
        {"params": [p for p in weights if p.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=learning_rate)


def _shape(done: float) -> float:
    """Return the share of the highest learning rate: linear warm-up, then half a cosine to 1 %."""
    if done < _WARM_UP_SHARE:
        return max(1e-3, done / _WARM_UP_SHARE)
    falling = (done - _WARM_UP_SHARE) / (1 - _WARM_UP_SHARE)
    return 0.01 + 0.99 * (1 + math.cos(math.pi * falling)) / 2
