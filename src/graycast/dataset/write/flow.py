"""Flow from the ground truth to each picture of a scan that moves, as 16-bit PNG files.

The files have the form of the KITTI benchmark (Menze & Geiger, "Object Scene Flow for Autonomous
Vehicles", CVPR 2015): red and green are the flow along x and y in steps of 1/64 px, plus 32768;
blue is 1 where the flow is known, and else all three are 0.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt16

from ...base.errors import DatasetError
from ..files.safe_reading import Unreadable, read_png
from ..files.scene_folder import of_sensor
from .picture_bytes import png

FLOW = "flow"
STEPS_PER_PX, ZERO, STEP_MAX = 64, 32768, 65535


def flow_files(
    flow_px: Float[np.ndarray, "p h w 2"], *, sensor: str, number: int
) -> Iterator[tuple[str, bytes]]:
    """Yield each picture's flow as (path in the scene's folder, content).

    Raises:
        DatasetError: a flow does not fit into 16 bits.
    """
    for k, flow in enumerate(flow_px):
        yield flow_name(k, sensor=sensor, number=number), png(_steps(flow))


def flow_name(picture: int, *, sensor: str, number: int) -> str:
    """Return the path of a picture's flow inside the scene's folder."""
    return f"{of_sensor(FLOW, sensor)}/{number:06d}_{picture:06d}.png"


def _steps(flow_px: Float[np.ndarray, "h w 2"]) -> UInt16[np.ndarray, "h w 3"]:
    known = np.isfinite(flow_px).all(axis=-1)
    steps = np.where(known[..., None], np.rint(flow_px * STEPS_PER_PX) + ZERO, 0)
    if steps.min() < 0 or steps.max() > STEP_MAX:
        longest_px = np.abs(flow_px[known]).max()
        raise DatasetError(
            f"a flow of {longest_px:.0f} px does not fit 16 bits, which end at "
            f"{ZERO // STEPS_PER_PX} px: lower the speed or the resolution, or remove motion.flow"
        )
    # OpenCV's order of channels is blue, green, red.
    return np.dstack([known, steps[..., 1], steps[..., 0]]).astype(np.uint16)


def read_flow(
    scene: Path, picture: int, *, sensor: str = "", number: int = 0
) -> Float32[np.ndarray, "h w 2"]:
    """Return how far each pixel's surface point is from this pixel in one picture [px].

    The flow is NaN where it is unknown.

    Args:
        picture: the number of the picture, over all exposures.

    Raises:
        Unreadable: the file is missing, damaged or no such PNG.
    """
    name = flow_name(picture, sensor=sensor, number=number)
    image = read_png(scene / name)
    if image.dtype != np.uint16 or image.ndim != 3 or image.shape[2] != 3:
        raise Unreadable(f"{name} is {image.shape} {image.dtype}, it must be uint16 in 3 channels")
    known: Bool[np.ndarray, "h w"] = image[..., 0] > 0
    flow_px = (image[..., 2:0:-1].astype(np.float32) - ZERO) / STEPS_PER_PX
    return np.where(known[..., None], flow_px, np.float32(np.nan))
