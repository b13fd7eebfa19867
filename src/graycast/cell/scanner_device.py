"""The questions that a scanner answers as a device, simulated or from a bag, and its frames."""

from dataclasses import dataclass
from typing import Any, Protocol

from ..base import array_types as arrays
from ..base.public_value import public_value
from ..rig.optics import Optics, points


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerFrame:
    """The result of one trigger; maps are NaN where the scanner has no depth.

    `index` counts the frames of the device from 0. `time_s` is the start of the frame on the
    device's own clock, which is 0 at the first frame. `duration_s` is the time that a real device
    needs to expose and read out its `pictures`. `p_wrong` is None if the decoder does not estimate
    it. A frame of a `VirtualScanner` has all other values. In a frame of a `BagScanner`, whatever
    the bag lacks is None, and `duration_s` is NaN; `sigma_m` is always None.
    """

    index: int
    time_s: float
    duration_s: float
    pictures: int | None
    camera: Optics
    depth_m: arrays.FloatArray_h_w
    sigma_m: arrays.FloatArray_h_w | None
    p_wrong: arrays.FloatArray_h_w | None
    reason: arrays.UInt8Array_h_w | None
    gray: arrays.UInt8Array_h_w | None
    rgb: arrays.UInt8Array_h_w_3 | None

    def __post_init__(self) -> None:
        for picture in (self.gray, self.rgb):
            if picture is not None:
                picture.flags.writeable = False

    @property
    def points(self) -> arrays.FloatArray_h_w_3:
        """Point of each pixel [m] in the camera frame; NaN without depth."""
        return points(self.camera, self.depth_m)

    @property
    def K(self) -> arrays.FloatArray_3_3:
        """Camera matrix; `camera.distortion` has the coefficients of the lens."""
        return self.camera.K


class ScannerDevice(Protocol):
    """A scanner as a program sees it; `VirtualScanner` and `BagScanner` both have these calls."""

    @property
    def T_world_cam(self) -> arrays.FloatArray_4_4: ...

    def connect(self) -> None: ...

    def disconnect(self) -> None: ...

    def set(self, key: str, value: Any) -> None: ...

    def trigger(self, *, wait: bool = False) -> ScannerFrame: ...
