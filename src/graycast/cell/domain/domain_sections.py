"""Configuration of a domain: the real cell with tolerances, or random scenes.

Ranges are [lowest, highest]; values are uniform in between, or as the key's description says.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ...base.settings import Level, PositiveSpan, Settings, Share, ShareSpan, Span, SpanOf
from ...world.parts.part import Roughness
from ...world.parts.part_sections import PartSection

KINDS = ("adapted", "randomized")

Angle = SpanOf[Annotated[float, Field(ge=-360, le=360)]]
Kelvins = SpanOf[Annotated[float, Field(ge=1667, le=25000)]]
Counts = SpanOf[Annotated[int, Field(ge=0, le=255)]]

# --- adapted -----------------------------------------------------------------------------------


class CameraTolerance(Settings):
    """Limits of the rig's deviation from the configured view."""

    position_m: Level = Field(
        default=1e-3,
        description="The largest shift of the rig along each axis of the world, in metres.",
    )
    rotation_deg: Level = Field(
        default=0.1,
        le=10,
        description="The largest rotation of the rig about each axis of the camera, in degrees.",
    )


class BinTolerance(Settings):
    """Limits of the bin's deviation, flat on the table, from the middle of the cell."""

    position_m: Level = Field(
        default=2e-3, description="The largest shift of the bin along x and along y, in metres."
    )
    rotation_deg: Level = Field(
        default=0.5, le=180, description="The largest rotation of the bin about z, in degrees."
    )


class LampTolerance(Settings):
    """Limits of the deviation of lamps and environment from the configured light."""

    position_m: Level = Field(
        default=5e-3,
        description="The largest shift of a lamp along each axis of the world, in metres.",
    )
    level: Share = Field(
        default=0.05,
        description="The largest change of a lamp's radiance, relative to the radiance.",
    )
    environment_level: Share = Field(
        default=0.05,
        description="The largest change of the environment's radiance, relative to the radiance.",
    )


class PartTolerance(Settings):
    """Limits of the deviation of a batch's look; parts of a kind share one look."""

    reflectance: Share = Field(
        default=0.03,
        description="The largest change of the reflectance, relative to it and equal in all bands.",
    )
    roughness: Share = Field(
        default=0.02,
        description="The largest change of the roughness. The result is at most 1, and at least "
        "0.05 or the roughness of a smoother material.",
    )


class AdaptedSection(Settings):
    """The real cell. A value deviates uniformly by at most its tolerance in either direction."""

    kind: Literal["adapted"] = Field(description="The kind of the domain: adapted.")
    camera: CameraTolerance = CameraTolerance()
    bin: BinTolerance = BinTolerance()
    lamps: LampTolerance = LampTolerance()
    parts: PartTolerance = PartTolerance()


# --- randomized --------------------------------------------------------------------------------


class ColorRanges(Settings):
    """Ranges of a colour: hue, saturation and value of its sRGB encoding."""

    hue_deg: SpanOf[Annotated[float, Field(ge=0, le=360)]] = Field(
        default=(0.0, 360.0), description="The range of the hue in degrees: 0 is red, 120 is green."
    )
    saturation: ShareSpan = Field(
        default=(0.0, 1.0), description="The range of the saturation: 0 is grey."
    )
    value: ShareSpan = Field(
        default=(0.1, 0.9), description="The range of the strongest band's value in sRGB encoding."
    )


class SurfaceRanges(Settings):
    """Ranges of a surface's look: a plain colour, or a picture from a folder."""

    color: ColorRanges = ColorRanges()
    textures: Path | None = Field(
        default=None, description="A folder of PNG or JPEG pictures in sRGB."
    )
    textured_share: Share = Field(
        default=0.5,
        description="The share of scenes whose surface gets a picture, if a folder is given.",
    )
    texture_size_m: PositiveSpan = Field(
        default=(0.2, 1.0),
        description="The range of the length that a picture covers before it repeats, in "
        "metres, log-uniform.",
    )
    roughness: SpanOf[Roughness] = Field(
        default=(0.3, 1.0), description="The range of the roughness: 0.05 is polished, 1 is matt."
    )
    metal_share: Share = Field(
        default=0.0, description="The share of scenes in which the surface is bare metal."
    )


class BinRanges(SurfaceRanges):
    """Ranges of the bin's size, and of its look, which is the same inside and outside."""

    size_factor: SpanOf[Annotated[float, Field(ge=0.5, le=2)]] = Field(
        default=(1.0, 1.0),
        description="The range of the factor by which all three inner sizes are scaled, "
        "log-uniform.",
    )


class CameraRanges(Settings):
    """Ranges of the rig's deviation from its configured view, about the view's target."""

    distance_factor: SpanOf[Annotated[float, Field(ge=0.2, le=5)]] = Field(
        default=(0.9, 1.1),
        description="The range of the factor on the distance to the target, log-uniform.",
    )
    tilt_deg: SpanOf[Annotated[float, Field(ge=-80, le=80)]] = Field(
        default=(-10.0, 10.0),
        description="The range of the angle that is added to the view's tilt, in degrees.",
    )
    azimuth_deg: Angle = Field(
        default=(-180.0, 180.0),
        description="The range of the angle that is added to the view's azimuth, in degrees.",
    )
    roll_deg: Angle = Field(
        default=(0.0, 0.0),
        description="The range of the rotation about the viewing axis, in degrees.",
    )
    shift_m: Span = Field(
        default=(-0.02, 0.02),
        description="The range of the target's shift along each axis of the world, in metres.",
    )


