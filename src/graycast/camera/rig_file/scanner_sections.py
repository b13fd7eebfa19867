"""The sections of a scanner that a rig file and a dataset's configuration share.

In a rig file an absent key has its default; in a configuration it keeps the value of the rig.
"""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any

from ...base.errors import ConfigError
from ...base.public_value import public_value, unit_of
from ...base.sections import changes_of, read_as
from ...base.settings import Settings, allowed_values
from ...base.streams import device_seed
from ...rig.pair import Rig
from ...rig.pattern import Code, CodeSpec
from ..decode import DecodeSpec, FilterSpec
from ..exposure import ExposureSpec
from ..faults import FaultSpec
from ..scanner import Scanner
from ..sensor import SensorSpec

_ABOUT = {
    CodeSpec: "The coded light.",
    ExposureSpec: "A fixed exposure time, the time that brings a percentile of the white frame to "
    "a target, or times that are chosen for the light in the bin.",
    SensorSpec: "The sensor in EMVA 1288 terms, and the f-number of its lens.",
    DecodeSpec: "The conditions under which a pixel is decoded.",
    FilterSpec: "The filters of the decoded depth; 0 switches a filter off.",
    FaultSpec: "Faults of the device that are added to the depth of simulated scans and never to "
    "that of real pictures; 0 switches a fault off.",
}

if TYPE_CHECKING:  # Editors then complete a section from the fields of its dataclass.
    CodeSection, ExposureSection, SensorSection = CodeSpec, ExposureSpec, SensorSpec
    DecodeSection, FilterSection, FaultSection = DecodeSpec, FilterSpec, FaultSpec
else:
    CodeSection, ExposureSection, SensorSection, DecodeSection, FilterSection, FaultSection = (
        changes_of(spec, spec.__name__.replace("Spec", "Section"), module=__name__, about=about)
        for spec, about in _ABOUT.items()
    )


class ScannerSections(Settings):
    """The sections that a rig file and a configuration share."""

    code: Annotated[Any, read_as(CodeSection)] = CodeSection()
    exposure: Annotated[Any, read_as(ExposureSection)] = ExposureSection()
    sensor: Annotated[Any, read_as(SensorSection)] = SensorSection()
    decode: Annotated[Any, read_as(DecodeSection)] = DecodeSection()
    filters: Annotated[Any, read_as(FilterSection)] = FilterSection()
    faults: Annotated[Any, read_as(FaultSection)] = FaultSection()


def with_sections(scanner: Scanner, sections: ScannerSections) -> Scanner:
    """Return a scanner with the changes that the sections state.

    Raises:
        ConfigError: a value does not fit the others; the message names the section.
    """
    parts = {name: getattr(scanner, name) for name in ScannerSections.model_fields}
    return _scanner(scanner.rig, parts, sections)


def own_device(scanner: Scanner, sections: ScannerSections, *, name: str) -> Scanner:
    """Return an additional scanner of a cell, whose name determines its fixed pattern and raster.

    A scanner keeps the `fpn_seed` that its section states. A scanner without fixed pattern and
    raster is not changed, so that datasets made by earlier versions can be continued.
    """
    sensor = scanner.sensor
    uneven = sensor.prnu or sensor.dsnu_e or scanner.faults.raster_px
    if not uneven or sections.sensor.fpn_seed is not None:
        return scanner
    seed = device_seed(sensor.fpn_seed, name)
    return replace(scanner, sensor=replace(sensor, fpn_seed=seed))


def scanner_of(rig: Rig, sections: ScannerSections) -> Scanner:
    """Return a scanner with this rig and default settings, changed by the sections.

    Raises:
        ConfigError: see `with_sections`.
    """
    defaults = {
        f.name: f.default_factory()
        for f in fields(Scanner)
        if f.default_factory is not MISSING  # Every field except the rig
    }
    return _scanner(rig, defaults, sections)


def _scanner(rig: Rig, parts: dict[str, Any], sections: ScannerSections) -> Scanner:
    changes: dict[str, Any] = {
        name: _changed(value, getattr(sections, name), name) for name, value in parts.items()
    }
    try:
        scanner = Scanner(rig=rig, **changes)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    try:  # A code that does not fit this projector is refused here and not by the first scan.
        scanner.light_code()
    except ValueError as error:
        raise ConfigError(f"code: {error}") from error
    return scanner


Spec = CodeSpec | Code | ExposureSpec | SensorSpec | DecodeSpec | FilterSpec | FaultSpec


def _changed(value: Spec, section: Settings, name: str) -> Spec:
    settings: dict[str, Any] = section.model_dump(exclude_none=True)
    if isinstance(value, CodeSpec) and settings.get("codec", value.codec) != value.codec:
        value = type(value)(codec=settings["codec"], axes=value.axes)  # Drop the old parameters.
    try:
        return replace(value, **settings)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SettingRange:
    """The present value of a setting, and the values that it may have.

    `allowed` states these values in words, and `schema` is their JSON Schema. A setting without a
    unit has an empty `unit`. `set(key, None)` is always allowed.
    """

    value: Any
    allowed: str
    schema: Mapping[str, Any]
    unit: str
    description: str


def setting_ranges(scanner: Scanner, names: Iterable[str]) -> dict[str, SettingRange]:
    """Return the settings of some sections of a scanner by their keys, such as `exposure.target`.

    A code has only the parameters of its codec, and a code of the user's own has no settings.
    """
    ranges = {}
    for name in names:
        spec = getattr(scanner, name)
        if isinstance(spec, Code):
            continue
        keys = type(ScannerSections.model_fields[name].default).model_json_schema()["properties"]
        for key, node in keys.items():
            if isinstance(spec, CodeSpec) and key not in ("codec", *spec.parameters):
                continue
            schema = node["anyOf"][0]  # The other choice is null, for the value of the rig.
            ranges[f"{name}.{key}"] = SettingRange(
                value=getattr(spec, key),
                allowed=allowed_values(schema),
                schema=schema,
                unit=unit_of(key),
                description=node["description"],
            )
    return ranges
