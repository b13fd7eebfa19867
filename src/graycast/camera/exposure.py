"""Exposure times, which are either fixed or chosen from the light of the metered pixels."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from ..base.public_value import public_value
from ..base.settings import Positive, check_fields
from .sensor import SensorSpec, auto_exposure_s

# Percentiles of the metered pixels that are to be exposed well (our choice). With a limit below
# 100 %, a few pixels that mirror the projector do not shorten the exposures.
DARKEST, BRIGHTEST = 1.0, 99.8
# A pixel is well exposed from this share of the range up to `target`; this is our choice.
WELL_EXPOSED = 0.1
LEAST_STEP = 2.0  # Neighbouring exposures differ at least by this factor, so that each adds light.
# A Mech-Eye has exposure times from 0.1 to 99 ms (docs.mech-mind.net, Scanning3DSettings), a ratio
# of 1000. It takes up to 3 exposures; LMI's GoPxL takes up to 5 (am.lmi3d.com, Multiple Exposure).
SPAN_MAX, MOST = 1000.0, 5


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureSpec:
    """A fixed exposure time, or rules to choose times from the white frame."""

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
    """The times of all exposures, and the reference time to which their light is scaled."""

    reference_s: float
    times_s: tuple[float, ...]


def exposure_times(
    white: Float[np.ndarray, "*pixels"], sensor: SensorSpec, exposure: ExposureSpec
) -> ExposureTimes:
    """Return the exposure times for a scene with the given white frame.

    Args:
        white: radiance of the metered pixels in the brightest frame [W sr^-1 m^-2].

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
    """Return the fewest exposure times, in equal ratios, that expose all lit pixels well.

    The shortest time puts the brightest light at `target`. The n times have the ratio r = R^(1/n),
    where R is the ratio of the brightest to the darkest light. Each pixel is then between
    target / r and target in one of them. n is the smallest number with r <= target / WELL_EXPOSED,
    but at most `most`. The longest time is at most SPAN_MAX times the shortest, for any scene.
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
    step_max = max(exposure.target / WELL_EXPOSED, LEAST_STEP)
    count = max(1, math.ceil(math.log(ratio) / math.log(step_max) - 1e-9))
    count = min(count, exposure.most)
    step = ratio ** (1 / count)
    if count > 1:
        step = min(step, SPAN_MAX ** (1 / (count - 1)))
    times_s = tuple(shortest_s * step**k for k in range(count))
    reference_s = time_s(exposure.percentile) if count > 1 else shortest_s
    return ExposureTimes(reference_s=reference_s, times_s=times_s)
