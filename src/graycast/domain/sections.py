"""What a user writes about a domain: the cell as it is, or drawn at random.

Ranges are [lowest, highest] and drawn uniformly between them, or as the key says.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from ..parts.part import Roughness
from ..parts.sections import PartSection
from ..settings import Level, PositiveSpan, Settings, Share, ShareSpan, Span, SpanOf

KINDS = ("adapted", "randomized")


Hue = SpanOf[Annotated[float, Field(ge=0, le=360)]]
RoughnessSpan = SpanOf[Roughness]
SizeFactor = SpanOf[Annotated[float, Field(ge=0.5, le=2)]]
DistanceFactor = SpanOf[Annotated[float, Field(ge=0.2, le=5)]]
Tilt = SpanOf[Annotated[float, Field(ge=-80, le=80)]]
Elevation = SpanOf[Annotated[float, Field(ge=5, le=90)]]
CountShare = SpanOf[Annotated[float, Field(ge=0.01, le=1)]]
Angle = SpanOf[Annotated[float, Field(ge=-360, le=360)]]
Kelvins = SpanOf[Annotated[float, Field(ge=1667, le=25000)]]
Counts = SpanOf[Annotated[int, Field(ge=0, le=255)]]

# --- adapted -----------------------------------------------------------------------------------


class CameraTolerance(Settings):
    """How the rig may hang otherwise than the view says."""

    position_m: Level = Field(1e-3, description="along each of the world's axes")
    rotation_deg: Level = Field(0.1, le=10, description="about each of the camera's axes")


class BinTolerance(Settings):
    """How the bin may stand otherwise than in the middle of the cell, flat on the table."""

    position_m: Level = Field(2e-3, description="along x and along y")
    rotation_deg: Level = Field(0.5, le=180, description="about z")


class LampTolerance(Settings):
    """How lamps and environment may differ from what the light says."""

    position_m: Level = Field(5e-3, description="of a lamp, along each axis")
    level: Share = Field(0.05, description="of each lamp's radiance, as a share of it")
    environment_level: Share = Field(0.05, description="of the environment's, as a share of it")


class PartTolerance(Settings):
    """How a batch of parts may look otherwise, all parts of a kind alike."""

    reflectance: Share = Field(0.03, description="of all bands together, as a share of it")
    roughness: Share = Field(0.02, description="added, within 0.05 to 1")


class AdaptedSection(Settings):
    """The cell as it is. A tolerance is the most by which a value is off, either way, uniformly."""

    kind: Literal["adapted"]
    camera: CameraTolerance = CameraTolerance()
    bin: BinTolerance = BinTolerance()
    lamps: LampTolerance = LampTolerance()
    parts: PartTolerance = PartTolerance()


# --- randomized --------------------------------------------------------------------------------


class ColorRanges(Settings):
    """A colour by hue, saturation and value of its sRGB encoding."""

    hue_deg: Hue = Field((0.0, 360.0), description="0 red, 120 green")
    saturation: ShareSpan = Field((0.0, 1.0), description="0 grey")
    value: ShareSpan = Field((0.1, 0.9), description="of the strongest band, sRGB encoded")


class SurfaceRanges(Settings):
    """A surface's look: plain, or a picture out of a folder."""

    color: ColorRanges = ColorRanges()
    textures: Path | None = Field(None, description="folder of PNG or JPEG pictures (sRGB)")
    textured_share: Share = Field(
        0.5, description="of the scenes that get a picture, where there is a folder"
    )
    texture_size_m: PositiveSpan = Field(
        (0.2, 1.0), description="that a picture covers before it repeats; log-uniform"
    )
    roughness: RoughnessSpan = Field((0.3, 1.0), description="0.05 polished to 1 matt")
    metal_share: Share = Field(0.0, description="of the scenes in which it is bare metal")


class BinRanges(SurfaceRanges):
    """The bin's look, inside and outside alike, and its size."""

    size_factor: SizeFactor = Field(
        (1.0, 1.0), description="of the inner size, one factor for all three; log-uniform"
    )


