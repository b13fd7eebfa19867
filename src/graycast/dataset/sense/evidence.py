"""What the checks of sense look at: one image of a scene, and what its dataset says."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ...camera.decode import DecodeSpec
from ...camera.scanner import ExposureSpec
from ...camera.sensor import SensorSpec
from ...rig.optics import picture_rays
from ...rig.pair import Rig
from .. import records
from ..claim import read_scanning, rig_of
from ..plain_scene import Plain
from ..safe_reading import Unreadable, record_as

_ENOUGH_PX = 200_000  # So many pixels are enough for what holds for the picture as a whole.


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """One image of a scene, every file of which has the form it must have.

    Attributes:
        claim: what `graycast.json` says.
        plain: the image's pictures and records; its manifest is that of this image.
        instance: number of the visible instance, -1 for none.
        parts_mm: of each instance the vertices of its model, in the camera frame.
    """

    claim: records.Claim
    plain: Plain
    instance: Int[np.ndarray, "h w"]
    parts_mm: tuple[Float[np.ndarray, "_ 3"], ...]

    @property
    def image(self) -> Mapping[str, np.ndarray]:
        return self.plain.image

    @property
    def taker(self) -> int:
        """The scanner's place in the claim."""
        return [taker.name for taker in self.claim.takers].index(self.plain.files.sensor)

    @cached_property
    def manifest_record(self) -> records.SceneManifest:
        """The manifest's keys that have a fixed form.

        Raises:
            Unreadable: one is missing or of another form.
        """
        return record_as(self.plain.manifest, records.SceneManifest, "manifest.json")

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
        return self.image["modulation_sl"] * self.plain.scanner.modulation_scale

    @cached_property
    def ray(self) -> Float[np.ndarray, "h w 3"]:
        return picture_rays(self.plain.lens)

    @cached_property
    def sampled(self) -> Bool[np.ndarray, "h w"]:
        """Every pixel of a small picture, of a large one some in each row and column taken."""
        stride = max(1, math.ceil(math.sqrt(self.instance.size / _ENOUGH_PX)))
        sampled = np.zeros(self.instance.shape, dtype=bool)
        sampled[::stride, ::stride] = True
        return sampled

    @cached_property
    def on_part(self) -> Bool[np.ndarray, "h w"]:
        return self.instance >= 0
