"""The controls of the page: their settings, their bounds, and the cost of a change."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from ...base.settings import setting_description
from ...camera.scanner import Scanner
from ...cell.config import Config
from ...cell.resolve import Cell
from ...rig.pair import PRESETS, RESOLUTIONS, standoff_m
from ...rig.pattern import CODECS
from ...world.parts import BUILTIN
from ...world.parts.material_section import material_words, resolve_material

Cost = Literal["free", "light", "physics"]
Number = float | int
MOST_PARTS = 6  # Other kinds of part can be changed only in the text.


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """A control of the page for one value.

    If `key` is only an item of a list or a part of a value, the page sends the value for `whole`.
    `grey`: one number sets three equal numbers. A control without bounds offers `choices`.
    """

    key: str
    label: str
    group: str
    cost: Cost
    low: Number | None = None
    high: Number | None = None
    step: Number | None = None  # step of the slider; None for steps of equal ratio
    unit: str = ""
    scale: float = 1.0  # The page shows the value multiplied by this factor.
    choices: tuple[Any, ...] = ()
    whole: str | None = None
    grey: bool = False


def described_controls(config: Config, scanner: Scanner) -> dict[str, Any]:
    """Return all controls of a configuration as JSON, with stated or default values.

    Each control has the description of its key, which the page shows as a tooltip. Files of parts
    and bins are not read. Therefore the page has its controls before the first picture, and also if
    the values permit no picture.
    """
    return {
        "controls": [_described(control) for control in _controls(config)],
        "values": _values(config, scanner),
    }


def values_of_files(cell: Cell) -> dict[str, Any]:
    """Return the values that a cell's files determine, unless the configuration states them."""
    config = cell.config
    values: dict[str, Any] = {"table": material_words(cell.scene.table, config.table)}
    for index, section in enumerate(config.parts[:MOST_PARTS]):
        material = cell.scene.parts[index].material
        values[f"parts.{index}.material"] = material_words(material, section.material)
    if (box := cell.scene.bin) is not None:
        values["bin.material"] = material_words(box.material, config.bin.material)
        values |= _bin_values(config, box.inner_m)
    return values


def _described(control: Control) -> dict[str, Any]:
    plain = Control(key="", label="", group="", cost="free")
    return {
        name: value
        for name, value in asdict(control).items()
        if name in ("key", "label", "group", "cost") or value != getattr(plain, name)
    } | {"about": setting_description(Config, control.key)}


def _controls(config: Config) -> Iterator[Control]:
    yield from _FREE
    yield from _RIG
    for index, part in enumerate(config.parts[:MOST_PARTS]):
        name = part.name or part.builtin or (part.mesh.stem if part.mesh else str(index))
        yield from _surface(f"parts.{index}.material", name)
        if part.builtin is not None:
            key = f"parts.{index}.builtin"
            yield _physics(key=key, label=f"{name}: another part", choices=BUILTIN)
    yield from _surface("bin.material", "bin")
    yield from _surface("table", "table")
    for index in range(len(config.light.lamps)):
        yield from _lamp(index)
    yield from _LIGHT
    yield from _PHYSICS


def _free(
    key: str,
    label: str,
    low: Number,
    high: Number,
    step: Number | None = None,
    *,
    unit: str = "",
    scale: float = 1.0,
) -> Control:
    group = {"exposure": "Exposure", "sensor": "Sensor", "decode": "Decoder", "filters": "Filters"}
    return Control(
        key=key, label=label, group=group[key.split(".")[0]], cost="free", low=low, high=high,
        step=step, unit=unit, scale=scale,
    )  # fmt: skip


_exposure = partial(Control, group="Exposure", cost="free")
_rig = partial(Control, group="Rig", cost="light")
_light = partial(Control, group="Light", cost="light")
_physics = partial(Control, group="Parts", cost="physics")
_FACTORS = ((1.0,), (1.0, 0.25), (1.0, 0.25, 0.0625), (1.0, 4.0))
_DEGREE = "\N{DEGREE SIGN}"
_RADIANCE = "W/(sr m\N{SUPERSCRIPT TWO})"

