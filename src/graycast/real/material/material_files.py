"""A fitted material as YAML for a configuration, as printed lines, and as a plot."""

import math
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from ...base.plotting import ACCENT, SECOND, SOFT, caption, legend_below, plain_figure, save_png
from .classes import Division
from .fitting import WIDE, FittedValue, MaterialFit
from .mottle import MottleFit
from .observing import Reflections
from .surface_model import mean_light

CERTAIN_LEAD = 5.0  # A smaller difference of log likelihoods does not determine the kind.
SPAN = 0.5  # A wider interval of the base colour is no result.
MOST_POINTS = 4000
BINS = 24
# The colour of each class in the picture of the classes, RGB.
PAINTS = {"blue": (50, 110, 220), "orange": (240, 140, 30), "green": (40, 170, 90)}


def describe_fit(fit: MaterialFit, mottle: MottleFit | None = None) -> list[str]:
    """Return printed lines with the result, and notes on anything that the scan leaves open."""
    low, high = (math.degrees(angle) for angle in fit.angles_rad)
    lines = [
        f"{fit.pixels} pixels at half angles from {low:.0f} to {high:.0f} degrees",
        f"kind           {fit.kind}" + _doubt(fit),
        f"roughness      {_number(fit.roughness, WIDE)}",
        f"base colour    {_number(fit.color, SPAN)}, at the projector's wavelength",
        f"scatter        {fit.scatter:.1%} of the light of single pixels",
    ]
    if fit.diffuse is not None:
        lines.append(f"diffuse        {_number(fit.diffuse, SPAN)}, the scattered share")
    if mottle is not None:
        low_m, high_m = mottle.length_m.low, mottle.length_m.high
        span = f" ({1e3 * low_m:.2f} to {1e3 * high_m:.2f})" if not mottle.limit else ""
        lines.append(
            f"mottle         {_number(mottle.spread, SPAN)}, of "
            f"{mottle.limit}{1e3 * mottle.length_m.value:.2f} mm{span}"
        )
    if fit.roughness.high - fit.roughness.low > WIDE:
        lines.append(
            f"note: roughness is not determined: all half angles are from {low:.0f} to {high:.0f} "
            "degrees; scan parts that lie in more directions"
        )
    if not fit.known:
        lines.append(
            "note: the intensity of the projector is unknown, so base colour and kind follow only "
            "from the shape of the highlight: mark a matt white sheet with --reference"
        )
    return lines


def material_text(fit: MaterialFit, source: str, mottle: MottleFit | None = None) -> str:
    """Return the material as a section of a configuration, with intervals as comments."""
    lines = [
        f"# Fitted to {source}: {fit.pixels} pixels.",
        "# Intervals hold 95 %. These keys belong to material: of a part in cell.yaml.",
    ]
    color = f"[{', '.join([f'{fit.color.value:.3f}'] * 3)}]"
    lines += _line("base_color", color, fit.color, SPAN, "at the projector's wavelength")
    if fit.lead >= CERTAIN_LEAD:
        lines.append(f"metallic: {float(fit.kind == 'metal')}")
    else:
        lines.append(
            f"# metallic is not determined by this scan: the other values are those of {fit.kind}, "
            f"and {_other_kind(fit)} explains the light as well."
        )
    rough = f"{fit.roughness.value:.3f}"
    lines += _line("roughness", rough, fit.roughness, WIDE, "")
    if fit.diffuse is not None:
        share = f"{fit.diffuse.value:.3f}"
        lines += _line("diffuse", share, fit.diffuse, SPAN, "the scattered share")
    lines.append("specular: 0.5  # assumed: a coat of refractive index 1.5; metal has no coat")
    if mottle is not None:
        share = f"{mottle.on(fit.material).mottle:.3f}"
        lines += _line("mottle", share, mottle.spread, SPAN, "")
        length = mottle.length_m
        span = mottle.limit or f"{length.low:.6f} to {length.high:.6f}"
        lines.append(f"mottle_length_m: {length.value:.6f}{_comment(span)}")
    lines.append(f"# The light of single pixels scatters by {fit.scatter:.1%} about this material.")
    return "\n".join(lines) + "\n"


