"""Exposure times: fixed ones, or those that the light of the metered pixels asks for."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ..base.public_value import public_value
from ..base.settings import Positive, check_fields
from .sensor import SensorSpec, auto_exposure_s

# Of the metered pixels, so many percent may be too dark and too bright: our choice. A few pixels
# that mirror the projector do not shorten the exposures.
DARKEST, BRIGHTEST = 1.0, 99.8
# A pixel is well exposed between a tenth of the range and `target` (at its default); our choice.
WELL_EXPOSED = 0.1
# Mech-Eye exposes from 0.1 to 99 ms (docs.mech-mind.net, Scanning3DSettings), a ratio of 1000. It
# takes up to 3 exposures, and LMI's GoPxL up to 5 (am.lmi3d.com, Multiple Exposure).
SPAN_MAX, MOST = 1000.0, 5


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureSpec:
    """A fixed exposure time, or times that follow from the white frame."""

    exposure_s: Annotated[
        Positive | None,
        Field(description="The exposure time in seconds, instead of percentile and target."),
    ] = None
    percentile: Annotated[
        float,
        Field(gt=0, le=100, description="The percentile of the white frame that reaches target."),
    ] = 99.0
    target: Annotated[
        float,
        Field(
            gt=0, le=1, description="The value at the percentile, as a share of the sensor's range."
        ),
    ] = 0.8
    factors: Annotated[
        tuple[Positive, ...],
        Field(
            min_length=1,
            description="The exposure times as multiples of the chosen exposure; several "
            "pictures are merged (HDR).",
        ),
    ] = (1.0,)
    auto: Annotated[
        bool,
        Field(
            description="Whether number and times of the exposures are chosen for each picture "
            "from the white frame inside the bin: the shortest for its highlights, the longest "
            "for its dark parts. It replaces exposure_s and factors."
        ),
    ] = False
    most: Annotated[
        int,
        Field(ge=1, le=10, description="The largest number of exposures that auto takes."),
    ] = MOST

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureTimes:
    """The times of all exposures, and the one on whose scale their light is compared."""

    reference_s: float
    times_s: tuple[float, ...]


def exposure_times(
    white: Float[np.ndarray, "*pixels"], sensor: SensorSpec, exposure: ExposureSpec
) -> ExposureTimes:
    """Return the exposure times for a white frame.

    Args:
        white: all light of the metered pixels in the brightest frame [W sr^-1 m^-2].

    Raises:
        ValueError: the metered pixels are dark.
    """
    if exposure.auto:
        return _bracket(white, sensor, exposure)
    reference_s = exposure.exposure_s or auto_exposure_s(
        white, sensor, percentile=exposure.percentile, target=exposure.target
    )
    times_s = tuple(factor * reference_s for factor in exposure.factors)
    return ExposureTimes(
        reference_s=reference_s if len(times_s) > 1 else times_s[0], times_s=times_s
    )


def _bracket(
    white: Float[np.ndarray, "*pixels"], sensor: SensorSpec, exposure: ExposureSpec
) -> ExposureTimes:
    """Return times in equal ratios that expose the lit pixels well, in as few as possible.

    The shortest puts the brightest light at `target`. n exposures have the ratio r = R^(1/n), where
    R is the ratio of the brightest light to the darkest. Each light is then between target / r and
    target in one of them. n is the least for which r is at most target / WELL_EXPOSED, and no more
    than `most`. The longest is at most SPAN_MAX times the shortest; darker pixels are given up.
    """
    lit = white[white > 0]
    if not lit.size:
        raise ValueError(
            "no metered pixel has light: point the rig at the bin, or set exposure.exposure_s"
        )

    def time_s(percentile: float) -> float:
        return auto_exposure_s(lit, sensor, percentile=percentile, target=exposure.target)

    shortest_s = time_s(BRIGHTEST)
    ratio = max(time_s(DARKEST) / shortest_s, 1.0)
    step_max = max(exposure.target / WELL_EXPOSED, 2.0)
    count = max(1, math.ceil(math.log(ratio) / math.log(step_max) - 1e-9))
    count = min(count, exposure.most)
    step = ratio ** (1 / count)
    if count > 1:
        step = min(step, SPAN_MAX ** (1 / (count - 1)))
    times_s = tuple(shortest_s * step**k for k in range(count))
    reference_s = time_s(exposure.percentile) if count > 1 else shortest_s
    return ExposureTimes(reference_s=reference_s, times_s=times_s)
