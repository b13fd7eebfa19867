"""One scene's finished products, as the dataset writers take them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ..decode import DepthMap
from ..render.radiance import GroundTruth
from ..scene import Layout, Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Everything about one scene that reaches the disk.

    `rgb` is the colour picture (8-bit sRGB), `gray` the measuring camera's white frame (8 bit),
    `scanner` what the structured-light camera measured. `manifest` is stored beside the images as
    it is; its `timings` are the only part that may differ between two equal runs.
    """

    scene: Scene
    layout: Layout
    truth: GroundTruth
    rgb: UInt8[np.ndarray, "h w 3"]
    gray: UInt8[np.ndarray, "h w"]
    scanner: DepthMap
    modulation: Float[np.ndarray, "h w"]
    manifest: Mapping[str, Any]

    def __post_init__(self) -> None:
        for array in (self.rgb, self.gray, self.modulation):
            array.flags.writeable = False
