"""Pictures of attempts: the camera picture with the chosen grip and the outcome."""

import cv2
import numpy as np
from jaxtyping import UInt8

from ...base.color import srgb_of_bytes
from ...base.frames import inverse, transform_points
from ...rig.optics import project
from .bin_scan import BinScan
from .outcome import TAKEN, Attempt

_GOOD, _BAD, _PART = (63, 158, 47), (200, 56, 90), (242, 177, 52)
AXIS_M = 0.05


def picture(scan: BinScan, attempt: Attempt) -> UInt8[np.ndarray, "h w 3"]:
    """The white frame with the part's outline, the tool's axis and the outcome (RGB)."""
    image = np.ascontiguousarray(np.repeat(srgb_of_bytes(scan.gray)[..., None], 3, axis=-1))
    ink = _GOOD if attempt.outcome in TAKEN else _BAD
    if attempt.part is not None:
        mask = (scan.instance == attempt.present.index(attempt.part)).astype(np.uint8)
        lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, lines, -1, _PART, 1, cv2.LINE_AA)
    if attempt.T_world_tool is not None:
        tip = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, AXIS_M]])
        world = transform_points(attempt.T_world_tool, tip)
        at = project(scan.view.camera, transform_points(inverse(scan.view.T_world_cam), world))
        (x, y), (u, v) = np.rint(at).astype(int).tolist()
        cv2.line(image, (x, y), (u, v), ink, 2, cv2.LINE_AA)
        cv2.circle(image, (x, y), 5, ink, 2, cv2.LINE_AA)
    _label(image, str(attempt.outcome))
    return image


def _label(image: UInt8[np.ndarray, "h w 3"], text: str) -> None:
    """Write white words on a dark ground, at the top left."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    (width_px, height_px), below_px = cv2.getTextSize(text, font, size, 1)
    corner = (width_px + 11, height_px + below_px + 7)
    cv2.rectangle(image, (0, 0), corner, (0, 0, 0), cv2.FILLED)
    cv2.putText(image, text, (6, height_px + 5), font, size, (255, 255, 255), 1, cv2.LINE_AA)
