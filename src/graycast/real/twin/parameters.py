"""Parameters of a scanner that are fitted because its user cannot know them.

To add a parameter, add a line to `PARAMETERS` with its key, its bounds and the scale of its range.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ...camera.scanner import Scanner
from ...rig.pattern import CodeSpec

# These keys do not belong to a scanner. Their values are factors on the bin's colour and gloss, and
# an addition to its roughness.
BIN_COLOR, BIN_GLOSS, BIN_ROUGHNESS = OF_BIN = (
    "bin.material.base_color",
    "bin.material.specular",
    "bin.material.roughness",
)
ROUGHER = 0.15  # largest change of the configured roughness, in both directions
FULL_WELL = "sensor.full_well_e"  # The gain changes with it: a full well keeps its digital number.


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One fitted number of a scanner, and its bounds.

    `key` is the key in the rig file, with dots; a number in brackets is the index in a list. Values
    below `off_below` switch a filter or fault off, and values above `off_above` remove a limit.
    `laser` is the fitted value for one laser scanner (a PhoXi) over one plastic bin. It is a start
    point for similar scanners, whose noise comes mainly from speckle on the surface: see
    docs/measurements/twin.md.
    """

    key: str
    low: float
    high: float
    laser: float
    walk: Literal["linear", "log"] = "linear"
    off_below: float | None = None
    off_above: float | None = None

    def value(self, share: float) -> float:
        """Return the value at a position from 0 (low) to 1 (high) of the range."""
        share = min(max(share, 0.0), 1.0)
        if self.walk == "log":
            value = math.exp(math.log(self.low) + share * math.log(self.high / self.low))
        else:
            value = self.low + share * (self.high - self.low)
        return float(f"{value:.4g}")

    def share(self, value: float) -> float:
        """Return the position of a value in the range, from 0 (low) to 1 (high), clipped."""
        value = min(max(value, self.low), self.high)
        if self.walk == "log":
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


PARAMETERS: tuple[Parameter, ...] = (
    Parameter(key="exposure.target", low=0.1, high=1.0, laser=0.9, walk="log"),
    Parameter(key="exposure.factors[1]", low=1.5, high=60.0, laser=15.0, walk="log"),
    Parameter(key=FULL_WELL, low=5e3, high=2e5, laser=7.4e4, walk="log"),
    Parameter(key="sensor.read_noise_e", low=1.0, high=80.0, laser=23.0, walk="log"),
    Parameter(key="projector.falloff", low=0.0, high=0.9, laser=0.51, off_below=0.01),
    Parameter(key="speckle_contrast", low=0.0, high=1.0, laser=0.36),
    Parameter(key="speckle_volume", low=0.2, high=50.0, laser=3.6, walk="log"),
    Parameter(key="speckle_unevenness", low=0.0, high=0.8, laser=0.66),
    Parameter(key="line_noise", low=0.0, high=0.05, laser=0.005),
    Parameter(key="decode.min_sigmas", low=3.0, high=150.0, laser=135.0, walk="log"),
    Parameter(key="filters.smoothing_px", low=0.0, high=0.7, laser=0.0, off_below=0.25),
    Parameter(key="faults.raster_px", low=0.0, high=0.6, laser=0.52, off_below=0.02),
    Parameter(
        key="faults.raster_limit_m", low=5e-5, high=2e-3, laser=2.7e-4, walk="log", off_above=1e-3
    ),
    Parameter(key="faults.raster_line_unevenness", low=0.0, high=0.8, laser=0.31, off_below=0.01),
    Parameter(key=BIN_COLOR, low=0.1, high=3.0, laser=0.78, walk="log"),
    Parameter(key=BIN_GLOSS, low=0.25, high=2.0, laser=0.4, walk="log"),
    Parameter(key=BIN_ROUGHNESS, low=-ROUGHER, high=ROUGHER, laser=0.14),
)


def candidate_codes(code: CodeSpec) -> tuple[CodeSpec, ...]:
    """Return the configured code and finer codes, because depth maps do not reveal the code."""
    if code.codec != "gray_phase":
        return (code,)
    own = code.period_px or math.inf
    finer = [p for p in (24.0, 12.0) if p < own]
    return (code, *(replace(code, period_px=p, fine_period_px=None) for p in finer))


def with_values(
    scanner: Scanner, parameters: Sequence[Parameter], values: Mapping[str, float]
) -> Scanner:
    """Return the scanner with new values of the parameters; keys of the bin are ignored."""
    for parameter in parameters:
        if parameter.key not in OF_BIN:
            value: Any = values[parameter.key]
            below, above = parameter.off_below, parameter.off_above
            if (below is not None and value < below) or (above is not None and value > above):
                value = None
            if parameter.key == FULL_WELL:
                gain = scanner.sensor.gain_dn_per_e * scanner.sensor.full_well_e / value
                scanner = _replaced(scanner, ["sensor", "gain_dn_per_e"], float(f"{gain:.4g}"))
            scanner = _replaced(scanner, _path(parameter.key), value)
    return scanner


def value_of(scanner: Scanner, parameter: Parameter) -> float:
    """Return the scanner's value of a parameter; if it is None, the bound that switches it off."""
    if parameter.key in OF_BIN:
        return 0.0 if parameter.key == BIN_ROUGHNESS else 1.0
    value: Any = scanner
    for name in _path(parameter.key):
        if name.isdigit():
            value = value[int(name)] if int(name) < len(value) else None
        else:
            value = getattr(value, name)
        if value is None:
            return parameter.low if parameter.off_above is None else parameter.high
    return float(value)


def shares_of(scanner: Scanner, parameters: Sequence[Parameter]) -> Float[np.ndarray, " n"]:
    """Return the scanner's values as positions from 0 (low) to 1 (high) between their bounds."""
    return np.array([p.share(value_of(scanner, p)) for p in parameters])


def values_at(shares: Float[np.ndarray, " n"], parameters: Sequence[Parameter]) -> dict[str, float]:
    return {p.key: p.value(float(s)) for p, s in zip(parameters, shares, strict=True)}


def _path(key: str) -> list[str]:
    """Return the attribute path of a key; keys at the top of a rig file may belong to the rig."""
    path = re.findall(r"\w+", key)
    return path if hasattr(Scanner, path[0]) else ["rig", *path]


def _replaced(owner: Any, path: Sequence[str], value: Any) -> Any:
    name, *rest = path
    if name.isdigit():
        items = [*owner, *[0.0] * (int(name) + 1 - len(owner))]
        items[int(name)] = value
        return tuple(items)
    return replace(owner, **{name: _replaced(getattr(owner, name), rest, value) if rest else value})