_FREE = (
    _free("exposure.target", "automatic: share of the range", 0.05, 1, 0.01),
    _free("exposure.exposure_s", "fixed time", 1e-4, 0.2, unit="ms", scale=1e3),
    _exposure(key="exposure.factors", label="exposures taken", choices=_FACTORS),
    _exposure(key="ambient", label="ambient light, times", low=0.02, high=50),
    _exposure(key="rig.power", label="projector's power, times", low=0.02, high=50),
    _free("sensor.read_noise_e", "read noise", 0, 60, 0.5, unit="e\N{MINUS SIGN}"),
    _free("sensor.bit_depth", "bit depth", 6, 16, 1, unit="bit"),
    _free("sensor.offset_dn", "dark level (offset)", 0, 1000, 1, unit="DN"),
    _free("sensor.gain_dn_per_e", "gain", 0.02, 4, unit="DN/e\N{MINUS SIGN}"),
    _free("sensor.full_well_e", "full well", 1000, 100_000, unit="e\N{MINUS SIGN}"),
    _free("sensor.quantum_efficiency", "quantum efficiency", 0.05, 1, 0.01),
    _free("sensor.dark_current_e_s", "dark current", 0, 2000, 1, unit="e\N{MINUS SIGN}/s"),
    _free("sensor.prnu", "pixels' gains differ by", 0, 0.1, 0.001),
    _free("sensor.dsnu_e", "pixels' offsets differ by", 0, 60, 0.5, unit="e\N{MINUS SIGN}"),
    _free("decode.max_p_wrong", "probability of wrong depth up to", 0.001, 1),
    _free("decode.min_contrast", "least contrast", 0.002, 0.5),
    _free("decode.doubt", "doubt", 0, 0.9, 0.01),
    _free("decode.fine_bits", "fine bits", 0, 8, 1),
    _free("decode.max_epipolar_px", "farthest off the epipolar line", 0, 5, 0.05, unit="px"),
    _free("filters.flying_angle_deg", "flying pixels from", 0, 89, 1, unit=_DEGREE),
    _free("filters.outlier_sigmas", "outliers from", 0, 12, 0.25, unit="\N{GREEK SMALL LETTER SIGMA}"),  # noqa: E501
    _free("filters.outlier_share", "and a share of depth", 0, 0.02, 0.0005),
    _free("filters.island_px", "islands up to", 0, 400, 5, unit="px"),
    _free("filters.smoothing_px", "smoothing", 0, 4, 0.05, unit="px"),
    _free("filters.step_angle_deg", "two surfaces from", 1, 89, 1, unit=_DEGREE),
)  # fmt: skip

_RIG = (
    _rig(key="view.distance_m", label="distance", low=0.15, high=4, unit="mm", scale=1e3),
    _rig(key="view.tilt_deg", label="tilt", low=0, high=80, step=0.5, unit=_DEGREE),
    _rig(key="view.azimuth_deg", label="azimuth", low=-180, high=180, step=1, unit=_DEGREE),
    *(
        _rig(
            key=f"view.target_m.{k}", label=f"looks at {axis}", low=-0.5, high=0.5, step=0.005,
            unit="mm", scale=1e3, whole="view.target_m",
        )
        for k, axis in enumerate("xyz")
    ),
    _rig(key="rig.toe_in_deg", label="toe-in, more by", low=-15, high=15, step=0.25, unit=_DEGREE),
    _rig(key="rig.baseline", label="baseline, times", low=0.2, high=3),
    _rig(key="rig", label="rig", choices=PRESETS),
    _rig(key="resolution", label="resolution", choices=RESOLUTIONS),
    _rig(key="code.codec", label="code", choices=CODECS),
)  # fmt: skip


