"""One image of a scene folder and its records as they are, for those that check it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..base.frames import inverse, rigid
from ..rig.optics import Optics, optics_of
from . import records
from .scene_folder import SceneFolder, of_sensor, picture_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """What `models/` says of one object [mm]."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    info: records.ModelInfo


@dataclass(frozen=True, slots=True, kw_only=True)
class Plain:
    """The pictures and records of one image; `info` and `coco` by camera type.

    `coco` has the annotations of this image alone, `first_annotation` is the id of the first one by
    camera type. `files` and `number` say where all of it lies, `numbers` are those of all images
    of the scanner.
    """

    files: SceneFolder
    number: int
    numbers: range
    first_annotation: Mapping[str, int]
    image: Mapping[str, np.ndarray]
    view: records.View
    poses: list[records.Pose]
    info: Mapping[str, list[records.Info]]
    coco: Mapping[str, records.SceneCoco]
    box3d: list[records.Box3d]
    scanner: records.ScannerRecord

    def name(self, kind: str) -> str:
        """What a picture of this image is called."""
        return picture_name(kind, self.number, self.files.sensor)

    def json_name(self, name: str) -> str:
        """What a JSON file that tells of this image is called."""
        return f"{of_sensor(name, self.files.sensor)}.json"

    @property
    def T_world_cam(self) -> Float[np.ndarray, "4 4"]:
        """In millimetres."""
        return inverse(transform_of(self.view.cam_R_w2c, self.view.cam_t_w2c))

    @property
    def lens(self) -> Optics:
        """The scene's own K: poses, masks and depth must agree through it."""
        return optics_of(self.view.cam_K, self.image["depth"].shape[:2], self.view.distortion)


def transform_of(rotation: list[float], translation: list[float]) -> Float[np.ndarray, "4 4"]:
    return rigid(np.array(rotation, dtype=float).reshape(3, 3), np.array(translation, dtype=float))
