"""Images of a dataset that others made, whatever its layout.

Frames: `T_cam_part` takes a model's coordinates [m] to OpenCV's camera frame (x right, y down, z
forward). Depth is z of that frame in metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...rig.optics import Optics
from ...world.parts import Material, Part


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceImage:
    """One image: what its camera saw, and which objects lie where.

    `depth_m` is NaN where it is not known, `rgb` None where there is no colour picture; a grey
    picture has three equal bands. Instance i is the object `obj_id[i]` at `T_cam_part[i]`. Depth
    is a multiple of `step_m`; 0 is for depth in floating-point numbers.
    """

    camera: Optics
    depth_m: Float[np.ndarray, "h w"]
    rgb: UInt8[np.ndarray, "h w 3"] | None
    obj_id: Int[np.ndarray, " n"]
    T_cam_part: Float[np.ndarray, "n 4 4"]
    step_m: float = 0.0


@runtime_checkable
class Source(Protocol):
    """A dataset of others, or one of its splits; images are read when they are asked for.

    Attributes:
        folder: of the split in BOP's form, or of the whole dataset in another layout.
        split: its name in the result, such as `train_pbr`.
        sensor: the camera that is read, "" where the dataset has only one; its files end in
            `_sensor`.
        scenes: the folders of scenes in BOP's form, by their numbers, to whose files the result may
            link; empty in another layout.
        images: scene and image numbers, in order.
        parts: the objects by their ids, in metres and with their look; empty without models.
        plain: the ids of parts whose look nothing states: they are grey.
        background: the material of what is no object; with None, it looks as the pictures do.
    """

    @property
    def folder(self) -> Path: ...
    @property
    def split(self) -> str: ...
    @property
    def sensor(self) -> str: ...
    @property
    def scenes(self) -> Mapping[int, Path]: ...
    @property
    def images(self) -> tuple[tuple[int, int], ...]: ...
    @property
    def parts(self) -> Mapping[int, Part]: ...
    @property
    def plain(self) -> frozenset[int]: ...
    @property
    def background(self) -> Material | None: ...

    def read(self, scene_id: int, image_id: int) -> SourceImage:
        """One image.

        Raises:
            DatasetError: a file is missing, damaged or contradicts another; the text names it.
        """
        ...
