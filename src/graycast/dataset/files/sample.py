"""The finished products of one image, as the dataset writers take them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...base import array_types as arrays
from ...base.public_value import public_value
from ...camera.decode import CodeMap, DepthMap
from ...camera.scanner import Scanner
from ...camera.sensor import Capture
from ...rendering.radiance import GroundTruth
from ...world.scene import Layout, Scene

LEAST_DECODED = 1e-3  # Wrong codes alone can give a smaller share of decoded pixels.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Raw:
    """Captured pictures, code maps and flow, if they are kept, and the scanner that made them."""

    scanner: Scanner
    capture: Capture | None = None
    codes: CodeMap | None = None
    flow_px: arrays.Float32Array_n_h_w_2 | None = None  # from the ground truth to each picture

    def __post_init__(self) -> None:
        camera, code = self.scanner.rig.camera, self.scanner.light_code()
        must = (len(code.frames), camera.height_px, camera.width_px)
        if self.capture is not None and self.capture.frames.shape != must:
            is_ = f"{self.capture.frames.shape} (frames, rows, columns)"
            raise ValueError(f"the captured stack is {is_}, code and camera make {must}")
        if self.codes is not None and self.codes.column.shape != must[1:]:
            raise ValueError(f"the code map is {self.codes.column.shape}, the camera {must[1:]}")
        if self.flow_px is not None and self.flow_px.shape[1:3] != must[1:]:
            raise ValueError(f"the flow is {self.flow_px.shape[1:3]}, the camera {must[1:]}")

    @property
    def code_maps(self) -> tuple[str, ...]:
        """Fields of `codes` for the code's axes: positions and their standard deviations."""
        return tuple(n for axis in self.scanner.code.axes for n in (axis, f"sigma_{axis}"))


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """All data of one image of a scene that are written to disk.

    All images of a scene have the same layout. `sensor` is the name of the scanner that took the
    image, or "" if the only scanner has no name; `image` is its number among that scanner's images.
    `scene` is the world with this scanner's rig at the image's viewpoint.

    `rgb` is the colour picture (8-bit sRGB), `gray` the measuring camera's white frame (8 bit), and
    `scanner_depth` the depth that the scanner measured. `manifest` is stored unchanged; only its
    `timings` may differ between equal runs. `raw` is None unless the configuration asks for it.
    """

    scene: Scene
    layout: Layout
    truth: GroundTruth
    rgb: arrays.UInt8Array_h_w_3
    gray: arrays.UInt8Array_h_w
    scanner_depth: DepthMap
    modulation: arrays.FloatArray_h_w
    manifest: Mapping[str, Any]
    raw: Raw | None = None
    sensor: str = ""
    image: int = 0

    def __post_init__(self) -> None:
        for array in (self.rgb, self.gray, self.modulation):
            array.flags.writeable = False


def labelled(sample: Sample) -> Sample:
    """Return a sample without the instances of parts that have no label, for annotations.

    These instances stay in depth and pictures, and pixels that they hide stay hidden.
    """
    scene, layout, truth = sample.scene, sample.layout, sample.truth
    has_label = np.array([part.labelled for part in scene.parts], dtype=bool)
    if has_label.all():
        return sample
    keep = has_label[layout.part_index]
    number = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1)  # -1 (no part) stays -1
    return replace(
        sample,
        scene=replace(scene, parts=tuple(part for part in scene.parts if part.labelled)),
        layout=replace(
            layout,
            T_world_part=layout.T_world_part[keep],
            part_index=layout.part_index[keep],
        ),
        truth=replace(
            truth,
            instance=number[truth.instance].astype(truth.instance.dtype),
            amodal=tuple(whole for whole, own in zip(truth.amodal, keep, strict=True) if own),
        ),
    )
