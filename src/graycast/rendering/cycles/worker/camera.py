"""The camera: Blender's own if its lens model suffices, else an OSL shader with Graycast's lens."""

from pathlib import Path
from typing import Any

import _cycles
import bpy
from blender import place

SOURCE = Path(__file__).with_name("camera.osl")
SENSOR_MM = 36.0  # An arbitrary width, relative to which the focal length is given.


class CyclesCamera:
    def __init__(self, scene: bpy.types.Scene, job: dict[str, Any], folder: Path):
        self.data = bpy.data.cameras.new("camera")
        body = bpy.data.objects.new("camera", self.data)
        scene.collection.objects.link(body)
        scene.camera = body
        place(body, job["T_world_cam"], flipped=True)
        self.data.clip_start, self.data.clip_end = 1e-4, 1e4
        self.simple = job["camera"]["is_simple"]
        self.optics = job["camera"]
        self.shader = _compiled(folder)
        self.words = _words(job["camera"])

    def look(self, *, centre: bool) -> None:
        """Look through the lens, or along the pinhole rays of pixel centres."""
        wanted = "PERSP" if self.simple and not centre else "CUSTOM"
        if self.data.type != wanted:
            self.data.type = wanted  # This removes the shader.
            self.data.custom_bytecode, self.data.custom_bytecode_hash = self.shader, "camera"
        self._frame(centred=wanted == "CUSTOM")
        for name, value in (self.words | {"centre": int(centre)}).items():
            self.data.cycles_custom[name] = value
        self.data.update_tag()

    def _frame(self, *, centred: bool) -> None:
        """Set Blender's lens and shift; the shift must be 0 with the shader, which has its own."""
        optics, width, height = self.optics, self.optics["width_px"], self.optics["height_px"]
        self.data.sensor_fit, self.data.sensor_width = "HORIZONTAL", SENSOR_MM
        self.data.lens = optics["fx_px"] / width * SENSOR_MM
        self.data.shift_x = 0.0 if centred else ((width - 1) / 2 - optics["cx_px"]) / width
        self.data.shift_y = 0.0 if centred else (optics["cy_px"] - (height - 1) / 2) / width


def _compiled(folder: Path) -> str:
    file = folder / "camera.oso"
    if not _cycles.osl_compile(str(SOURCE), str(file)):
        raise RuntimeError(f"Open Shading Language does not compile {SOURCE.name}")
    return file.read_text()


def _words(optics: dict[str, Any]) -> dict[str, float]:
    """Return the lens shader's parameters."""
    words = {name: optics[name] for name in ("fx_px", "fy_px", "cx_px", "cy_px", "psf_px")}
    words |= dict(zip(("k1", "k2", "p1", "p2", "k3"), optics["distortion"], strict=True))
    words["sensed"] = optics["fill_factor"] ** 0.5
    words["pupil_m"] = optics["aperture_m"] / 2
    words["focus_m"] = -1.0 if optics["focus_m"] is None else optics["focus_m"]
    return {name: float(value) for name, value in words.items()}
