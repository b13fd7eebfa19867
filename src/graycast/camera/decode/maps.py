"""Inputs and results of decoding: sensor levels, settings and maps."""

from dataclasses import dataclass, replace
from enum import IntFlag
from typing import Annotated

import numpy as np
from pydantic import Field

from ...base import array_types as arrays
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...rig.optics import Optics, mask_points
from ..sensor import SensorSpec, stored_saturation_dn
from .reasons import Reason

# A depth is wrong if it is off by more than this length and by more than this number of its sigmas.
WRONG_M, WRONG_SIGMAS = 1e-3, 5.0


class Mark(IntFlag):
    """Properties of a pixel in addition to its reason."""

    CLIPPED = 1  # A frame that determines the pixel's position is saturated.
    SETTLED = 2  # The pixel's phases allow several positions; its neighbours chose one.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """The offset, the saturation and the noise of a sensor's digital numbers.

    The variance of a stored value y is `floor_dn2 + slope_dn (y - offset_dn)` [DN^2] (EMVA 1288):
    the first term is read noise and quantisation, the second is photon noise.
    """

    offset_dn: float
    saturation_dn: float
    floor_dn2: float
    slope_dn: float

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.saturation_dn > self.offset_dn:
            span = f"offset_dn {self.offset_dn}, saturation_dn {self.saturation_dn}"
            raise ValueError(f"{span}: saturation_dn must be greater than offset_dn")
        if not (self.floor_dn2 > 0 and self.slope_dn >= 0):
            law = f"floor_dn2 {self.floor_dn2}, slope_dn {self.slope_dn}"
            raise ValueError(f"noise is {law}; the floor is positive, the slope not negative")

    @property
    def range_dn(self) -> float:
        return self.saturation_dn - self.offset_dn


def levels_of(sensor: SensorSpec) -> Levels:
    """Return the levels of a sensor with a known specification."""
    return Levels(
        offset_dn=sensor.offset_dn,
        saturation_dn=float(stored_saturation_dn(sensor)),
        floor_dn2=float(sensor.variance_dn2(sensor.offset_dn)),
        slope_dn=sensor.gain_dn_per_e,
    )


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class DecodeSpec:
    """The conditions under which a pixel is decoded.

    The contrast of a pixel is its brightest minus its darkest frame or, for a phase code, twice
    the amplitude. It must reach `min_contrast`, a share of the sensor's range, and `min_sigmas`,
    in standard deviations of the noise of the darkest frame. A bit is doubtful if its signal is
    below `doubt` times the contrast. At any position of a Gray code only one bit changes, so two
    doubtful bits of an axis are a contradiction. The `fine_bits` finest bits do not count: a pixel
    may see several of their stripes and still be right, so doubt only widens `sigma`. One doubtful
    bit is a contradiction if its error would cost more than 2^fine_bits values or, with a phase
    code (where `fine_bits` is not used), half a period. A pixel with contradictory bits still has a
    phase: it gets its period from its neighbours if `settling_votes` of them agree.
    With a phase code, stripes have a low contrast in a pixel that sees two surfaces or indirect
    light: below `min_visibility` of brightest minus darkest frame, the reason is INTERREFLECTION.
    If both axes are coded, a point farther from its epipolar line than `max_epipolar_px` and
    three standard deviations is an outlier; 0 switches this test off.
    `max_p_wrong` uses all of this evidence at once: depth is removed if the probability that it is
    wrong is larger. Set `doubt`, `min_visibility` and `max_epipolar_px` to 0 with it, as the preset
    scanners do.
    """

    min_contrast: Annotated[
        float,
        Field(
            gt=0,
            lt=1,
            description="Lowest contrast of a decoded pixel, as a share of the sensor's range: the "
            "brightest minus the darkest frame, or twice the amplitude of a phase code.",
        ),
    ] = 0.02
    min_sigmas: Annotated[
        float,
        Field(
            ge=0,
            description="Lowest contrast of a decoded pixel, in standard deviations of the "
            "noise of the darkest frame.",
        ),
    ] = 0.0
    doubt: Annotated[
        float,
        Field(
            ge=0,
            lt=1,
            description="A bit whose signal is below this share of the contrast is doubtful.",
        ),
    ] = 0.15
    fine_bits: Annotated[
        int,
        Field(
            ge=0,
            description="The number of the finest bits of a Gray code whose doubt only widens "
            "sigma. A phase code does not use it.",
        ),
    ] = 3
    settling_votes: Annotated[
        int,
        Field(
            ge=0,
            le=24,
            description="A pixel with a phase whose Gray bits contradict each other takes the "
            "period that at least this many of its 24 neighbours imply. 0 switches this off.",
        ),
    ] = 0
    min_visibility: Annotated[
        float,
        Field(
            ge=0,
            lt=1,
            description="Lowest contrast of a phase code's stripes, as a share of the contrast "
            "between the brightest and the darkest frame of the same pixel. Pixels that see two "
            "surfaces at once have less. 0 switches this off.",
        ),
    ] = 0.0
    max_epipolar_px: Annotated[
        float,
        Field(
            ge=0,
            description="Largest distance of a point from its epipolar line in "
            "projector pixels; a point beyond it is an outlier. 0 "
            "switches the test off.",
        ),
    ] = 2.0
    max_p_wrong: Annotated[
        float,
        Field(
            gt=0,
            le=1,
            description="Largest probability that a depth is wrong, or without a rig a position, "
            "estimated from all frames and the neighbours of the pixel. Depth with a larger "
            "probability is removed. 1 switches this off.",
        ),
    ] = 1.0

    def __post_init__(self) -> None:
        check_fields(self)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSpec:
    """The settings of the filters; None or 0 switches a filter off, and all are off by default.

    An `edge_px` of 1 includes the four neighbours of a pixel, 1.5 includes diagonal ones, too. A
    `smoothing_px` of 0.55 reduces white noise to 0.56 and correlates neighbours by 0.36.
    `hidden_sigmas` is for `without_hidden`. `outlier_sigmas` is a multiple of `sigma_m` or, if that
    is larger, of the neighbours' scatter.
    """

    flying_angle_deg: Annotated[
        float | None,
        Field(
            ge=0,
            lt=90,
            description="Pixels between two surfaces are removed if the line of sight meets "
            "the step at more than this angle, in degrees from the normal.",
        ),
    ] = None
    outlier_sigmas: Annotated[
        float | None,
        Field(
            ge=0,
            description="Pixels are removed whose depth differs from their neighbours by "
            "more than this number of standard deviations.",
        ),
    ] = None
    outlier_share: Annotated[
        float,
        Field(
            ge=0,
            description="An outlier must also differ from its neighbours by "
            "more than this share of its depth.",
        ),
    ] = 3e-4
    outlier_repair: Annotated[
        bool,
        Field(
            description="Whether an outlier within a surface gets the depth of that surface "
            "instead of being removed.",
        ),
    ] = False
    hidden_sigmas: Annotated[
        float | None,
        Field(
            ge=0,
            description="Pixels are removed that a nearer surface hides from the projector "
            "by more than this number of standard deviations.",
        ),
    ] = None
    edge_px: Annotated[
        float | None,
        Field(
            ge=0,
            le=5,
            description="Pixels are removed whose distance to a depth step or to a pixel without "
            "depth is at most this number of pixels. 1 removes the pixels on the border of each "
            "surface.",
        ),
    ] = None
    island_px: Annotated[
        int | None,
        Field(ge=0, description="Connected surfaces of fewer pixels than this are removed."),
    ] = None
    smoothing_px: Annotated[
        float | None,
        Field(ge=0, le=10, description="Standard deviation of the smoothing kernel in pixels."),
    ] = None
    step_angle_deg: Annotated[
        float,
        Field(
            gt=0,
            lt=90,
            description="Neighbouring pixels belong to two surfaces if the surface through "
            "both is seen at more than this angle, in degrees from the normal.",
        ),
    ] = 80.0

    def __post_init__(self) -> None:
        check_fields(self)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class CodeMap:
    """The projector position that each camera pixel sees.

    `column`, `row` and their standard deviations [projector px] are NaN where `reason` is not
    DECODED, and for an axis that is not coded. `modulation` is brightest minus darkest frame or,
    for a phase code, twice the amplitude, as a share of the sensor's range. `mark` has the bits of
    `Mark`; it is None if the marks were not stored.
    """

    column: arrays.FloatArray_h_w
    row: arrays.FloatArray_h_w
    sigma_column: arrays.FloatArray_h_w
    sigma_row: arrays.FloatArray_h_w
    modulation: arrays.FloatArray_h_w
    reason: arrays.UInt8Array_h_w
    mark: arrays.UInt8Array_h_w | None = None

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if getattr(self, name) is not None:
                getattr(self, name).flags.writeable = False

    def without(
        self, removed: arrays.BoolArray_h_w, reason: Reason | arrays.UInt8Array_any
    ) -> "CodeMap":
        """Return the map without the positions of some pixels.

        Args:
            reason: the reason of all removed pixels, or of each of them, row by row.
        """
        reasons = self.reason.copy()
        reasons[removed] = reason
        maps = {
            name: np.where(removed, np.float32(np.nan), getattr(self, name))
            for name in ("column", "row", "sigma_column", "sigma_row")
        }
        return replace(self, reason=reasons, **maps)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMap:
    """A measured depth map: z in the camera frame and its standard deviation [m].

    Both are NaN where `reason` is not DECODED, and so is `p_wrong`, the probability that the depth
    is wrong (see `is_wrong`); it is None if it was not estimated. `camera` has the optics of the
    map's pixels.
    """

    depth_m: arrays.FloatArray_h_w
    sigma_m: arrays.FloatArray_h_w
    reason: arrays.UInt8Array_h_w
    camera: Optics
    p_wrong: arrays.FloatArray_h_w | None = None

    def __post_init__(self) -> None:
        for map_of_pixels in (self.depth_m, self.sigma_m, self.reason, self.p_wrong):
            if map_of_pixels is not None:
                map_of_pixels.flags.writeable = False

    def without(
        self, removed: arrays.BoolArray_h_w, reason: Reason | arrays.UInt8Array_any
    ) -> "DepthMap":
        """Return the map without the depth of some pixels.

        Args:
            reason: the reason of all removed pixels, or of each of them, row by row.
        """
        depth_m, sigma_m, reasons = (m.copy() for m in (self.depth_m, self.sigma_m, self.reason))
        depth_m[removed] = sigma_m[removed] = np.nan
        reasons[removed] = reason
        p_wrong = self.p_wrong
        if p_wrong is not None:
            p_wrong = np.where(removed, np.float32(np.nan), p_wrong)
        return replace(self, depth_m=depth_m, sigma_m=sigma_m, reason=reasons, p_wrong=p_wrong)

    def is_wrong(self, true_m: arrays.FloatArray_h_w) -> arrays.BoolArray_h_w:
        """Return a mask of the pixels whose depth is wrong by more than both limits."""
        off_m = np.abs(self.depth_m - true_m)
        with np.errstate(invalid="ignore"):  # NaN means no depth or no surface.
            return (off_m > WRONG_M) & (off_m > WRONG_SIGMAS * self.sigma_m)

    def points(self) -> arrays.FloatArray_n_3:
        """Return the measured points [m] in the camera frame, row by row."""
        return mask_points(self.camera, self.depth_m, np.isfinite(self.depth_m))
