"""The resolved cell of a robot, which all bins share and which worker processes receive."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....base import array_types as arrays
from ....base.errors import ConfigError
from ....base.frames import axis_rotation, rigid
from ....base.progress import UNWATCHED, ProgressMeter
from ....base.public_value import public_value
from ....cell.resolve import Cell, require_one_still_image, resolve_cell
from ....dataset.read.detections import WEIGHTS
from ....world.scene import Bin, bin_of
from ..arm.arms import ARMS
from .pick_sections import PickConfig


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class PickCell:
    """A robot's cell with its files read: the cell for drops and scans, and the configuration.

    `folder` is the folder that paths in the configuration are relative to.
    """

    cell: Cell
    config: PickConfig
    folder: Path

    @property
    def box(self) -> Bin:
        """The bin that is emptied."""
        return bin_of(self.cell.scene)

    @property
    def T_world_base(self) -> arrays.FloatArray_4_4:
        robot = self.config.robot
        turn = axis_rotation("z", np.radians(robot.base_yaw_deg))
        return rigid(turn, np.array(robot.base_m, dtype=np.float64))

    @property
    def file_digests(self) -> dict[str, str]:
        """SHA-256 of every file in the configuration, to detect files that changed."""
        named = {}  # The keys are the configured paths, so that the folder can be moved.
        if self.config.robot.arm not in ARMS:
            named[self.config.robot.arm] = self.folder / self.config.robot.arm
        if self.detector is not None:
            weights = self.detector / WEIGHTS if self.detector.is_dir() else self.detector
            named[self.config.picking.detector] = weights
        own = {
            name: hashlib.sha256(path.read_bytes()).hexdigest()
            for name, path in named.items()
            if path.is_file()  # A missing file causes an error later, which names it.
        }
        return self.cell.file_digests | own

    @property
    def detector(self) -> Path | None:
        """Path of a trained detector; None if the detector is truth or none."""
        named = self.config.picking.detector
        return None if named in ("truth", "none") else self.folder / named


def resolve_pick_cell(
    config: PickConfig, folder: Path, *, progress: ProgressMeter = UNWATCHED
) -> PickCell:
    """Read the files that a robot's cell names; their paths are relative to `folder`.

    Raises:
        GraycastError, ValueError: a file or a value cannot be used; the error names it.
    """
    cell = PickCell(
        cell=resolve_cell(config, folder, progress=progress), config=config, folder=folder
    )
    require_one_still_image(cell.cell, "graycast robot pick")
    if cell.detector is not None and not cell.detector.exists():
        raise ConfigError(
            f"picking.detector: no folder {cell.detector}: give a folder that graycast detector "
            "train wrote, or truth or none"
        )
    place_m = np.array(config.picking.place_m)
    half = cell.box.bounds_m
    if ((place_m[:2] > half[0, :2]) & (place_m[:2] < half[1, :2])).all():
        raise ConfigError(
            f"picking.place_m is {config.picking.place_m}, which is over the bin: give a place "
            "beside the bin"
        )
    return cell
