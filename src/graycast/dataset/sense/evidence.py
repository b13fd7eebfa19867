"""What the checks of sense look at: one scene's pictures and records, and what its dataset says."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from ...base.frames import inverse, rigid
from ...camera.decode import DecodeSpec
from ...camera.scanner import ExposureSpec
from ...camera.sensor import SensorSpec
from ...rig.optics import Optics, picture_rays
from ...rig.pair import Rig
from .. import records
from ..claim import read_scanning, rig_of
from ..safe_reading import Unreadable, record_as

_ENOUGH_PX = 200_000  # So many pixels are enough for what holds for the picture as a whole.


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """One image of a scene, every file of which has the form it must have.

    Attributes:
        claim: what `graycast.json` says.
        taker: the scanner's place in the claim.
        number: of the image among the scanner's own.
        manifest: what the scene's manifest says of this image.
        lens: the camera as the scene has it.
        instance: number of the visible instance, -1 for none.
        parts_mm: of each instance the vertices of its model, in the camera frame.
    """

    scene_id: int
    claim: records.Claim
    taker: int
    number: int
    manifest: Mapping[str, Any]
    lens: Optics
    view: records.View
    poses: list[records.Pose]
    scanner: records.ScannerRecord
    rgb: UInt8[np.ndarray, "h w 3"]
    gray: UInt8[np.ndarray, "h w"]
    depth: UInt16[np.ndarray, "h w"]
    depth_sl: UInt16[np.ndarray, "h w"]
    reason: UInt8[np.ndarray, "h w"]
    modulation_step: UInt16[np.ndarray, "h w"]
    instance: Int[np.ndarray, "h w"]
    parts_mm: tuple[Float[np.ndarray, "_ 3"], ...]

    @cached_property
    def manifest_record(self) -> records.SceneManifest:
        """The manifest's keys that have a fixed form.

        Raises:
            Unreadable: one is missing or of another form.
        """
        return record_as(self.manifest, records.SceneManifest, "manifest.json")

    @cached_property
    def scanning(self) -> tuple[SensorSpec, DecodeSpec, ExposureSpec] | None:
        """Sensor, decoder and exposure in force; None where the configuration does not tell.

        Raises:
            Unreadable: what it tells is none.
        """
        described = self.claim.takers[self.taker].scanner
        if "sensor" not in described:
            return None
        try:
            return read_scanning(described)
        except (KeyError, TypeError, ValueError) as error:
            raise Unreadable(f"graycast.json: config.scanner: {error}") from error

    @cached_property
    def rig(self) -> Rig:
        """The scanner's rig.

        Raises:
            Unreadable: the claim's is none.
        """
        try:
            return rig_of(self.claim.takers[self.taker].rig)
        except (KeyError, TypeError, ValueError) as error:
            raise Unreadable(f"graycast.json: rig is none: {error}") from error

    @cached_property
    def modulation(self) -> Float[np.ndarray, "h w"]:
        return self.modulation_step * self.scanner.modulation_scale

    @cached_property
    def ray(self) -> Float[np.ndarray, "h w 3"]:
        return picture_rays(self.lens)

    @cached_property
    def T_world_cam(self) -> Float[np.ndarray, "4 4"]:
        """In millimetres."""
        R = np.array(self.view.cam_R_w2c, dtype=float).reshape(3, 3)
        return inverse(rigid(R, np.array(self.view.cam_t_w2c, dtype=float)))

    @cached_property
    def sampled(self) -> Bool[np.ndarray, "h w"]:
        """Every pixel of a small picture, of a large one some in each row and column taken."""
        stride = max(1, math.ceil(math.sqrt(self.depth.size / _ENOUGH_PX)))
        chosen = np.zeros(self.depth.shape, dtype=bool)
        chosen[::stride, ::stride] = True
        return chosen

    @cached_property
    def on_part(self) -> Bool[np.ndarray, "h w"]:
        return self.instance >= 0
