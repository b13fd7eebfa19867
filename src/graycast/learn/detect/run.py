"""The folder of a training: its settings, progress and history."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, final

import torch

from ...base.errors import GraycastError
from ...base.file_limits import parse_json
from ...base.folder import ASIDE, fill_whole, remove_left, take_lock, write_whole
from ...base.plotting import (
    ACCENT,
    INK,
    SECOND,
    SOFT,
    caption,
    legend_below,
    plain_figure,
    save_png,
)
from ...base.tables import records_csv
from ...dataset.files.json_text import json_bytes
from ...dataset.write.claim import difference

RUN = "run.json"
CHECKPOINT = "checkpoint.pt"
CACHE = "cache"
_LOCK = ".lock"
_HISTORY, _CURVES = "history.csv", "curves.png"

Row = dict[str, float | int]

# These are the labels of the curves; the names of all other terms are plain words already.
_TERMS = {
    "loss": "sum",
    "loss_classifier": "class",
    "loss_box_reg": "box",
    "loss_rpn_box_reg": "box of a proposal",
    "loss_objectness": "part or background",
}
_PRECISIONS = {
    "box_ap": ("boxes, overlaps 0.50 to 0.95", ACCENT, "o-"),
    "box_ap50": ("boxes, overlap 0.50", ACCENT, "o:"),
    "mask_ap": ("masks, overlaps 0.50 to 0.95", SECOND, "o-"),
    "mask_ap50": ("masks, overlap 0.50", SECOND, "o:"),
}


@final
@dataclass(slots=True, kw_only=True)
class Progress:
    """The progress of a training, with all data to continue it.

    Attributes:
        step: number of finished steps of all epochs.
        sums: sums of the losses since the start of the epoch.
        rows: one row for each finished epoch.
        best: best validation score so far.
        since: number of validations since the best one.
    """

    step: int = 0
    sums: Row = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    best: float = -1.0
    since: int = 0


@final
@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of a training; every file in it is written completely or not at all."""

    path: Path

    @contextmanager
    def claimed(self, content: Mapping[str, Any]) -> Iterator[None]:
        """Make the folder, or open it for the same training; lock it against other trainings.

        A run without a checkpoint is replaced.

        Raises:
            GraycastError: the folder has another run or other files, or a training runs in it.
        """
        file = self.path / RUN
        with self._locked():
            remove_left(self.path)
            if file.is_file() and (self.path / CHECKPOINT).is_file():
                try:
                    settings = parse_json(file.read_bytes())
                except (OSError, ValueError) as error:
                    raise GraycastError(f"{file}: is damaged: choose another --out") from error
                self._compare(settings, parse_json(json_bytes(content)))
            else:
                write_whole(file, json_bytes(content))
            yield

    def _locked(self) -> IO[str]:
        """Return the lock of the folder, which becomes free if its process is killed."""
        if self.path.is_file():
            raise GraycastError(f"{self.path}: is a file: choose a folder")
        if not (self.path / RUN).is_file() and self.path.is_dir():
            names = (entry.name for entry in self.path.iterdir() if entry.name != _LOCK)
            if not all(name.startswith(ASIDE) for name in names):
                raise GraycastError(
                    f"{self.path}: is not empty and holds no run: choose another --out"
                )
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            lock = take_lock(self.path / _LOCK)
        except OSError as error:
            raise GraycastError(
                f"{self.path}: cannot be made or locked ({error.strerror}): choose a --out on a "
                "disk that can be written"
            ) from error
        if lock is None:
            raise GraycastError(
                f"{self.path}: another training runs in this folder: wait until it ends, or "
                "choose another --out"
            )
        return lock

    def _compare(self, settings: Mapping[str, Any], own: Mapping[str, Any]) -> None:
        if where := difference(settings, own, ""):
            raise GraycastError(
                f"{self.path}: is a run that differs in {where.removeprefix('.')}: repeat the "
                "command that started it, with the same data, or choose another --out"
            )

    @property
    def cache(self) -> Path:
        """The folder for temporary files, which can be made again."""
        folder = self.path / CACHE
        folder.mkdir(exist_ok=True)
        return folder

    def save(self, progress: Progress, network: torch.nn.Module, optimizer: Any) -> None:
        checkpoint = {
            "progress": json.dumps({name: getattr(progress, name) for name in Progress.__slots__}),
            "network": network.state_dict(),
            "optimizer": optimizer.state_dict(),
        }
        fill_whole(self.path / CHECKPOINT, lambda file: torch.save(checkpoint, file))

    def resume(self, network: torch.nn.Module, optimizer: Any) -> Progress:
        """Load the last checkpoint into network and optimizer, if any; return the progress.

        The history is written again, because a kill after the checkpoint may lose its last row.

        Raises:
            GraycastError: the checkpoint is damaged.
        """
        file = self.path / CHECKPOINT
        if not file.is_file():
            return Progress()
        try:
            checkpoint = torch.load(file, map_location="cpu", weights_only=True)
            network.load_state_dict(checkpoint["network"])
            optimizer.load_state_dict(checkpoint["optimizer"])
            progress = Progress(**parse_json(checkpoint["progress"]))
        except Exception as error:  # A damaged pickle can raise anything.
            raise GraycastError(
                f"{file}: is damaged: remove it, and the training starts again"
            ) from error
        if progress.rows:
            self.tell(progress.rows)
        return progress

    def tell(self, rows: Sequence[Row]) -> None:
        """Write the history of the rows as a CSV file and as a picture."""
        texts = [{name: f"{value:.6g}" for name, value in row.items()} for row in rows]
        write_whole(self.path / _HISTORY, records_csv(texts).encode())
        _draw(rows, self.path / _CURVES)


def _draw(rows: Sequence[Row], path: Path) -> None:
    figure, (left, right) = plain_figure(9.0, 3.8, (1, 1))
    epoch = [row["epoch"] for row in rows]
    losses = [name for name in rows[0] if name.startswith("loss")]
    for name, ink in zip(losses, (INK, ACCENT, SECOND, SOFT, "#7a5195", "#2f9e44"), strict=False):
        label = _TERMS.get(name, name.removeprefix("loss_").replace("_", " "))
        left.plot(epoch, [row[name] for row in rows], color=ink, lw=1.2, label=label)
    left.set_yscale("log")
    caption(left, "Loss on the training set", "epoch", "loss")
    legend_below(left, columns=3)
    for name, (label, ink, line) in _PRECISIONS.items():
        points = [(row["epoch"], row[name]) for row in rows if name in row]
        if points:
            right.plot(*zip(*points, strict=True), line, color=ink, lw=1.2, ms=3, label=label)
    right.set_ylim(0, 1.02)
    caption(right, "Average precision on the validation set", "epoch", "average precision (AP)")
    if right.get_lines():
        legend_below(right, columns=2)
    save_png(figure, path, dpi=110)
