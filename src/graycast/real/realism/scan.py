"""A depth map from any source, with its camera and known properties."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, UInt8

JUMP_FOOTPRINTS = 10.0  # Slopes up to arctan(10) = 84 degrees count as one surface.


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthScan:
    """A depth map in the frame of its camera.

    Attributes:
        depth_m: z in the camera frame [m]; NaN without depth.
        K: pinhole intrinsics [px]; the centre of the top-left pixel is (0, 0). Distortion is
            left out: give undistorted maps, or accept errors at the picture's border.
        gray: brightness in the scanner's picture, from 0 to 1.
        reason: a number per pixel for the reason why depth is missing.
        reason_names: name of each reason; 0, or the name 'DECODED', means that there is depth.
        baseline_m: baseline of the rig, if known; tables show it next to the estimate.
    """

    name: str
    depth_m: Float[np.ndarray, "h w"]
    K: Float[np.ndarray, "3 3"]
    gray: Float[np.ndarray, "h w"] | None = None
    reason: UInt8[np.ndarray, "h w"] | None = None
    reason_names: Mapping[int, str] = field(default_factory=dict)
    baseline_m: float | None = None

    def __post_init__(self) -> None:
        for name, image in (("gray", self.gray), ("reason", self.reason)):
            if image is not None and image.shape != self.depth_m.shape:
                sizes = f"{image.shape}, depth is {self.depth_m.shape} (rows, columns)"
                raise ValueError(f"{self.name}: {name} is {sizes}: give pictures of the same scan")
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0 and np.isfinite(self.K).all()):
            raise ValueError(f"{self.name}: K has focal lengths {self.K[0, 0]}, {self.K[1, 1]} px")
        with np.errstate(invalid="ignore"):
            wrong = np.isinf(self.depth_m) | (self.depth_m <= 0)
        if wrong.any():
            raise ValueError(
                f"{self.name}: depth has a value of {self.depth_m[wrong][0]}: "
                "write NaN where there is none"
            )
        if self.gray is not None and not (self.gray.min() >= 0 and self.gray.max() <= 1):
            span = f"[{self.gray.min():.4g}, {self.gray.max():.4g}]"
            raise ValueError(
                f"{self.name}: gray spans {span}; give shares of the range, from 0 to 1"
            )
        for array in (self.depth_m, self.K, self.gray, self.reason):
            if array is not None:
                array.flags.writeable = False

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        return ~np.isnan(self.depth_m)

    @property
    def jump_share(self) -> float:
        """Least relative difference of depth between neighbours on two surfaces.

        It is `JUMP_FOOTPRINTS` / f, because a pixel on a facing surface is z / f wide.
        """
        return float(JUMP_FOOTPRINTS / np.sqrt(self.K[0, 0] * self.K[1, 1]))


def tiles(image: Float[np.ndarray, "h w"], side_px: int) -> Float[np.ndarray, "n s s"]:
    """Cut an image into squares, row by row; leave out incomplete squares at right and bottom."""
    rows, columns = (length // side_px for length in image.shape)
    cut = image[: rows * side_px, : columns * side_px]
    squares = cut.reshape(rows, side_px, columns, side_px).swapaxes(1, 2)
    return squares.reshape(-1, side_px, side_px)
