"""Labelled pictures for training, which are encoded once and augmented in each epoch."""

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int
from pycocotools import mask as coco_mask
from torch import Tensor

from ...base.errors import GraycastError
from ...base.progress import UNWATCHED, ProgressMeter
from ...dataset.read.example import Example
from ...dataset.training import Examples
from .encoding import BLACK, Encoding
from .network import Target

Rle = Mapping[str, Any]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Augmentation:
    """The random augmentation of each picture in each epoch, without rotation and mosaic.

    Attributes:
        flip: whether half of the pictures are mirrored left to right, and half top to bottom. This
            also moves the scanner's shadows to the other side.
        zoom: largest factor by which pictures are enlarged or reduced about a random point; pixels
            outside the input are cropped.
        brightness: largest factor by which colours are multiplied or divided.
        depth_shift: largest shift of the depth, as a share of the working volume.
    """

    flip: bool = True
    zoom: float = 1.25
    brightness: float = 1.3
    depth_shift: float = 0.03

    def __post_init__(self) -> None:
        if min(self.zoom, self.brightness) < 1 or not 0 <= self.depth_shift < 1:
            raise GraycastError(
                f"zoom is {self.zoom}, brightness {self.brightness} (both at least 1) and "
                f"depth_shift {self.depth_shift} (a share): change what is out of range"
            )


