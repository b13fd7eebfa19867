"""Modulation, white frame and reasons against each other: what the decoder's own rules allow.

Leaves out: of scenes by Cycles what compares frames with the white one; modulation that is too
small by a factor where ambient light is strong and no pixel lies near the decoder's threshold;
reasons exchanged among those that judge the code (contradictory, interreflection, outside the
projector, out of range, outlier), but for what code maps say.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool

from ...camera.decode import DecodeSpec, Levels, Reason, levels_of
from ...camera.scanner import ExposureSpec
from ...camera.sensor import SensorSpec
from ..safe_reading import Unreadable
from ..sample import LEAST_DECODED
from .evidence import Evidence

# Sound pictures of all codecs break none of these rules in any pixel; a fault breaks them in
# thousands. What another processor's rounding could do stays far below.
WRONG_SHARE, WRONG_PX = 1e-4, 10
NOISE_SIGMAS = 10.0  # Extremes of some fifty frames and the white one are set against each other.
STRIPES_SHOW = 1.02  # Patterns may outshine white by what a lens's veil leaves of it.
STEP_MAX = 65535
TOP = 0.75  # A pixel at the range's top has this share of it in the white frame, with 8 bits too.
DIM_SIGMAS = 8.0  # The decoder's own limit for shadow is 6.


def light_problems(scene: Evidence) -> Iterator[str]:
    """All that the decoder cannot have seen."""
    decoded = float((scene.image["reason_sl"] == Reason.DECODED).mean())
    if decoded < LEAST_DECODED:
        yield (
            f"{decoded:.2%} of the pixels have a scanner depth, so no pixel has one: the scene "
            "may be outside of the rig's working range or unlit"
        )
    yield from _scale_problems(scene)
    if scene.scanning is None:
        return
    for what, wrong in _rules(scene, *scene.scanning):
        count = int(wrong.sum())
        if count > WRONG_PX + WRONG_SHARE * wrong.size:
            yield f"{what} in {count} pixels"


def _scale_problems(scene: Evidence) -> Iterator[str]:
    """The writer's scale is the finest power of two that holds the strongest modulation."""
    strongest, scale = int(scene.image["modulation_sl"].max()), scene.plain.scanner.modulation_scale
    whole = np.log2(scale) % 1 == 0
    if not whole or (strongest <= STEP_MAX // 2 and scale > 2.0**-32):
        yield (
            f"modulation_sl: its strongest value is {strongest} steps of {scale:g}; a finer step "
            "would hold it, so values or modulation_scale were changed"
        )


def _rules(
    scene: Evidence, sensor: SensorSpec, spec: DecodeSpec, exposure: ExposureSpec
) -> Iterator[tuple[str, Bool[np.ndarray, "h w"]]]:
    reason, modulation, levels = scene.image["reason_sl"], scene.modulation, levels_of(sensor)
    least, half = spec.min_contrast, scene.plain.scanner.modulation_scale / 2
    unlit = np.isin(reason, (Reason.SHADOW, Reason.LOW_MODULATION, Reason.OUTSIDE_PROJECTOR))
    rated = ~unlit & (reason != Reason.SATURATED)
    weak = "modulation_sl is under the decoder's min_contrast where reason_sl says that it suffices"
    yield weak, rated & (modulation < least - half)
    # `gray` is of one exposure: what the sensor stored in a longer one was as much more.
    factors = _factors(scene, exposure)
    longest, shortest = max(factors), min(factors)
    full_dn, half_step = sensor.saturation_dn - levels.offset_dn, 0.5 * (longest > 1)
    white_dn = np.minimum((scene.image["gray_sl"] + half_step) / 255 * longest, 1) * full_dn
    noise_dn = np.sqrt(levels.floor_dn2 + levels.slope_dn * white_dn)
    contrast_dn = modulation * levels.range_dn
    # The decoder takes the noise of the darkest frame, which is not kept: white has more.
    at_noise_dn = spec.min_sigmas * noise_dn + (_step_dn(levels) if spec.min_sigmas else 0)
    strong = "modulation_sl is over min_contrast where reason_sl says low_modulation"
    enough = (modulation > least + half) & (contrast_dn > at_noise_dn)
    yield strong, (reason == Reason.LOW_MODULATION) & enough
    lit = "modulation_sl is over the noise where reason_sl says shadow"
    yield lit, (reason == Reason.SHADOW) & (contrast_dn > DIM_SIGMAS * noise_dn + _step_dn(levels))
    if scene.plain.manifest.get("backend") == "cycles":
        return  # every frame is rendered by itself: a pattern's noise may outshine the white frame
    bright_dn = STRIPES_SHOW * white_dn + NOISE_SIGMAS * noise_dn + _step_dn(levels)
    outshone = "modulation_sl is more than all the light that gray_sl shows"
    yield outshone, (contrast_dn > bright_dn) & (scene.image["gray_sl"] < 255)
    dark = "gray_sl is dark where reason_sl says saturated"
    top = TOP * 255 / max(shortest, 1)
    yield dark, (reason == Reason.SATURATED) & (scene.image["gray_sl"] < top)


def _factors(scene: Evidence, exposure: ExposureSpec) -> tuple[float, ...]:
    """Return the exposure times of a picture as multiples of the one that `gray_sl` is of."""
    if not exposure.auto:
        return exposure.factors if len(exposure.factors) > 1 else (1.0,)
    facts = scene.manifest_record
    if not facts.exposures_s:
        raise Unreadable("manifest.json: exposures_s is missing, which automatic exposure writes")
    return tuple(time_s / facts.exposure_s for time_s in facts.exposures_s)


def _step_dn(levels: Levels) -> float:
    """What rounding to 8 bits may cost."""
    return levels.range_dn / 255
