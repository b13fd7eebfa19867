"""The geometry of the scene, and all light sources except the projector."""

import math
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from blender import Nodes, place
from materials import GRAIN, Surface


class World:
    def __init__(self, scene: bpy.types.Scene, job: dict[str, Any], folder: Path):
        self.scene, self.folder = scene, folder
        self.surfaces = [Surface(words, folder) for words in job["materials"]]
        for words in job["meshes"]:
            self._meshes(words)
        for index, words in enumerate(job["spheres"]):
            self._sphere(index, words)
        self.sky = self._sky(job["environment"])

    def show(self, what: str, *, ambient: bool) -> None:
        """Show light, or show a quantity in place of all materials; see `Surface`."""
        for surface in self.surfaces:
            surface.show(what, glowing=ambient)
        self.scene.world = self.sky if ambient else None

    def _meshes(self, words: dict[str, Any]) -> None:
        """Add a mesh and all its copies, which share its data."""
        arrays = np.load(self.folder / words["file"])
        mesh = bpy.data.meshes.new(words["name"])
        corner, faces = arrays["vertices_m"], arrays["faces"]
        mesh.from_pydata(corner, [], faces.tolist())
        if "corner_uv" in arrays:
            layer = mesh.uv_layers.new(name="uv")
            layer.uv.foreach_set("vector", arrays["corner_uv"].astype(np.float32).ravel())
        smooth = "corner_normals" in arrays
        mesh.polygons.foreach_set("use_smooth", np.full(len(faces), smooth))
        if smooth:
            mesh.normals_split_custom_set(arrays["corner_normals"].reshape(-1, 3).tolist())
        if "corner_grain" in arrays:
            layer = mesh.attributes.new(GRAIN, "FLOAT_VECTOR", "CORNER")
            layer.data.foreach_set("vector", arrays["corner_grain"].ravel())
        mesh.materials.append(self.surfaces[words["material"]].material)
        mesh.update()
        for number, T in zip(words["instances"], arrays["T_world"], strict=True):
            body = bpy.data.objects.new(words["name"], mesh)
            body.pass_index = number
            place(body, T)
            self.scene.collection.objects.link(body)

    def _sphere(self, index: int, words: dict[str, Any]) -> None:
        """Add a sphere as a point of a point cloud, which Cycles traces as an exact sphere."""
        dot = bpy.data.meshes.new(f"sphere{index}")
        dot.from_pydata([(0.0, 0.0, 0.0)], [], [])
        body = bpy.data.objects.new(dot.name, dot)
        self.scene.collection.objects.link(body)
        bpy.context.view_layer.objects.active = body
        body.select_set(True)
        bpy.ops.object.convert(target="POINTCLOUD")  # Points cannot be added to an empty cloud.
        body.select_set(False)
        body.data.points[0].radius = words["radius_m"]
        body.data.materials.append(self.surfaces[words["material"]].material)
        body.location = words["center_m"]

    def _sky(self, words: dict[str, Any] | None) -> bpy.types.World | None:
        if words is None:
            return None
        sky = bpy.data.worlds.new("sky")
        sky.use_nodes = True
        nodes = Nodes(sky.node_tree)
        background = nodes.new("ShaderNodeBackground")
        color: object = (*words["radiance"], 1.0)
        if words["map_file"] is not None:
            image = _map(words["map_file"])
            share = 1 / _mean_radiance(image, words["map_file"]) if words["levelled"] else 1.0
            mapped = _mapped(nodes, image, words["rotation_rad"])
            factor = tuple(share * level for level in words["radiance"])
            color = nodes.vector("MULTIPLY", mapped, factor).outputs[0]
        nodes.put(background.inputs["Color"], color)
        out = nodes.new("ShaderNodeOutputWorld")
        nodes.put(out.inputs["Surface"], background.outputs[0])
        return sky


def _map(file: str) -> bpy.types.Image:
    image = bpy.data.images.load(file)
    if image.size[1] == 0:
        raise ValueError(
            f"environment map {file} cannot be read; give a latitude-longitude EXR or HDR picture"
        )
    return image


def _mean_radiance(image: bpy.types.Image, file: str) -> float:
    """Return the mean of a latitude-longitude map over solid angle and bands."""
    width, height = image.size
    pixels = np.empty(width * height * image.channels, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    rows = pixels.reshape(height, width, image.channels)[..., :3].mean(axis=(1, 2), dtype=float)
    border = np.cos(np.linspace(0, np.pi, height + 1))  # Rows have equal angles from pole to pole.
    mean = float((border[:-1] - border[1:]) / 2 @ rows)
    if not 0 < mean < math.inf:
        raise ValueError(
            f"environment map {file} has the mean radiance {mean}: remove values that are not "
            "finite, or give another map"
        )
    return mean


def _mapped(nodes: Nodes, image: bpy.types.Image, rotation_rad: float) -> bpy.types.NodeSocket:
    """Return the map's colour in a direction; its left border is at world +y before rotation."""
    way = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    # Near the poles, Cycles would interpolate between the first and the last row.
    slope = math.tan(math.pi / 2 / image.size[1])
    aside = nodes.vector("LENGTH", nodes.vector("MULTIPLY", way, (1.0, 1.0, 0.0)).outputs[0])
    widened = nodes.math("DIVIDE", slope, aside.outputs["Value"])
    split = nodes.new("ShaderNodeSeparateXYZ")
    nodes.put(split.inputs[0], way)
    widened = nodes.math("MAXIMUM", widened, 1.0)
    cosine, sine = math.cos(rotation_rad), math.sin(rotation_rad)
    x, y = split.outputs["X"], split.outputs["Y"]
    map_x = nodes.add(nodes.mul(x, cosine), nodes.mul(y, sine))
    map_y = nodes.add(nodes.mul(y, cosine), nodes.mul(x, -sine))
    turned = nodes.new("ShaderNodeCombineXYZ")  # In Cycles, the left border is at -x.
    nodes.put(turned.inputs["X"], nodes.mul(nodes.mul(map_y, -1.0), widened))
    nodes.put(turned.inputs["Y"], nodes.mul(map_x, widened))
    nodes.put(turned.inputs["Z"], split.outputs["Z"])
    texture = nodes.new("ShaderNodeTexEnvironment", image=image, interpolation="Linear")
    nodes.put(texture.inputs["Vector"], turned.outputs[0])
    return texture.outputs["Color"]