NO_AUGMENTATION = Augmentation(flip=False, zoom=1.0, brightness=1.0, depth_shift=0.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Labelled:
    """Labels of one picture, in pixels of the input."""

    box: Float32[np.ndarray, "n 4"]
    label: Int[np.ndarray, " n"]
    ignored: Bool[np.ndarray, " n"]
    mask: tuple[Rle, ...] | None


@final
class TrainingPictures(torch.utils.data.Dataset):
    """Pictures and labels of one set as tensors, which depend on seed, epoch and index only.

    Pictures are encoded once into a file, from which each epoch reads them. Masks and boxes are in
    memory. Several processes of a loader may share the set.
    """

    def __init__(
        self,
        examples: Sequence[tuple[Examples, Mapping[int, int]]],
        encoding: Encoding,
        file: Path,
        *,
        masks: bool,
        min_visibility: float,
        augmentation: Augmentation,
        seed: int,
        progress: ProgressMeter = UNWATCHED,
    ) -> None:
        """Read and encode every picture.

        Args:
            examples: pairs of a set and the class of each of its object ids.
            file: the file of the encoded pictures, which is overwritten.
            masks: whether the targets need masks.
            min_visibility: smallest visible share of an instance that is not ignored.
            progress: meter that counts the pictures.

        Raises:
            GraycastError: a picture lacks data for the encoding or the labels, or the disk has no
                room for the file.
        """
        self.encoding, self.seed, self.augmentation = encoding, seed, augmentation
        self.file = file
        self.epoch = 0
        count = sum(len(each) for each, _ in examples)
        data = room_for(file, (count, encoding.channels, *encoding.size_px))
        labelled: list[_Labelled] = []
        for of_set, class_of in examples:
            for example in of_set:
                data[len(labelled)] = encoding.encode(example, seed=seed + len(labelled))
                labelled.append(
                    _labelled(example, encoding, class_of, min_visibility, masks, of_set.folder)
                )
                progress.count("pictures read", len(labelled), len(data))
        data.flush()
        self.labelled = tuple(labelled)

    def __len__(self) -> int:
        return len(self.labelled)

    def __getitem__(self, index: int) -> tuple[Tensor, Target]:
        image = np.load(self.file, mmap_mode="r")[index].astype(np.float32)
        labels = self.labelled[index]
        rng = np.random.default_rng([self.seed, self.epoch, index])
        image, labels = _augmented(image, labels, self.encoding, self.augmentation, rng)
        mask = None
        if labels.mask is not None:
            decoded = [coco_mask.decode(run) for run in labels.mask]
            mask = np.array(decoded, bool).reshape(-1, *self.encoding.size_px)
            mask = torch.from_numpy(mask)
        return torch.from_numpy(image), Target(
            box=torch.from_numpy(labels.box.copy()),
            label=torch.from_numpy(labels.label.copy()),
            ignored=torch.from_numpy(labels.ignored.copy()),
            mask=mask,
        )

    def at(self, epoch: int) -> "TrainingPictures":
        """Set the epoch, which changes the augmentation, and return the set itself."""
        self.epoch = epoch
        return self


def collate(items: Sequence[tuple[Tensor, Target]]) -> tuple[Tensor, list[Target]]:
    """Return a tensor of pictures and a list of targets, whose numbers of parts may differ."""
    return torch.stack([image for image, _ in items]), [target for _, target in items]


def room_for(file: Path, shape: Sequence[int]) -> np.memmap:
    """Create a file for encoded pictures and return it as a memory map.

    The space is allocated at once, because a full disk would later crash the process.

    Raises:
        GraycastError: the disk has no room for the file.
    """
    needed = 2 * int(np.prod(shape))
    free = shutil.disk_usage(file.parent).free
    if needed > free:
        raise GraycastError(
            f"{file.parent}: has {free / 1e9:.1f} GB free and the encoded pictures take "
            f"{needed / 1e9:.1f} GB: free disk space, choose another --out, or choose a smaller "
            "--longest-side"
        )
    try:
        data = np.lib.format.open_memmap(file, mode="w+", dtype=np.float16, shape=tuple(shape))
        with open(file, "rb+") as opened:
            os.posix_fallocate(opened.fileno(), 0, opened.seek(0, os.SEEK_END))
    except OSError as error:
        raise GraycastError(
            f"{file}: cannot be written ({error.strerror}): choose another --out with free space"
        ) from error
    return data


def _labelled(
    example: Example,
    encoding: Encoding,
    class_of: Mapping[int, int],
    min_visibility: float,
    masks: bool,
    folder: Path,
) -> _Labelled:
    if example.box_px is None or example.obj_id is None:
        raise GraycastError(
            f"{folder}: scene {example.scene_id} has no boxes for the training: give a dataset "
            "with labels"
        )
    if masks and example.mask is None:
        raise GraycastError(
            f"{folder}: scene {example.scene_id} has no masks, which this model needs: train "
            "--model yolov3, which needs only boxes, or give a dataset with masks"
        )
    picture_px = encoding.picture_px(example)
    scale = encoding.scale(picture_px)
    x, y, columns, rows = (example.box_px.astype(np.float32) * scale).T
    ignored = example.hidden(min_visibility)
    runs = None
    if masks and example.mask is not None:
        size = [max(1, round(side * scale)) for side in picture_px]
        runs = tuple(_fitted(mask, size, encoding.size_px) for mask in example.mask)
        ignored |= np.array([coco_mask.area(run) == 0 for run in runs], bool)
    return _Labelled(
        box=np.stack([x, y, x + columns, y + rows], axis=1).astype(np.float32).reshape(-1, 4),
        label=np.array([class_of[int(obj_id)] for obj_id in example.obj_id], np.int64),
        ignored=ignored,
        mask=runs,
    )


def _fitted(mask: Bool[np.ndarray, "h w"], size: Sequence[int], full: tuple[int, int]) -> Rle:
    small = cv2.resize(mask.astype(np.float32), (size[1], size[0]), interpolation=cv2.INTER_AREA)
    placed = np.zeros(full, np.uint8, order="F")
    placed[: size[0], : size[1]] = small > 0.5
    return coco_mask.encode(placed)


def _augmented(
    image: Float32[np.ndarray, "c h w"],
    labels: _Labelled,
    encoding: Encoding,
    how: Augmentation,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "c h w"], _Labelled]:
    """Return an augmented picture and its labels; random numbers do not depend on the picture."""
    flip_x, flip_y = rng.random(2) < 0.5
    zoom = how.zoom ** rng.uniform(-1, 1)
    at_x, at_y = rng.random(2)
    gain = how.brightness ** rng.uniform(-1, 1)
    shift = 2 * how.depth_shift * rng.uniform(-1, 1)  # Encoded depth spans -1 to 1.
    image = _toned(image, encoding, np.float32(gain), np.float32(shift))
    if how == NO_AUGMENTATION:
        return image, labels
    height_px, width_px = encoding.size_px
    move = _Move(
        scale=(
            -zoom if how.flip and flip_x else zoom,
            -zoom if how.flip and flip_y else zoom,
        ),
        offset_px=(
            at_x * (1 - zoom) * width_px + (zoom * width_px if how.flip and flip_x else 0),
            at_y * (1 - zoom) * height_px + (zoom * height_px if how.flip and flip_y else 0),
        ),
        size_px=encoding.size_px,
    )
    return move.image(image), move.labels(labels)


