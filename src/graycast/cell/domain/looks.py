"""Convert random values to colours and materials."""

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ...base.color import linear, linear_share, srgb
from ...world.parts import Material

ROUGHNESS = (0.05, 1.0)  # the limits, unless a material was smoother from the start

Rgb = tuple[float, float, float]

_RGB_OF_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)  # XYZ to sRGB with white D65, as in IEC 61966-2-1


def color_of(values: Mapping[str, float]) -> Rgb:
    """Return the linear reflectance of a hue [deg], saturation and value in the sRGB encoding."""
    encoded = colorsys.hsv_to_rgb(values["hue_deg"] / 360, values["saturation"], values["value"])
    red, green, blue = linear_share(np.array(encoded)).tolist()
    return red, green, blue


def material_of(values: Mapping[str, Any], texture: UInt8[np.ndarray, "h w 3"] | None) -> Material:
    """Return the surface of a random look; a texture replaces its colour."""
    return Material(
        base_color=color_of(values["color"]),
        texture=texture,
        metallic=values["metallic"],
        roughness=values["roughness"],
    )


def retouched(
    material: Material,
    *,
    brightness: float,
    roughness: float,
    metallic: float = 0.0,
    tint: Sequence[float] = (1.0, 1.0, 1.0),
) -> Material:
    """Return a material with changed reflectance, roughness and metallic.

    `brightness` is a factor for all reflectances, `tint` a further factor for each band except the
    projector's; in a texture, they multiply the linear value of each texel. Reflectance is clipped
    to the material's limit, 1 without a mottle. `roughness` and `metallic` are added and clipped to
    their limits; grooves stay on metal only, and a transparent material does not become metallic.
    """
    limit = material.reflectance_limit
    factor = [brightness * own for own in tint]
    line = material.projector_reflectance
    roughness += material.roughness
    least = min(ROUGHNESS[0], material.roughness)
    metallic += material.metallic
    red, green, blue = (
        min(limit, f * level) for f, level in zip(factor, material.base_color, strict=True)
    )
    metallic = min(max(metallic, 0.0), 1.0) if material.transparent is None else 0.0
    return replace(
        material,
        base_color=(red, green, blue),
        texture=None if material.texture is None else _multiplied(material.texture, factor),
        projector_reflectance=None if line is None else min(limit, brightness * line),
        roughness=min(max(roughness, least), ROUGHNESS[1]),
        metallic=metallic,
        anisotropy=material.anisotropy if metallic > 0 else 0.0,
        film=material.film if metallic > 0 else None,
        diffuse=material.diffuse if metallic > 0 else 0.0,
    )


def _multiplied(
    texture: UInt8[np.ndarray, "h w 3"], factor: list[float]
) -> UInt8[np.ndarray, "h w 3"]:
    """Multiply each band's linear value of a texture; a factor of 1 changes no texel."""
    level = linear(np.arange(256, dtype=np.uint8))
    table = srgb(np.array(factor)[:, None] * level)  # clipped to 1
    return np.stack([table[band][texture[..., band]] for band in range(3)], axis=-1)


def light_of(temperature_k: float) -> Rgb:
    """Return the linear sRGB of a black body's light, scaled to a mean of 1.

    The colour is from a cubic fit of the Planckian locus from 1667 to 25000 K. Source: B. Kim et
    al., US patent 7024034, 2006; colours beyond sRGB's blue are cut to 0.
    """
    x, y = _chromaticity(temperature_k)
    bands = np.maximum(_RGB_OF_XYZ @ np.array([x / y, 1.0, (1 - x - y) / y]), 0)
    red, green, blue = (bands / bands.mean()).tolist()
    return red, green, blue


def _chromaticity(temperature_k: float) -> tuple[float, float]:
    """Return the chromaticity x, y (CIE 1931)."""
    t = 1e3 / temperature_k
    if temperature_k <= 4000:
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if temperature_k <= 2222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif temperature_k <= 4000:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return x, y
