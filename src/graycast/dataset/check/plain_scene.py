"""Read one image of a scene folder and its stored records, for the checks."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.frames import inverse, rigid
from ...camera.decode import Reason
from ...rig.optics import Optics, optics_of
from ..files import records
from ..files.scene_folder import OWN_OPTIONS, SceneFolder, of_sensor, picture_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Plain:
    """The pictures and records of one image; `info` and `coco` have an entry for each camera type.

    `coco` holds the annotations of this image only, and `first_annotation` the id of the first one.
    `image` lacks pictures of the right form whose pixels no check reads.
    `files` and `number` say where the image is stored; `numbers` are the scanner's image numbers.
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
        """Return the file name of a picture of this image."""
        return picture_name(kind, self.number, self.files.sensor)

    def json_name(self, name: str) -> str:
        """Return the name of a JSON file that describes this image."""
        return f"{of_sensor(name, self.files.sensor)}.json"

    @property
    def T_world_cam(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the camera in the world [mm]."""
        return inverse(transform_of(self.view.cam_R_w2c, self.view.cam_t_w2c))

    @property
    def lens(self) -> Optics:
        """Lens of this image, from the intrinsics of the image itself."""
        return optics_of(self.view.cam_K, self.image["depth"].shape[:2], self.view.distortion)


def transform_of(rotation: list[float], translation: list[float]) -> Float[np.ndarray, "4 4"]:
    return rigid(np.array(rotation, dtype=float).reshape(3, 3), np.array(translation, dtype=float))


def holes_disagree(image: Mapping[str, np.ndarray]) -> Iterator[str]:
    """Yield a message for each picture of a scanner whose holes are not those of `depth_sl`."""
    known = {"reason_sl": image["reason_sl"] == Reason.DECODED}
    known |= {name: image[name] > 0 for name in OWN_OPTIONS if name in image}
    for name, there in known.items():
        if wrong := int(((image["depth_sl"] > 0) != there).sum()):
            yield f"depth_sl and {name} disagree in {wrong} pixels on whether there is a depth"