class CameraRanges(Settings):
    """How the rig moves from where the view has it, about the point that it looks at."""

    distance_factor: DistanceFactor = Field(
        (0.9, 1.1), description="of the distance to that point; log-uniform"
    )
    tilt_deg: Tilt = Field((-10.0, 10.0), description="added to the view's")
    azimuth_deg: Angle = Field((-180.0, 180.0), description="added to the view's")
    roll_deg: Angle = Field((0.0, 0.0), description="about the rig's own axis")
    shift_m: Span = Field((-0.02, 0.02), description="of the point, along each of the world's axes")


class EnvironmentRanges(Settings):
    """Light from all around."""

    radiance: PositiveSpan = Field(
        (0.02, 0.4), description="W/(sr m^2): mean of directions and bands; log-uniform"
    )
    maps: Path | None = Field(
        None, description="folder of latitude-longitude EXR or HDR pictures, in any unit"
    )
    rotation_deg: Angle = Field((-180.0, 180.0), description="of a map, about z")
    color_temperature_k: Kelvins = Field((2700.0, 7500.0), description="where there are no maps")


class LampRanges(Settings):
    """Square lamps that take the place of the cell's; they look at the middle of the bin."""

    count: Counts = Field((1, 3), description="lowest and highest number")
    distance_m: PositiveSpan = Field((1.0, 2.5), description="to the middle of the bin")
    elevation_deg: Elevation = Field(
        (30.0, 80.0), description="above the horizon; directions are uniform over solid angle"
    )
    azimuth_deg: Angle = Field((-180.0, 180.0), description="0 is the world's +x, 90 its +y")
    size_m: PositiveSpan = Field((0.1, 0.6), description="edge; log-uniform")
    irradiance: PositiveSpan = Field(
        (0.05, 1.0),
        description="W/m^2 per band on a surface at the bin that faces the lamp; log-uniform",
    )
    color_temperature_k: Kelvins = Field((2700.0, 6500.0))


class PartRanges(Settings):
    """The look of each kind of part, all parts of a kind alike."""

    brightness: PositiveSpan = Field(
        (0.7, 1.4), description="factor of the reflectance, at most to 1; log-uniform"
    )
    tint: PositiveSpan = Field(
        (0.9, 1.1), description="one more factor for each band, of textures too; log-uniform"
    )
    roughness: Span = Field((-0.1, 0.1), description="added, within 0.05 to 1")
    metallic: Span = Field((0.0, 0.0), description="added, within 0 to 1")
    repainted_share: Share = Field(
        0.0, description="of the scenes in which a kind has a random colour instead"
    )
    color: ColorRanges = Field(ColorRanges(), description="of repainted parts")


class DistractorRanges(Settings):
    """Foreign parts that lie among the others and hide them, and are in no annotation."""

    count: Counts = Field((0, 3), description="lowest and highest number; 255 with all others")
    parts: tuple[PartSection, ...] | None = Field(
        None,
        description="left out: built-in metal parts that are none of the cell's and small enough",
    )


class RandomizedSection(Settings):
    """Each scene otherwise. A section that is null leaves things as the cell has them."""

    kind: Literal["randomized"]
    camera: CameraRanges | None = CameraRanges()
    environment: EnvironmentRanges | None = EnvironmentRanges()
    lamps: LampRanges | None = LampRanges()
    bin: BinRanges | None = BinRanges()
    table: SurfaceRanges | None = SurfaceRanges()
    parts: PartRanges | None = PartRanges()
    count_share: CountShare = Field(
        (0.5, 1.0), description="of the parts that count says; rounded, at least 1 of each kind"
    )
    distractors: DistractorRanges | None = DistractorRanges()


# --- either ------------------------------------------------------------------------------------


def _spelt_out(value: Any) -> Any:
    """A plain word is that kind with all its defaults."""
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
