"""Times of reading pictures, of a detector and of its network: docs/measurements/detection.md."""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np
import torch

from graycast.base.errors import GraycastError
from graycast.dataset.training import open_examples
from graycast.learn.detect import Augmentation, Detector, load_detector
from graycast.learn.detect.detector import autocast, without_denormals
from graycast.learn.detect.training_pictures import TrainingPictures, collate

from .figures import Figures, Show, in_turn

ROUNDS = 7  # Both kinds of steps are timed in turn, A B A B ...
BATCH = 4


def measure(*, runs: Sequence[Path], dataset: Path, show: Show) -> Figures:
    """Time each trained detector on the first pictures of a dataset; return a row for each.

    `read_over_held` is the ratio of the time of a training step whose pictures are read and
    augmented to the time of the same step with pictures in memory. `detect_ms` is the time from
    arrays to detections in pixels of the picture, and `bare_ms` the time of the network alone.

    Raises:
        GraycastError: a folder has no trained detector, or the dataset has too few pictures.
    """
    with without_denormals():
        return _measured(runs, dataset, show)


def _measured(runs: Sequence[Path], dataset: Path, show: Show) -> Figures:
    rows = []
    for run in runs:
        show(run.name)
        detector = load_detector(run)
        about = detector.about
        row: Figures = {
            "model": about.model,
            "backbone": about.backbone or "default",
            "input": about.encoding.input,
            "size_px": f"{about.encoding.size_px[1]}x{about.encoding.size_px[0]}",
        }
        rows.append(row | _detection(detector, dataset) | _step(detector, dataset))
    return {"device": str(detector.device), "threads": torch.get_num_threads(), "detectors": rows}


def _detection(detector: Detector, dataset: Path) -> Figures:
    examples = open_examples(dataset)[:5]
    encoding = detector.about.encoding
    encoded = [torch.from_numpy(encoding.encode(each, seed=0))[None] for each in examples]
    ids = {name: i for i, name in enumerate(detector.about.names)}

    def whole() -> None:
        for each in examples:
            detector.detect(each, obj_ids=ids)

    def bare() -> None:
        for image in encoded:
            detector.answer(image.to(detector.device), most=300, least_score=0.05)

    whole_s, bare_s, _ = in_turn(whole, bare)
    count = len(examples)
    return {"detect_ms": 1e3 * whole_s / count, "bare_ms": 1e3 * bare_s / count}


def _step(detector: Detector, dataset: Path) -> Figures:
    examples = open_examples(dataset)
    if len(examples) < BATCH * ROUNDS:
        raise GraycastError(
            f"{dataset}: has {len(examples)} scenes, and {BATCH * ROUNDS} are needed: give a "
            "larger dataset"
        )
    with tempfile.TemporaryDirectory() as folder:
        pictures = TrainingPictures(
            [(examples, detector.about.classes(examples.categories))],
            detector.about.encoding,
            Path(folder) / "pictures.npy",
            masks=detector.network.finds_masks,
            min_visibility=0.1,
            augmentation=Augmentation(),
            seed=0,
        )
        network = detector.network.train()
        optimizer = torch.optim.SGD(network.parameters(), lr=0.0)
        batches = np.arange(BATCH * ROUNDS).reshape(ROUNDS, BATCH)
        collated = [collate([pictures[int(i)] for i in batch]) for batch in batches]
        times: dict[str, list[float]] = {"read": [], "held": []}
        for number in range(ROUNDS):
            for name in times:
                torch.manual_seed(number)
                start = time.perf_counter()
                batch = (
                    collated[number]
                    if name == "held"
                    else collate([pictures[int(i)] for i in batches[number]])
                )
                image, targets = batch
                targets = [target.to(detector.device) for target in targets]
                with autocast(detector.device):
                    losses = network.losses(image.to(detector.device), targets)
                    loss = torch.stack(list(losses.values())).sum()
                loss.backward()
                optimizer.step()
                optimizer.zero_grad()
                times[name].append(time.perf_counter() - start)
        network.eval()
    read_s, collated_s = median(times["read"][1:]), median(times["held"][1:])
    ratio = median(a / b for a, b in zip(times["read"][1:], times["held"][1:], strict=True))
    return {"step_s": read_s, "step_held_s": collated_s, "read_over_held": ratio}