def _toned(
    image: Float32[np.ndarray, "c h w"], encoding: Encoding, gain: np.float32, shift: np.float32
) -> Float32[np.ndarray, "c h w"]:
    """Multiply colour by `gain` and add `shift` to depth; missing depth remains missing."""
    if encoding.coloured and gain != 1:
        black = BLACK[:, None, None]
        image[:3] = black + (image[:3] - black) * gain
    if encoding.deep and shift != 0:
        first = 3 * encoding.coloured
        share = image[first + 1] if encoding.holes == "channel" else np.float32(1)
        image[first] = image[first] + shift * share
    return image


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Move:
    """A motion in x and y: new = scale * old + offset for edges (pixel centres are at + 0.5)."""

    scale: tuple[float, float]
    offset_px: tuple[float, float]
    size_px: tuple[int, int]

    def _warped(self, layer: np.ndarray, way: int) -> np.ndarray:
        (sx, sy), (ox, oy) = self.scale, self.offset_px
        matrix = np.array(
            [[sx, 0.0, ox + 0.5 * sx - 0.5], [0.0, sy, oy + 0.5 * sy - 0.5]], np.float64
        )
        return cv2.warpAffine(
            np.ascontiguousarray(layer), matrix, (self.size_px[1], self.size_px[0]), flags=way
        )

    def image(self, image: Float32[np.ndarray, "c h w"]) -> Float32[np.ndarray, "c h w"]:
        return np.stack([self._warped(layer, cv2.INTER_LINEAR) for layer in image])

    def labels(self, labels: _Labelled) -> _Labelled:
        """Return the moved labels inside the input; instances cut to under a third are ignored."""
        (sx, sy), (ox, oy) = self.scale, self.offset_px
        x = np.sort(labels.box[:, 0::2] * sx + ox, axis=1)
        y = np.sort(labels.box[:, 1::2] * sy + oy, axis=1)
        whole = (x[:, 1] - x[:, 0]) * (y[:, 1] - y[:, 0])
        x, y = np.clip(x, 0, self.size_px[1]), np.clip(y, 0, self.size_px[0])
        inside = (x[:, 1] - x[:, 0]) * (y[:, 1] - y[:, 0])
        ignored = labels.ignored | (inside < whole / 3)
        keep = inside > 0
        mask = None
        if labels.mask is not None:
            runs = {int(i): self._mask(labels.mask[i]) for i in np.flatnonzero(keep)}
            runs = {i: run for i, run in runs.items() if coco_mask.area(run) > 0}
            keep[:] = False
            keep[list(runs)] = True
            mask = tuple(runs.values())
        box = np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1).astype(np.float32)
        return _Labelled(box=box[keep], label=labels.label[keep], ignored=ignored[keep], mask=mask)

    def _mask(self, run: Rle) -> Rle:
        return coco_mask.encode(
            np.asfortranarray(self._warped(coco_mask.decode(run), cv2.INTER_NEAREST))
        )
