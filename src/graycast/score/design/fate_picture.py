"""A picture of one setting's result: the white frame, and the fate of each point on it."""

import cv2
import numpy as np
from jaxtyping import UInt8

from ...base.color import srgb_of_bytes
from .heap_surface import HeapSurface, Visibility
from .point_fates import FATE_COLOR, FATES, Fate, PointFates, SurfaceView

_DIM = 0.5  # The white frame behind the colours is dimmer by this factor.
_LEGEND_PX = 168


def picture_png(
    gray: UInt8[np.ndarray, "h w"], view: SurfaceView, surface: HeapSurface, fates: PointFates
) -> bytes:
    """What the camera sees of the open surface, beside the white frame, as a PNG file.

    A point colours its pixel and the eight around it, what is not measured over what is.
    """
    gray, fate = srgb_of_bytes(gray), fates.fate
    visible = surface.opened & (view.camera == Visibility.VISIBLE)
    order = np.flatnonzero(visible)
    order = order[np.argsort(fate[order] != FATES.index(Fate.MEASURED), kind="stable")]
    ink = np.array([_rgb(FATE_COLOR[name]) for name in FATES], dtype=np.uint8)
    image = np.repeat((gray * _DIM).astype(np.uint8)[..., None], 3, axis=-1)
    for down in (-1, 0, 1):
        for aside in (-1, 0, 1):
            row = (view.row[order] + down).clip(0, gray.shape[0] - 1)
            column = (view.column[order] + aside).clip(0, gray.shape[1] - 1)
            image[row, column] = ink[fate[order]]
    white = np.repeat(gray[..., None], 3, axis=-1)
    whole = np.hstack([white, image, _legend(gray.shape[0], fate[order])])
    return cv2.imencode(".png", np.ascontiguousarray(whole[..., ::-1]))[1].tobytes()


def _legend(height_px: int, fate: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """The fates that occur, with their colours."""
    image = np.full((height_px, _LEGEND_PX, 3), 255, dtype=np.uint8)
    row = 20
    for number in np.unique(fate).tolist():
        name = FATES[number]
        cv2.rectangle(image, (8, row - 10), (20, row + 2), _rgb(FATE_COLOR[name]), -1)
        text = name.replace("_", " ")
        cv2.putText(
            image, text, (28, row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (31, 41, 51), 1, cv2.LINE_AA
        )
        row += 20
    return image


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