def _surface(whole: str, name: str) -> Iterator[Control]:
    """Yield controls of a surface's physical properties; the grey value replaces a texture."""
    words = (("base_color", "grey", 0.0), ("metallic", "metallic", 0.0),
             ("roughness", "roughness", 0.05), ("specular", "specular", 0.0))  # fmt: skip
    for word, label, low in words:
        yield Control(
            key=f"{whole}.{word}", label=f"{name}: {label}", group="Surfaces", cost="light",
            low=low, high=1, step=0.01, whole=whole, grey=word == "base_color",
        )  # fmt: skip


def _lamp(index: int) -> Iterator[Control]:
    key, label = f"light.lamps.{index}", f"lamp {index}"
    length = partial(_light, whole="light.lamps", unit="mm", scale=1e3)
    for k, axis in enumerate("xyz"):
        place = f"{key}.center_m.{k}"
        yield length(key=place, label=f"{label}: {axis}", low=-2.5, high=2.5, step=0.05)
    yield length(key=f"{key}.size_m", label=f"{label}: side", low=0.02, high=2.0)
    yield _light(
        key=f"{key}.radiance", label=f"{label}: radiance", low=0.05, high=500.0, unit=_RADIANCE,
        grey=True, whole="light.lamps",
    )  # fmt: skip


_LIGHT = (
    _light(
        key="light.environment.radiance", label="from all around", low=0.002, high=50,
        unit=_RADIANCE, grey=True,
    ),
    _light(key="render.samples", label="samples", choices=(1, 4, 8, 16, 32, 64, 128, 256)),
    _light(key="render.depth", label="surfaces that a path meets", low=1, high=16, step=1),
)  # fmt: skip

_PHYSICS = (
    _physics(key="count", label="parts", low=0, high=255, step=1),
    _physics(key="seed", label="seed", low=0, high=999, step=1),
    *(
        _physics(
            key=f"bin.inner_m.{k}", label=f"bin: {word}", low=0.05, high=1.2, step=0.01, unit="mm",
            scale=1e3, whole="bin.inner_m",
        )
        for k, word in enumerate(("length", "width", "height"))
    ),
    _physics(key="bin.friction", label="bin: friction", low=0, high=1.5, step=0.05),
)  # fmt: skip


def _values(config: Config, scanner: Scanner) -> dict[str, Any]:
    """Return the values in use, whether or not the configuration states them."""
    values: dict[str, Any] = {}
    for section in ("exposure", "sensor", "decode", "filters"):
        for name, value in asdict(getattr(scanner, section)).items():
            values[f"{section}.{name}"] = value
    stated = {"bin.material": config.bin.material, "table": config.table}
    for index, part in enumerate(config.parts[:MOST_PARTS]):
        if part.builtin is None:  # The material of a built-in part is known only once it is loaded.
            stated[f"parts.{index}.material"] = part.material
        values[f"parts.{index}.builtin"] = part.builtin
    for key, surface in stated.items():
        if surface is not None:
            plain = surface.model_copy(update=dict.fromkeys(surface.files))
            values[key] = material_words(resolve_material(plain, Path()), surface)
    if config.bin.mesh is None:
        values |= _bin_values(config, config.bin.inner_m)
    if config.fill is None:
        low, high = config.count_range
        values["count"] = low if low == high else [low, high]
    light = config.light.model_dump(mode="json", exclude_none=True)
    view = config.view
    return values | {
        "view.distance_m": view.distance_m or standoff_m(scanner.rig),
        "view.tilt_deg": view.tilt_deg,
        "view.azimuth_deg": view.azimuth_deg,
        "bin.friction": config.bin.friction,
        "light.lamps": light["lamps"],
        "light.environment.radiance": light["environment"]["radiance"],
        "render.samples": config.render.samples,
        "render.depth": config.render.depth,
        "seed": config.seed,
        "code.codec": scanner.code.codec,
    }


def _bin_values(config: Config, inner_m: tuple[float, float, float]) -> dict[str, Any]:
    """Return the bin's inner size and the point at which the camera looks."""
    target_m = config.view.target_m or (0.0, 0.0, inner_m[2] / 3)
    return {"bin.inner_m": list(inner_m), "view.target_m": list(target_m)}
