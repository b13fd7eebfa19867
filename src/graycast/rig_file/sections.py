"""What may be said of a scanner in YAML, in a rig file and in a dataset's configuration alike.

A key that is left out is as it was: the default in a rig file, the rig's own in a configuration.
"""

from dataclasses import fields, replace
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from ..errors import ConfigError
from ..pattern import CODECS
from ..rig import Rig
from ..scanner import Scanner
from ..settings import Settings

Positive = Annotated[float, Field(gt=0)]
Level = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


def _unsaid(value: object) -> bool:
    """Keys that came later are left out of a dataset's claim, so that older datasets can go on."""
    return value is None


class CodeSection(Settings):
    """The coded light."""

    codec: Literal[CODECS] | None = Field(None, description="how positions are coded")
    axes: tuple[Literal["column", "row"], ...] | None = Field(
        None, description="what is coded; the axis along the baseline gives depth"
    )
    inverses: bool | None = Field(None, description="show each binary picture's inverse as well")
    period_px: Positive | None = Field(None, description="of phases and lines, projector pixels")
    steps: Annotated[int, Field(ge=3)] | None = Field(None, description="of each phase")
    base_bit: Annotated[int, Field(ge=0)] | None = Field(
        None, description="xor_gray: the bit that coarser ones are combined with"
    )


class ExposureSection(Settings):
    """A fixed time, or the one that brings a percentile of the white frame to a target."""

    exposure_s: Positive | None = None
    percentile: Annotated[float, Field(gt=0, le=100)] | None = None
    target: Annotated[float, Field(gt=0, le=1)] | None = None
    factors: tuple[Positive, ...] | None = Field(
        None, description="times taken, in shares of that one; several are merged (HDR)"
    )


class SensorSection(Settings):
    """The sensor in EMVA 1288 terms, and the stop of the lens before it."""

    pixel_pitch_m: Annotated[float, Field(gt=0, le=1e-3)] | None = None
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    wavelength_m: Annotated[float, Field(gt=0, le=1e-4)] | None = Field(
        None, description="of the light that is measured"
    )
    f_number: Positive | None = None
    lens_transmission: Annotated[float, Field(gt=0, le=1)] | None = None
    full_well_e: Positive | None = None
    read_noise_e: Level | None = None
    dark_current_e_s: Level | None = None
    gain_dn_per_e: Positive | None = None
    offset_dn: Level | None = None
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = None
    dsnu_e: Level | None = Field(None, description="fixed pattern of the offsets")
    prnu: Annotated[float, Field(ge=0, lt=0.25)] | None = Field(
        None, description="fixed pattern of the gains, a share"
    )
    fpn_seed: Annotated[int, Field(ge=0)] | None = Field(
        None, description="of both fixed patterns; they belong to the sensor"
    )


class DecodeSection(Settings):
    """What a pixel must show to be believed."""

    min_contrast: Annotated[float, Field(gt=0, lt=1)] | None = None
    min_sigmas: Level | None = Field(
        None,
        description="least contrast in standard deviations of the darkest frame's noise",
        exclude_if=_unsaid,
    )
    doubt: Annotated[float, Field(ge=0, lt=1)] | None = None
    fine_bits: Annotated[int, Field(ge=0)] | None = None
    max_epipolar_px: Level | None = Field(
        None, description="farther off its epipolar line a point is an outlier; 0: never"
    )


class FilterSection(Settings):
    """What is done to depth afterwards; 0 switches a filter off."""

    flying_angle_deg: Annotated[float, Field(ge=0, lt=90)] | None = Field(
        None, description="pixels between two surfaces go where a step is seen at more than this"
    )
    outlier_sigmas: Level | None = Field(
        None, description="pixels go that are this many standard deviations off their neighbours"
    )
    outlier_share: Level | None = Field(None, description="and farther than this share of depth")
    outlier_repair: bool | None = Field(
        None,
        description="an outlier within a surface gets its depth, and does not go",
        exclude_if=_unsaid,
    )
    hidden_sigmas: Level | None = Field(
        None,
        description="pixels go that a nearer surface hides from the projector by more noise",
        exclude_if=_unsaid,
    )
    island_px: Annotated[int, Field(ge=0)] | None = Field(
        None, description="surfaces of fewer pixels go"
    )
    smoothing_px: Annotated[float, Field(ge=0, le=10)] | None = Field(
        None, description="standard deviation of the smoothing kernel"
    )
    raster_px: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None,
        description="standard deviation of the place in its pixel that a depth is of",
        exclude_if=_unsaid,
    )
    step_angle_deg: Annotated[float, Field(gt=0, lt=90)] | None = Field(
        None, description="neighbours seen at more than this angle are two surfaces"
    )


class ScannerSections(Settings):
    """The sections that a rig file and a configuration share."""

    code: CodeSection = CodeSection()
    exposure: ExposureSection = ExposureSection()
    sensor: SensorSection = SensorSection()
    decode: DecodeSection = DecodeSection()
    filters: FilterSection = FilterSection()


def with_sections(scanner: Scanner, sections: ScannerSections) -> Scanner:
    """A scanner with what the sections change.

    Raises:
        ConfigError: a value that does not fit the others; the text names the section.
    """
    held = {name: getattr(scanner, name) for name in ScannerSections.model_fields}
    try:
        changed = replace(scanner, **_values(held, sections))
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _with_a_code(changed)


def scanner_of(rig: Rig, sections: ScannerSections) -> Scanner:
    """A scanner of defaults around a rig, with what the sections change.

    Raises:
        ConfigError: see `with_sections`.
    """
    defaults = {f.name: f.default_factory() for f in fields(Scanner) if f.name != "rig"}
    try:
        made = Scanner(rig=rig, **_values(defaults, sections))
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _with_a_code(made)


def _with_a_code(scanner: Scanner) -> Scanner:
    """Refuse numbers that make no code on this projector when they are read, not when it scans."""
    try:
        scanner.patterns()
    except ValueError as error:
        raise ConfigError(f"code: {error}") from error
    return scanner


def _values(held: dict[str, Any], sections: ScannerSections) -> dict[str, Any]:
    return {name: _changed(value, getattr(sections, name), name) for name, value in held.items()}


Value = TypeVar("Value")


def _changed(value: Value, section: Settings, name: str) -> Value:
    said: dict[str, Any] = section.model_dump(exclude_none=True)
    if name == "code" and said.get("codec", value.codec) != value.codec:
        value = type(value)(codec=said["codec"], axes=value.axes)  # the numbers were another's
    try:
        return replace(value, **said)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error
