"""A cell as a device, in the form of the Python classes of scanner makers.

Leaves out: the exposure of the colour picture, and the time in which a real device projects,
computes and transfers beyond exposures and read-out. No rig file states the rate of a projector or
a computing time; `claims.capture_s` of the shelf is a maker's time for a whole scan.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base import array_types as arrays
from ..base.errors import ArgumentError, ScannerError
from ..base.frames import inverse
from ..base.public_value import public_value
from ..base.streams import image_seeds
from ..camera.picture import gray_picture
from ..camera.rig_file import ScannerSections, SettingRange, setting_ranges, with_sections
from ..camera.scanner import Scanner, scan_seconds
from ..rendering import Renderer
from ..rig.former_names import current_name
from ..rig.pair import PRESETS
from ..world.scene import bin_of
from .config import Config, refuse_blind_code, resolve_scanner
from .resolve import Cell, load_cell, open_cell_renderer
from .scanner_device import ScannerFrame
from .simulate import SceneImage, cell_seeds, images_of, take_image, varied
from .views import hang
from .virtual_bin import VirtualBin

SETTABLE = ("code", "exposure", "decode", "filters")


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTruth:
    """The true parts of a frame: number, name and pose of each, and perfect maps of the frame.

    `instance` is the number of the part at each pixel, or -1.
    """

    number: arrays.IntArray_n
    part: tuple[str, ...]
    T_cam_part: arrays.FloatArray_n_4_4
    instance: arrays.IntArray_h_w
    depth_m: arrays.FloatArray_h_w

    def __post_init__(self) -> None:
        for array in (self.number, self.T_cam_part, self.instance, self.depth_m):
            array.flags.writeable = False


class VirtualScanner:
    """A scanner of a cell as a device: connect, change settings, trigger, receive frames.

    A scanner is also a context manager, which connects and disconnects it. The attributes are `bin`
    (the parts below it), `T_world_cam` (its pose, which a robot may change) and `cap` (whether the
    cap is on its lens). The same seed and the same calls give the same frames; the first frame
    equals scene 0 of `make_scene` with this seed.
    """

    def __init__(
        self,
        source: Cell | Config | Path | str,
        *,
        seed: int,
        name: str | None = None,
        bin: VirtualBin | None = None,
        device: str = "auto",
        readout_s: float = 0.010,
    ) -> None:
        """Mount a scanner over a new bin, or over the bin of another scanner.

        Args:
            source: a cell, its configuration or its YAML file; with `bin`, also the name of a rig,
                which looks at this bin as the bin's configuration states in `view`.
            seed: seed of a new bin and of the scanner's noise; give each scanner its own.
            name: name of the scanner if the cell has several; None is the first one.
            bin: the bin of another scanner; None makes a new one.
            device: render device, as in `open_renderer`.
            readout_s: the time to read out a picture; a cell with `motion` has its own times.

        Raises:
            GraycastError, ValueError: see `load_cell` and `VirtualBin`.
        """
        self._cell = _cell(source, bin)
        seeds = cell_seeds(self._cell, 0, seed=seed)
        first = {
            eye.sensor: (eye, scene)
            for eye, scene in images_of(self._cell, varied(self._cell, 0, seeds), seeds)
            if eye.image == 0
        }
        if name is not None and name not in first:
            known = ", ".join(filter(None, first)) or "a scanner without a name"
            raise ArgumentError(f"name is {name!r}: the cell has {known}")
        self._eye, scene = first[next(iter(first)) if name is None else name]
        self.T_world_cam, self.cap = scene.T_world_cam, False
        self.bin = VirtualBin(self._cell, seed=seed) if bin is None else bin
        self._seed, self._device, self._readout_s = seed, device, readout_s
        self._settings, self._changes = self._eye.scanner, dict[str, dict[str, Any]]()
        self._renderer: Renderer | None = None
        self._index, self._clock_s = 0, 0.0
        self._truth: FrameTruth | None = None

    # --- the connection -----------------------------------------------------------------------

    def connect(self) -> None:
        """Connect to the device; a second call has no effect.

        Raises:
            DeviceError: see `open_renderer`.
        """
        if self._renderer is None:
            self._renderer = open_cell_renderer(self._cell, device=self._device)

    def disconnect(self) -> None:
        """Disconnect the device, which keeps its settings; the bin is not changed."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None

    def __enter__(self) -> "VirtualScanner":
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.disconnect()

    def _connected(self) -> Renderer:
        if self._renderer is None:
            raise ScannerError(
                f"scanner {self._settings.rig.name} is not connected: call connect() first, or "
                "use the scanner in a with statement"
            )
        return self._renderer

    # --- settings -----------------------------------------------------------------------------

    @property
    def settings(self) -> Scanner:
        """The present settings, such as `settings.exposure.factors`.

        Raises:
            ScannerError: the scanner is not connected.
        """
        self._connected()
        return self._settings

    def setting_ranges(self) -> dict[str, SettingRange]:
        """Return each key that `set` accepts, with its present value and the allowed values.

        Raises:
            ScannerError: the scanner is not connected.
        """
        return setting_ranges(self.settings, SETTABLE)

    def set(self, key: str, value: Any) -> None:
        """Change a setting, such as `exposure.factors` to `[1, 4]`.

        Args:
            key: a key of the sections code, exposure, decode or filters of a rig file. A new
                `code.codec` removes all other changes of the code, which belong to the old one.
            value: the new value; None returns to the value of the rig.

        Raises:
            ConfigError: there is no such key, or the value is not in its range.
            ScannerError: the scanner is not connected.
        """
        self._connected()
        section, _, word = key.partition(".")
        if section not in SETTABLE:
            raise ArgumentError(
                f"{key} is no setting of the device: give a key of {', '.join(SETTABLE)}, such as "
                "exposure.factors"
            )
        before = {} if key == "code.codec" else self._changes.get(section, {})
        own = before | {word: value}
        changes = self._changes | {section: {k: v for k, v in own.items() if v is not None}}
        settings = with_sections(self._eye.scanner, ScannerSections(**changes))
        refuse_blind_code(settings)
        self._settings, self._changes = settings, changes

    # --- frames -------------------------------------------------------------------------------

    def trigger(self, *, wait: bool = False) -> ScannerFrame:
        """Take all pictures of a scan and return the frame.

        Args:
            wait: whether the call takes at least as long as the pictures of a real device.

        Raises:
            ScannerError: the scanner is not connected, its cap is on, or it is too dark to choose
                an exposure.
        """
        start_s = time.perf_counter()
        image = self._image(self._connected())
        capture, depth = image.capture, image.depth
        frame = ScannerFrame(
            index=self._index,
            time_s=self._clock_s,
            duration_s=self._duration_s(image),
            pictures=len(capture.frames) * len(capture.times_s),
            camera=depth.camera,
            depth_m=depth.depth_m,
            sigma_m=depth.sigma_m,
            p_wrong=depth.p_wrong,
            reason=depth.reason,
            gray=gray_picture(capture),
            rgb=image.rgb,
        )
        self._index, self._clock_s = self._index + 1, self._clock_s + frame.duration_s
        self._truth = self._truth_of(image)
        if wait:
            time.sleep(max(0.0, frame.duration_s - (time.perf_counter() - start_s)))
        return frame

    def truth(self) -> FrameTruth:
        """Return the true parts and maps of the last frame, which no real device knows.

        Raises:
            ScannerError: there is no frame yet.
        """
        if self._truth is None:
            raise ScannerError("the scanner has taken no frame yet: call trigger() first")
        return self._truth

    def _image(self, renderer: Renderer) -> SceneImage:
        rig = self._settings.rig
        if self.cap:
            raise ScannerError(f"no light reaches the camera of {rig.name}: take its cap off")
        scene = replace(self.bin.scene, rig=rig, T_world_cam=self.T_world_cam)
        seeds = image_seeds(self._seed, 0, station=self._eye.station, image=self._index)
        try:
            return take_image(
                self._cell.config, self._settings, scene, self.bin.layout, renderer,
                seeds=seeds, timings={},
            )  # fmt: skip
        except ValueError as error:
            raise ScannerError(f"scanner {rig.name} takes no picture: {error}") from error

    def _duration_s(self, image: SceneImage) -> float:
        if image.moving is not None:
            return float(image.moving.record["scan_s"])
        return scan_seconds(image.capture, readout_s=self._readout_s)

    def _truth_of(self, image: SceneImage) -> FrameTruth:
        numbers, layout, truth = self.bin.numbers, self.bin.layout, image.rendering.truth
        return FrameTruth(
            number=numbers,
            part=tuple(self.bin.scene.parts[kind].name for kind in layout.part_index),
            T_cam_part=inverse(self.T_world_cam) @ layout.T_world_part,
            instance=np.append(numbers, -1)[truth.instance],  # Index -1 means no part.
            depth_m=truth.depth_m,
        )


def _cell(source: Cell | Config | Path | str, bin: VirtualBin | None) -> Cell:
    """Return the cell of a scanner; a rig's name stands for the bin's cell with this rig."""
    if isinstance(source, Cell):
        return source
    if not isinstance(source, str) or current_name(source) not in PRESETS:
        return load_cell(source)
    if bin is None:
        raise ArgumentError(
            f"{source} is a rig without parts: give bin=scanner.bin of another scanner, or a "
            "configuration with parts"
        )
    plain = {name: field.default for name, field in ScannerSections.model_fields.items()}
    config = bin.cell.config.model_copy(
        update={**plain, "rig": source, "views": None, "scanners": None}
    )
    scanner, scene = resolve_scanner(config, Path()), bin.cell.scene
    pose = hang(config.view, scanner.rig, bin_of(scene))
    scene = replace(scene, rig=scanner.rig, T_world_cam=pose)
    return replace(bin.cell, config=config, scanner=scanner, scene=scene, named=(), own=())
