"""One scene folder's images and records as they are, for those that check it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..frames import rigid
from ..optics import Optics, optics_of
from . import records


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """What `models/` says of one object [mm]."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    info: records.ModelInfo


@dataclass(frozen=True, slots=True, kw_only=True)
class Plain:
    """The images and records of one scene; `info` and `coco` by camera type."""

    image: Mapping[str, np.ndarray]
    view: records.View
    poses: list[records.Pose]
    info: Mapping[str, list[records.Info]]
    coco: Mapping[str, records.SceneCoco]
    box3d: list[records.Box3d]
    scanner: records.ScannerRecord
    manifest: Mapping[str, Any]

    @property
    def lens(self) -> Optics:
        """The scene's own K: poses, masks and depth must agree through it."""
        return optics_of(self.view.cam_K, self.image["depth"].shape[:2], self.view.distortion)


def transform_of(rotation: list[float], translation: list[float]) -> Float[np.ndarray, "4 4"]:
    return rigid(np.array(rotation, dtype=float).reshape(3, 3), np.array(translation, dtype=float))