def matt_text(reflectance: float, source: str) -> str:
    """Return a matt material of a known reflectance as a section of a configuration."""
    return (
        f"# The surface of the reference in {source}, as stated: it is not fitted.\n"
        f"base_color: [{', '.join([f'{reflectance:g}'] * 3)}]\n"
        "metallic: 0.0\nroughness: 1.0\nspecular: 0.0\n"
    )


def draw_fit(fit: MaterialFit, observations: Reflections, path: Path) -> None:
    """Draw measured and fitted light over the half angle, as a PNG, without saturated pixels."""
    observations = observations.part(np.flatnonzero(~observations.clipped))
    count = len(observations)
    every = max(1, count // MOST_POINTS)
    some = observations.part(np.arange(0, count, every))
    angle = np.degrees(some.half_angle_rad)
    measured = some.light / fit.scale
    fitted = mean_light(some, fit.material)
    figure, (ax,) = plain_figure(6.0, 4.2, [1])
    ax.semilogy(angle, measured, ".", color=SOFT, ms=2, label="measured pixels")
    edge = np.linspace(angle.min(), angle.max() + 1e-6, BINS + 1)
    place = np.digitize(angle, edge) - 1
    full = [b for b in range(BINS) if (place == b).sum() >= 5]
    middle = [(edge[b] + edge[b + 1]) / 2 for b in full]
    for values, color, marker, label in (
        (measured, ACCENT, "o-", "measured, median"),
        (fitted, SECOND, "s--", "fitted, median"),
    ):
        median = [float(np.median(values[place == b])) for b in full]
        ax.semilogy(middle, median, marker, color=color, ms=4, lw=1.2, label=label)
    unit = "reflectance f cos [1/sr]" if fit.known else "reflectance f cos, in an unknown unit"
    rough = f"roughness {fit.roughness.value:.2f}, base colour {fit.color.value:.2f}"
    caption(ax, f"{fit.kind}: {rough}", "half angle [degrees]", unit)
    legend_below(ax, columns=3)
    save_png(figure, path, dpi=110)


def describe_class(observations: Reflections, division: Division, number: int) -> str:
    """Return a line with a class's share of the pixels, place, and colour in the picture."""
    rows, columns = observations.pixel[division.members(number)].T
    (top, bottom), (left, right) = (np.percentile(each, [5, 95]) for each in (rows, columns))
    return (
        f"class {number + 1}: {division.share(number):.1%} of the pixels, nine tenths of them in "
        f"rows {top:.0f} to {bottom:.0f} and columns {left:.0f} to {right:.0f}; "
        f"{list(PAINTS)[number]} in the picture"
    )


def classes_picture(
    light: Float[np.ndarray, "h w"], observations: Reflections, division: Division
) -> bytes:
    """Return the scan's light as a PNG, with each class in its colour and the rest in grey."""
    bright = np.clip(light / max(float(np.percentile(light, 99)), 1e-9), 0, 1) ** 0.5
    picture = np.repeat(120 * bright[..., None], 3, axis=-1)
    for number, paint in zip(range(division.count), PAINTS.values(), strict=False):
        row, column = observations.pixel[division.members(number)].T
        picture[row, column] = (0.4 + 0.6 * bright[row, column])[:, None] * paint
    encoded = np.ascontiguousarray(picture.astype(np.uint8)[..., ::-1])
    return cv2.imencode(".png", encoded)[1].tobytes()


def _doubt(fit: MaterialFit) -> str:
    if fit.lead >= CERTAIN_LEAD:
        return ""
    return f" (not determined: {_other_kind(fit)} explains the light as well)"


def _other_kind(fit: MaterialFit) -> str:
    return "plastic" if fit.kind == "metal" else "metal"


def _number(interval: FittedValue, widest: float) -> str:
    span = f"{interval.low:.3f} to {interval.high:.3f}"
    if interval.high - interval.low > widest:
        return f"not determined ({span})"
    return f"{interval.value:.3f} ({span})"


def _line(key: str, text: str, interval: FittedValue, widest: float, more: str) -> list[str]:
    """Return a key with its interval, or only a comment if the scan does not determine the key."""
    span = f"{interval.low:.3f} to {interval.high:.3f}"
    if interval.high - interval.low > widest:
        return [f"# {key} is not determined by this scan: {span}."]
    return [f"{key}: {text}{_comment(', '.join(filter(None, (span, more))))}"]


def _comment(text: str) -> str:
    return f"  # {text.strip()}" if text else ""
