"""Provide the examples as a map-style dataset of PyTorch; this module needs PyTorch."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import numpy as np

from ...base.errors import GraycastError
from ..export.split import Split
from ..read.example import Example
from .sources import open_examples

try:
    import torch
    from torch.utils.data import Dataset
except ImportError as error:
    raise GraycastError(
        "the torch dataset needs PyTorch, which is not installed: run pip install torch"
    ) from error


@final
class TorchExamples(Dataset):
    """Examples as dictionaries of tensors; a key is missing if the dataset lacks its content.

    `rgb` (3, h, w) and `gray` (1, h, w) are uint8. `depth` and `scanner_depth` (1, h, w) are
    float32 [m], NaN where depth is missing. `masks` (n, h, w) are bool, and `boxes` (n, 4) are
    float32: x0, y0, x1, y1. `labels` (n) are object ids (int64), `poses` (n, 4, 4) map part to
    camera (float32, [m]); further keys are `K` (3, 3) and `scene_id`.

    Images differ in their number of instances, so a loader needs a `collate_fn` that keeps a list.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        split: str = "train",
        division: Split | None = None,
        transform: Callable[[dict[str, Any]], Any] | None = None,
    ) -> None:
        self.examples = open_examples(Path(folder), split=split, division=division)
        self.transform = transform

    def __len__(self) -> int:
        return len(self.examples)

    def __getitem__(self, index: int) -> Any:
        item = {
            name: torch.from_numpy(np.array(value))  # This copy is writable, as tensors require.
            for name, value in arrays(self.examples[index]).items()
        }
        return item if self.transform is None else self.transform(item)


def arrays(example: Example) -> dict[str, np.ndarray]:
    """Return an example in the shapes and the box convention of torchvision's detectors."""
    box = example.box_px
    values = {
        "rgb": None if example.rgb is None else example.rgb.transpose(2, 0, 1),
        "gray": None if example.gray is None else example.gray[None],
        "depth": None if example.depth_m is None else example.depth_m[None],
        "scanner_depth": (
            None if example.scanner_depth_m is None else example.scanner_depth_m[None]
        ),
        "masks": example.mask,
        "boxes": None if box is None else np.hstack([box[:, :2], box[:, :2] + box[:, 2:]]),
        "labels": example.obj_id,
        "poses": None if example.T_cam_part is None else example.T_cam_part.astype(np.float32),
        "K": None if example.K is None else example.K.astype(np.float32),
        "scene_id": np.array(example.scene_id),
    }
    return {name: value for name, value in values.items() if value is not None}
