"""The YAML file of a design study: one cell, and the scanners and camera poses to compare."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, model_validator

from ...base.errors import ConfigError
from ...base.sections import read_as
from ...base.settings import Level, Positive, Settings, read_settings
from ...camera.rig_file.scanner_sections import CodeSection, ExposureSection
from ...cell.config import BinSection
from ...rig.former_names import RigName
from ...rig.pair import PRESETS
from ...rig.shelf import no_rig
from ...world.parts.material_section import MaterialSection

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9.-]+$")]  # It becomes a file name.
Code = Annotated[Settings, read_as(CodeSection)]
Exposure = Annotated[Settings, read_as(ExposureSection)]
Tilt = Annotated[float, Field(ge=0, le=80)]


class SweepSection(Settings):
    """A sweep: all combinations of its lists are compared; a missing key keeps the cell's value."""

    rig: tuple[RigName, ...] | None = Field(
        default=None, min_length=1, description="The rigs: names of presets, or rig files."
    )
    resolution: tuple[Literal["small", "low", "full"], ...] | None = Field(
        default=None, min_length=1, description="The resolutions of a preset's pictures."
    )
    baseline_m: tuple[Positive, ...] | None = Field(
        default=None,
        min_length=1,
        description="The distances between camera and projector in metres. Both are turned "
        "so that their optical axes meet at the target. Without this key, the "
        "rig keeps its own baseline and angle.",
    )
    distance_m: tuple[Positive, ...] | None = Field(
        default=None,
        min_length=1,
        description="The distances from the middle of the baseline to the target in metres.",
    )
    tilt_deg: tuple[Tilt, ...] | None = Field(
        default=None,
        min_length=1,
        description="The angles of the rig from the vertical in degrees.",
    )
    azimuth_deg: tuple[float, ...] | None = Field(
        default=None,
        min_length=1,
        description="The angles of the rig about the vertical in degrees.",
    )
    code: tuple[Name, ...] | None = Field(
        default=None, min_length=1, description="Names of entries in codes."
    )
    exposure: tuple[Name, ...] | None = Field(
        default=None, min_length=1, description="Names of entries in exposures."
    )
    bin: tuple[Name, ...] | None = Field(
        default=None, min_length=1, description="Names of entries in bins."
    )


class NeedsSection(Settings):
    """Limits that a setting must meet to be chosen."""

    sigma_m: Positive | None = Field(
        default=None, description="The largest standard deviation of depth, in metres."
    )
    feature_m: Positive | None = Field(
        default=None,
        description="The side, in metres, that the smallest visible cube may have at most.",
    )
    seconds: Positive | None = Field(
        default=None, description="The longest time of a scan, in seconds."
    )


class DesignSpec(Settings):
    """A design study, in which all settings of its sweeps scan the same heaps of parts.

    Relative paths refer to the folder of the study's file.
    """

    title: str = Field(default="Design study", description="The title of the table.")
    cell: Path = Field(description="The configuration of the cell: parts, bin, light, rendering.")
    layouts: int = Field(
        default=4,
        ge=1,
        le=1000,
        description="The number of heaps that each setting scans. All "
        "settings scan the same heaps.",
    )
    seed: int = Field(default=0, ge=0, description="The seed of the heaps and of the noise.")
    points: int = Field(
        default=20_000,
        ge=1000,
        le=1_000_000,
        description="The number of sample points on the surface of the parts of a heap.",
    )
    cone_deg: float = Field(
        default=30.0,
        ge=0,
        le=80,
        description="The open surface is the surface that is visible from a direction at "
        "most this angle from the vertical, in degrees.",
    )
    wrong_m: Positive = Field(
        default=0.005,
        description="The largest depth error in metres. Depth with a larger error "
        "counts as wrong, not as measured.",
    )
    readout_s: Level = Field(
        default=0.010,
        description="The time that the scanner needs to read out a frame, in seconds, "
        "in addition to the exposure.",
    )
    codes: dict[Name, Code] = Field(default={}, description="Codes by name.")
    exposures: dict[Name, Exposure] = Field(default={}, description="Exposures by name.")
    bins: dict[Name, BinSection] = Field(default={}, description="Bins by name.")
    sweeps: tuple[SweepSection, ...] = Field(
        min_length=1, description="The sweeps, whose settings together make up the study."
    )
    needs: NeedsSection = NeedsSection()

    @model_validator(mode="after")
    def _known_names(self) -> "DesignSpec":
        for key in ("code", "exposure", "bin"):
            known = getattr(self, f"{key}s")
            for name in (name for sweep in self.sweeps for name in getattr(sweep, key) or ()):
                if name not in known:
                    those = f"{key}s has {', '.join(known)}" if known else f"{key}s has none"
                    raise ValueError(
                        f"a sweep names the {key} {name!r}, but {those}: add it to {key}s"
                    )
        return self


def read_design(path: Path) -> DesignSpec:
    """Read and check the file of a design study; relative paths in it become absolute.

    Raises:
        ConfigError: the file is missing, has unknown, missing or wrong keys, or an unknown rig.
    """
    study = read_settings(path, DesignSpec)
    base = Path(os.path.normpath(path.parent.absolute()))

    def rig(name: str) -> str:
        if name in PRESETS:
            return name
        if not (base / name).is_file():
            raise ConfigError(f"{path}: sweeps: {no_rig(name, base)}")
        return str(_from(base, Path(name)))

    changes: dict[str, Any] = {
        "cell": _from(base, study.cell),
        "bins": {name: _bin_from(base, section) for name, section in study.bins.items()},
        "sweeps": tuple(
            sweep.model_copy(update={"rig": sweep.rig and tuple(map(rig, sweep.rig))})
            for sweep in study.sweeps
        ),
    }
    return study.model_copy(update=changes)


def _from(base: Path, path: Path) -> Path:
    return Path(os.path.normpath(base / path))


def _bin_from(base: Path, section: BinSection) -> BinSection:
    """Return a bin's section with absolute paths to its files."""
    changes: dict[str, Any] = {}
    if section.mesh is not None:
        changes["mesh"] = _from(base, section.mesh)
    surfaces: Mapping[str, MaterialSection | None] = {
        "material": section.material,
        "floor": section.floor,
    }
    for name, material in surfaces.items():
        if material is not None:
            files = {key: _from(base, path) for key, path in material.files.items()}
            changes[name] = material.model_copy(update=files)
    return section.model_copy(update=changes)
