"""The settings of a design study, and the cell of each setting."""

from collections import Counter
from dataclasses import astuple, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError, GraycastError
from ...base.frames import inverse, transform_points
from ...base.progress import UNWATCHED, ProgressMeter
from ...cell.config import Config, load_config, resolve_bin, resolve_scanner
from ...cell.generate import described_scanner
from ...cell.resolve import Cell, file_digests, require_one_still_image, resolve_cell
from ...cell.views import hang
from ...dataset.write.claim import described_values
from ...rig.pair import PRESETS, Rig, aimed, standoff_m
from ...world.scene import bin_of
from .study import DesignSpec, SweepSection


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One combination of values in a sweep; a value of None means the cell's own value."""

    rig: str | None = None
    resolution: str | None = None
    baseline_m: float | None = None
    distance_m: float | None = None
    tilt_deg: float | None = None
    azimuth_deg: float | None = None
    code: str | None = None
    exposure: str | None = None
    bin: str | None = None

    @property
    def name(self) -> str:
        """Name of the setting's folder."""
        rig = self.rig if self.rig is None or self.rig in PRESETS else Path(self.rig).stem
        words = [rig, self.resolution]
        for value, form in (
            (self.baseline_m, "baseline{:g}m"),
            (self.distance_m, "{:g}m"),
            (self.tilt_deg, "tilt{:g}"),
            (self.azimuth_deg, "azimuth{:g}"),
        ):
            words.append(None if value is None else form.format(value))
        words += [self.code, self.exposure, self.bin]
        return "_".join(word for word in words if word) or "cell"

    @property
    def lit(self) -> "Setting":
        """The setting without code and exposure, which do not change the rendered light."""
        return replace(self, code=None, exposure=None)


def settings_of(spec: DesignSpec) -> tuple[Setting, ...]:
    """Return all settings of a study, in the order of its file.

    Raises:
        ConfigError: two settings have the same name.
    """
    settings = []
    for sweep in spec.sweeps:
        lists = {key: getattr(sweep, key) or (None,) for key in SweepSection.model_fields}
        combinations = product(*lists.values())
        settings += [Setting(**dict(zip(lists, one, strict=True))) for one in combinations]
    name, times = Counter(setting.name for setting in settings).most_common(1)[0]
    if times > 1:
        raise ConfigError(
            f"the setting {name} comes {times} times: remove it from one sweep, or rename a rig "
            "file"
        )
    return tuple(settings)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A setting, and the cell with the setting's rig, pose, code, exposure and bin."""

    setting: Setting
    cell: Cell

    def described(self, spec: DesignSpec) -> dict[str, Any]:
        """Return all values that the figures depend on, for JSON and to check earlier results.

        The number of layouts is excluded, because layouts can be added later.
        """
        cell = self.cell
        beside = {"cell", "title", "layouts", "codes", "exposures", "bins", "sweeps", "needs"}
        return {
            "study": spec.model_dump(mode="json", exclude=beside),
            "config": cell.config.model_dump(mode="json", exclude={"scenes", "seed"}),
            "files": cell.file_digests,
            "rig": described_values(cell.scene.rig),
            "scanner": described_scanner(cell.scanner),
            "T_world_cam": cell.scene.T_world_cam,
        }


def place_settings(
    spec: DesignSpec, settings: tuple[Setting, ...], *, progress: ProgressMeter = UNWATCHED
) -> tuple[Placed, ...]:
    """Return the possible settings of a study with their cells; report others to `progress`.

    Raises:
        ConfigError: the cell's file cannot be used, or no setting is possible; the error says why.
    """
    config = load_config(spec.cell)
    if config.domain is not None:
        raise ConfigError(
            f"{spec.cell}: domain varies the scenes, but a study compares settings on the same "
            "heaps: remove it"
        )
    try:
        base = resolve_cell(config, spec.cell.parent, progress=progress)
        require_one_still_image(base, "graycast rig design")
    except (GraycastError, ValueError, OSError) as error:
        raise ConfigError(f"{spec.cell}: {error}") from error
    placed, impossible = [], []
    for setting in settings:
        try:
            placed.append(Placed(setting=setting, cell=_cell(spec, base, setting)))
        except (GraycastError, ValueError, OSError) as error:
            impossible.append(f"the setting {setting.name}: {error}")
    if not placed:
        raise ConfigError(impossible[0])
    for why in impossible:
        progress.note(f"{why}; it is left out")
    return tuple(placed)


def _cell(spec: DesignSpec, base: Cell, setting: Setting) -> Cell:
    config, folder = _config(spec, base.config, setting), spec.cell.parent
    box = bin_of(base.scene) if setting.bin is None else resolve_bin(config.bin, folder)[0]
    scanner = resolve_scanner(config, folder)
    rig = scanner.rig
    if setting.baseline_m is not None:
        distance_m = config.view.distance_m or standoff_m(rig)
        rig = aimed(rig, baseline_m=setting.baseline_m, distance_m=distance_m)
        config = config.model_copy(
            update={"view": config.view.model_copy(update={"distance_m": distance_m})}
        )
    T_world_cam = hang(config.view, rig, box)
    _refuse_out_of_range(rig, T_world_cam, box.bounds_m)
    return replace(
        base,
        config=config,
        scene=replace(base.scene, rig=rig, T_world_cam=T_world_cam, bin=box),
        scanner=replace(scanner, rig=rig),
        file_digests=file_digests(config, folder),
    )


def _config(spec: DesignSpec, config: Config, setting: Setting) -> Config:
    keys = ("distance_m", "tilt_deg", "azimuth_deg")
    view = {key: getattr(setting, key) for key in keys if getattr(setting, key) is not None}
    if config.view.T_world_cam is not None and (view or setting.baseline_m is not None):
        view_key = next(iter(view), "baseline_m")
        raise ConfigError(
            f"the cell's view.T_world_cam is the whole pose: remove it there, or {view_key} here"
        )
    changes: dict[str, Any] = {"view": config.view.model_copy(update=view)}
    for key in ("rig", "resolution"):
        if (value := getattr(setting, key)) is not None:
            changes[key] = value
    for key in ("code", "exposure", "bin"):
        if (name := getattr(setting, key)) is not None:
            changes[key] = getattr(spec, f"{key}s")[name]
    return config.model_copy(update=changes)


def _refuse_out_of_range(
    rig: Rig, T_world_cam: Float[np.ndarray, "4 4"], bounds_m: Float[np.ndarray, "2 3"]
) -> None:
    """Raise ConfigError if the bin is completely outside the rig's working range."""
    corners = np.stack(np.meshgrid(*bounds_m.T), axis=-1).reshape(-1, 3)
    z_m = transform_points(inverse(T_world_cam), corners)[:, 2]
    if z_m.max() < rig.near_m or z_m.min() > rig.far_m:
        raise ConfigError(
            f"the bin lies {z_m.min():.3g} to {z_m.max():.3g} m from the camera, but the working "
            f"range of {rig.name} is {rig.near_m:g} to {rig.far_m:g} m: give another distance_m"
        )


def lights_of(placed: tuple[Placed, ...]) -> tuple[tuple[Placed, ...], ...]:
    """Return groups of settings that share a rendering: they differ only in code and exposure."""
    groups: dict[tuple[object, ...], list[Placed]] = {}
    for one in placed:
        groups.setdefault(astuple(one.setting.lit), []).append(one)
    return tuple(tuple(group) for group in groups.values())