class EnvironmentRanges(Settings):
    """Light from all around."""

    radiance: PositiveSpan = Field(
        default=(0.02, 0.4),
        description="The range of the radiance in W/(sr m^2), averaged over directions and "
        "bands, log-uniform.",
    )
    maps: Path | None = Field(
        default=None, description="A folder of latitude-longitude EXR or HDR pictures in any unit."
    )
    rotation_deg: Angle = Field(
        default=(-180.0, 180.0),
        description="The range of the rotation of a map about z, in degrees.",
    )
    color_temperature_k: Kelvins = Field(
        default=(2700.0, 7500.0),
        description="The range of the colour temperature in kelvins, if no maps are given.",
    )


class LampRanges(Settings):
    """Square lamps that replace the lamps of the cell and face the middle of the bin."""

    count: Counts = Field(default=(1, 3), description="The lowest and the highest number of lamps.")
    distance_m: PositiveSpan = Field(
        default=(1.0, 2.5),
        description="The range of a lamp's distance from the middle of the bin, in metres.",
    )
    elevation_deg: SpanOf[Annotated[float, Field(ge=5, le=90)]] = Field(
        default=(30.0, 80.0),
        description="The range of a lamp's angle above the horizon, in degrees. Directions "
        "are uniform over the solid angle.",
    )
    azimuth_deg: Angle = Field(
        default=(-180.0, 180.0),
        description="The range of a lamp's azimuth in degrees: 0 is the world's +x, 90 is its +y.",
    )
    size_m: PositiveSpan = Field(
        default=(0.1, 0.6),
        description="The range of the edge length of a lamp, in metres, log-uniform.",
    )
    irradiance: PositiveSpan = Field(
        default=(0.05, 1.0),
        description="The range of the irradiance of each band in W/m^2, on a surface at the "
        "bin that faces the lamp, log-uniform.",
    )
    color_temperature_k: Kelvins = Field(
        default=(2700.0, 6500.0),
        description="The range of the colour temperature of a lamp, in kelvins.",
    )


class PartRanges(Settings):
    """Ranges of each kind's look. All parts of a kind have the same look."""

    brightness: PositiveSpan = Field(
        default=(0.7, 1.4),
        description="The range of the factor on the reflectance, log-uniform. The result is "
        "at most 1.",
    )
    tint: PositiveSpan = Field(
        default=(0.9, 1.1),
        description="The range of one further factor for each band, also of textures, log-uniform.",
    )
    roughness: Span = Field(
        default=(-0.1, 0.1),
        description="The range of the change of the roughness. The result is at most 1, and at "
        "least 0.05 or the roughness of a smoother material.",
    )
    metallic: Span = Field(
        default=(0.0, 0.0),
        description="The range of the change of metallic. The result is limited to 0 to 1.",
    )
    repainted_share: Share = Field(
        default=0.0, description="The share of scenes in which a kind of part has a random colour."
    )
    color: ColorRanges = Field(
        default=ColorRanges(), description="The ranges of the colour of repainted parts."
    )


class DistractorRanges(Settings):
    """Foreign parts that lie among the cell's parts and partly hide them, without annotation."""

    count: Counts = Field(
        default=(0, 3),
        description="The lowest and the highest number of distractors. A scene has at most "
        "255 parts in all.",
    )
    parts: tuple[PartSection, ...] | None = Field(
        default=None,
        description="The kinds of distractors. Without this key, they are built-in metal "
        "parts that the cell does not use and that are small enough for its bin.",
    )


class RandomizedSection(Settings):
    """A different look in each scene. A section that is null keeps the cell's values."""

    kind: Literal["randomized"] = Field(description="The kind of the domain: randomized.")
    camera: CameraRanges | None = CameraRanges()
    environment: EnvironmentRanges | None = EnvironmentRanges()
    lamps: LampRanges | None = LampRanges()
    bin: BinRanges | None = BinRanges()
    table: SurfaceRanges | None = SurfaceRanges()
    parts: PartRanges | None = PartRanges()
    count_share: SpanOf[Annotated[float, Field(ge=0.01, le=1)]] = Field(
        default=(0.5, 1.0),
        description="The range of the share of the configured count of parts. It is rounded, "
        "with at least 1 part of each kind.",
    )
    distractors: DistractorRanges | None = DistractorRanges()


# --- either ------------------------------------------------------------------------------------


def _spelt_out(value: Any) -> Any:
    """Return the short form of a section as a mapping: "adapted" gives {"kind": "adapted"}.

    Pydantic then fills in the default values. Mappings with a known kind are returned unchanged.

    Raises:
        ValueError: the kind is not one of `KINDS`.
    """
    if isinstance(value, str):
        value = {"kind": value}
    if isinstance(value, dict) and value.get("kind") not in KINDS:
        raise ValueError(f"give {' or '.join(KINDS)}, or a mapping with one of them as its kind")
    return value


DomainSection = Annotated[
    Annotated[AdaptedSection | RandomizedSection, Field(discriminator="kind")],
    BeforeValidator(
        _spelt_out,
        json_schema_input_type=Literal["adapted", "randomized"]
        | AdaptedSection
        | RandomizedSection,
    ),
]
