"""Images of a third-party dataset in any layout, and facts that its files do not state.

Frames: `T_cam_part` transforms the coordinates [m] of a model to OpenCV's camera frame (x right,
y down, z forward). Depth is z in this frame in metres.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...base.errors import DatasetError
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...dataset.files.json_text import json_bytes
from ...dataset.files.safe_reading import Unreadable
from ...dataset.files.scene_folder import SceneFolder
from ...dataset.files.seal import sha256
from ...dataset.read.rescanned import original_sums
from ...dataset.write.claim import described_values
from ...rig.optics import Optics
from ...world.parts import Material, Part


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SourceOptions:
    """Facts that the files of a dataset do not state, and choices of what to read.

    Attributes:
        sensor: name of the camera to use if a dataset has several.
        models: folder of models, or mesh file of the only object; None uses the dataset's folder.
        materials: a YAML file with a material for each object and for the background; see
            `model_files.read_models` and `read_background`.
        depth_scale_mm: millimetres of one step of stored depth; it overrides the files' scale.
        intrinsics: a file or `fx,fy,cx,cy`, for a dataset with only depth.
        depth_only: whether to leave out objects; then models are not needed and poses not read.
        unit: unit of the models, a key of `UNITS_M`; None uses the unit of the layout, or the unit
            that agrees with a diameter in `models_info.json`.
        ray_length: whether depth is the distance along each pixel's ray, which is converted to z.
    """

    sensor: str = ""
    models: Path | None = None
    materials: Path | None = None
    depth_scale_mm: float | None = None
    intrinsics: str | None = None
    depth_only: bool = False
    unit: str | None = None
    ray_length: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.depth_scale_mm is not None and not 0 < self.depth_scale_mm < float("inf"):
            raise DatasetError(
                f"--depth-scale is {self.depth_scale_mm}: give the millimetres of one step of "
                "depth, greater than 0"
            )


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SourceImage:
    """One image: depth and colours, and the objects with their poses.

    `depth_m` is NaN where depth is unknown. `rgb` is None if there is no picture; a grey picture
    has three equal bands. Instance i is the object `obj_id[i]` at `T_cam_part[i]`. Depth is
    quantised in steps of `step_m`; a step of 0 means floating-point numbers.
    """

    camera: Optics
    depth_m: Float[np.ndarray, "h w"]
    rgb: UInt8[np.ndarray, "h w 3"] | None
    obj_id: Int[np.ndarray, " n"]
    T_cam_part: Float[np.ndarray, "n 4 4"]
    step_m: float = 0.0


@final
@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A third-party dataset, or one of its splits; images are read on demand.

    Attributes:
        folder: folder of the split in BOP's form, or of the whole dataset in another layout.
        split: name of the split in the result, such as `train_pbr`.
        images: scene and image numbers, in order.
        parts: the objects by id, in metres and with materials; empty without models.
        plain: the ids of parts without a known colour; they are grey.
        image_of: function that reads an image of a scene; it can be pickled for worker processes.
        sensor: name of the camera, which is the suffix of its files; "" without a suffix.
        scenes: folders of the scenes in BOP's form by number, to whose files the result may link;
            empty for other layouts.
        background: material of everything except objects; None takes colours from the pictures.
        notes: messages for the user about conversions and probable mistakes.
        options: the options used to open the dataset.
    """

    folder: Path
    split: str
    images: tuple[tuple[int, int], ...]
    parts: Mapping[int, Part]
    plain: frozenset[int]
    image_of: Callable[[int, int], SourceImage]
    sensor: str = ""
    scenes: Mapping[int, Path] = field(default_factory=dict)
    background: Material | None = None
    notes: tuple[str, ...] = ()
    options: SourceOptions = SourceOptions()

    def read(self, scene_id: int, image_id: int) -> SourceImage:
        """Read one image.

        Raises:
            DatasetError: a file is missing, damaged or contradicts another; the text names it.
        """
        if (scene_id, image_id) not in self.images:
            raise DatasetError(f"{self.folder}: has no image {image_id} of scene {scene_id}")
        return self.image_of(scene_id, image_id)

    def sums(self, scene_id: int, image_ids: Iterable[int]) -> dict[int, dict[str, str]]:
        """Return, for each image, the SHA-256 of all data on which its scan depends, by name.

        Raises:
            DatasetError: a file is missing or damaged; the text names it.
        """
        if not self.scenes:
            return {image_id: _sums_of(self.read(scene_id, image_id)) for image_id in image_ids}
        scene = SceneFolder(self.scenes[scene_id], self.sensor)
        try:
            return original_sums(scene, image_ids, poses=not self.options.depth_only)
        except Unreadable as error:
            raise DatasetError(f"{scene.path}/{error}: repair the file") from error


def _sums_of(image: SourceImage) -> dict[str, str]:
    """Return the SHA-256 of each field of an image, independent of the files."""
    content = {name: value for name, value in described_values(image).items() if value is not None}
    return {name: sha256(json_bytes({name: _state(value)})) for name, value in content.items()}


def _state(value: Any) -> Any:
    """Return a value for JSON; an array is replaced by its shape, type and SHA-256."""
    if not isinstance(value, np.ndarray):
        return value
    return [value.shape, str(value.dtype), sha256(np.ascontiguousarray(value).tobytes())]
