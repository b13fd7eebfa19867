"""The projector: a spot light whose emission looks up its picture by Graycast's lens model.

Cycles samples a point of the lens and evaluates the light from it towards the lit point. That ray
crosses the plane in focus at one point, and comes from the pixel whose image is there. This is a
thin lens with exact blur, even if half of the lens, and so half of the stripes, is hidden. A
pinhole is a lens with a single point.
"""

import math
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from blender import Nodes, number_image, place

SPREAD = 1.001  # The light cone is larger than the field's corner by this factor.


class Projector:
    def __init__(self, scene: bpy.types.Scene, job: dict[str, Any], folder: Path):
        self.optics = job["projector"]
        self.pattern = np.load(folder / "pattern.npy", mmap_mode="r")
        self.emission = np.array(job["emission"], dtype=np.float32)  # Light per grey level
        self.texture: bpy.types.Node | None = None
        light = bpy.data.lights.new("projector", "SPOT")
        light.energy = 4 * math.pi * job["intensity_w_sr"]  # In Blender, power for all directions
        light.spot_size = 2 * math.atan(SPREAD * job["field_tangent"])
        light.spot_blend = 0
        light.use_soft_falloff = True  # The lens is a disc and not a ball.
        light.shadow_soft_size = self.optics["aperture_m"] / 2
        light.cycles.use_multiple_importance_sampling = False  # No ray meets it by chance.
        self.body = bpy.data.objects.new("projector", light)
        self.body.visible_camera = False
        scene.collection.objects.link(self.body)
        place(self.body, job["T_world_proj"], flipped=True)
        self._emit(light, np.array(job["T_world_proj"]))

    def show(self, levels: list[int], bands: list[float]) -> None:
        """Show patterns by number, one for all bands or one for each; -1 is white.

        An empty list switches the light off. `bands` has the bands' shares of the light.
        """
        self.body.hide_render = not levels
        if not levels:
            return
        shares = [self._shares(number) for number in levels]
        # Cycles caches an image that it has read, so each frame needs a new one.
        before = self.texture.image
        picture = np.stack(shares * (3 // len(levels)), axis=-1) * np.float32(bands)
        self.texture.image = number_image("pattern", picture)
        if before is not None:
            bpy.data.images.remove(before)

    def _shares(self, number: int) -> np.ndarray:
        if number < 0:
            return np.ones(self.pattern.shape[1:], dtype=np.float32)
        return self.emission[self.pattern[number]]

    def _emit(self, light: bpy.types.Light, T: np.ndarray) -> None:
        light.use_nodes = True
        nodes = Nodes(light.node_tree)
        ray = nodes.new("ShaderNodeNewGeometry")
        way = [nodes.dot(ray.outputs["Incoming"], tuple(T[:3, i])) for i in range(3)]
        x, y = self._position(nodes, ray, way, T)
        x, y, inside = self._distorted(nodes, x, y)
        shine = nodes.mul(inside, nodes.math("GREATER_THAN", way[2], 0.0))
        column = nodes.fma(x, self.optics["fx_px"], self.optics["cx_px"])
        row = nodes.fma(y, self.optics["fy_px"], self.optics["cy_px"])
        if self.optics["fill_factor"] < 1:
            shine = nodes.mul(shine, self._on_square(nodes, column))
            shine = nodes.mul(shine, self._on_square(nodes, row))
        if self.optics["natural_vignetting"]:
            shine = nodes.mul(shine, way[2])
        if self.optics["falloff"]:
            shine = nodes.mul(shine, self._fallen_off(nodes, column, row))
        emission = nodes.new("ShaderNodeEmission")
        nodes.put(emission.inputs["Color"], self._lookup(nodes, column, row))
        nodes.put(emission.inputs["Strength"], shine)
        out = nodes.new("ShaderNodeOutputLight")
        nodes.put(out.inputs["Surface"], emission.outputs[0])

    def _fallen_off(self, nodes: Nodes, column: object, row: object) -> object:
        """Return the share of light that `falloff` leaves, by the law of `optics.corner_share`."""
        missing = 0.0
        for pixel, size_px in ((column, "width_px"), (row, "height_px")):
            size = self.optics[size_px]
            place = nodes.fma(pixel, 2 / size, 1 / size - 1)
            missing = nodes.fma(nodes.mul(place, place), self.optics["falloff"] / 2, missing)
        return nodes.math("SUBTRACT", 1.0, missing)

    def _position(self, nodes: Nodes, ray: bpy.types.Node, way: list, T: np.ndarray) -> tuple:
        """Return where the ray meets the plane of focus, in normalised coordinates."""
        focus_m = self.optics["focus_m"]
        slope = [nodes.math("DIVIDE", way[i], way[2]) for i in range(2)]
        if self.optics["aperture_m"] == 0 or focus_m is None:
            return tuple(slope)
        offset = nodes.vector("SUBTRACT", ray.outputs["Position"], tuple(T[:3, 3])).outputs[0]
        start = [nodes.dot(offset, tuple(T[:3, i])) for i in range(3)]
        ahead = nodes.math("SUBTRACT", focus_m, start[2])
        return tuple(nodes.mul(nodes.fma(slope[i], ahead, start[i]), 1 / focus_m) for i in range(2))

    def _distorted(self, nodes: Nodes, x: object, y: object) -> tuple:
        """Apply Brown-Conrady distortion; also return whether the model holds at the point."""
        k1, k2, p1, p2, k3 = self.optics["distortion"]
        if not any((k1, k2, p1, p2, k3)):
            return x, y, 1.0
        xx, yy, xy = nodes.mul(x, x), nodes.mul(y, y), nodes.mul(x, y)
        r2 = nodes.add(xx, yy)
        radial = nodes.fma(r2, nodes.fma(r2, nodes.fma(r2, k3, k2), k1), 1.0)
        aside = nodes.fma(xy, 2 * p1, nodes.mul(nodes.fma(xx, 2.0, r2), p2))
        down = nodes.fma(xy, 2 * p2, nodes.mul(nodes.fma(yy, 2.0, r2), p1))
        inside = nodes.math("LESS_THAN", r2, self.optics["fold_radius2"] or 1e6)
        return nodes.fma(x, radial, aside), nodes.fma(y, radial, down), inside

    def _on_square(self, nodes: Nodes, place_px: object) -> bpy.types.NodeSocket:
        off = nodes.math("SUBTRACT", place_px, nodes.math("ROUND", place_px))
        half = 0.5 * math.sqrt(self.optics["fill_factor"])
        return nodes.math("LESS_THAN", nodes.math("ABSOLUTE", off), half)

    def _lookup(self, nodes: Nodes, column: object, row: object) -> bpy.types.NodeSocket:
        """Return the level of the pixel at a position; 0 outside the picture."""
        width, height = self.optics["width_px"], self.optics["height_px"]
        uv = nodes.new("ShaderNodeCombineXYZ")
        nodes.put(uv.inputs["X"], nodes.fma(column, 1 / width, 0.5 / width))
        nodes.put(uv.inputs["Y"], nodes.fma(row, -1 / height, 1 - 0.5 / height))
        self.texture = nodes.new("ShaderNodeTexImage", interpolation="Closest", extension="CLIP")
        nodes.put(self.texture.inputs["Vector"], uv.outputs[0])
        return self.texture.outputs["Color"]
