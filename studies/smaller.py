"""Cameras and projectors with fewer pixels, so that rendering takes less time."""

from dataclasses import replace

from graycast.rig.optics import Optics


def shrunk(optics: Optics, width_px: int, height_px: int) -> Optics:
    """Return a device with the same field of view and fewer pixels."""
    return replace(
        optics,
        width_px=width_px,
        height_px=height_px,
        fx_px=optics.fx_px * width_px / optics.width_px,
        fy_px=optics.fy_px * height_px / optics.height_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
    )
