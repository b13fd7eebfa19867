"""The parameters of a material as Cycles' nodes; see docs/explanation/light.md, "Materials"."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from blender import Nodes, number_image, texture_image

GRAIN = "grain"  # The attribute of a mesh with the direction of its grooves
NORMAL_OFFSET = 2.0  # This keeps emitted normals above 0.


class Surface:
    """One material with all quantities that it can show.

    'light' is the material itself; 'albedo', 'position', 'normal' (true normal + NORMAL_OFFSET) and
    'instance' are emitted as numbers by both sides.
    """

    def __init__(self, words: dict[str, Any], folder: Path):
        self.material = bpy.data.materials.new("surface")
        self.material.use_nodes = True
        self.folder = folder
        self.nodes = Nodes(self.material.node_tree)
        self.out = self.nodes.new("ShaderNodeOutputMaterial")
        self.geometry = self.nodes.new("ShaderNodeNewGeometry")
        base = self._base(words)
        self.glow = self._glow(words["radiance"])
        self.ways = {"light": self._light(words, base)} | self._quantities(base)
        # Set this only once, because Cycles ignores a change between the frames of a job.
        self.material.cycles.emission_sampling = "NONE" if self.glow is None else "FRONT"
        self.shown: tuple[str, bool] | None = None

    def show(self, what: str, *, glowing: bool) -> None:
        if (what, glowing) == self.shown:
            return
        self.shown = (what, glowing)
        self.nodes.put(self.out.inputs["Surface"], self.ways[what])
        if self.glow is not None:
            self.glow.inputs["Strength"].default_value = float(glowing)

    def _base(self, words: dict[str, Any]) -> object:
        if words["texture"] is None:
            return (*words["base_color"], 1.0)
        image = texture_image(self.folder / words["texture"])
        texture = self.nodes.new("ShaderNodeTexImage", image=image)
        return texture.outputs["Color"]

    def _glow(self, radiance: list[float] | None) -> bpy.types.Node | None:
        if radiance is None:
            return None
        node = self.nodes.new("ShaderNodeEmission")
        self.nodes.put(node.inputs["Color"], (*radiance, 1.0))
        return node

    def _light(self, words: dict[str, Any], base: object) -> bpy.types.NodeSocket:
        """Return a shader with the lamp's emission or the material in front, and a black back."""
        node = self.nodes.new("ShaderNodeMixShader")  # Without a link, the second shader is black.
        self.nodes.put(node.inputs[0], self.geometry.outputs["Backfacing"])
        front = self.glow.outputs[0] if self.glow else self._reflection(words, base)
        self.nodes.put(node.inputs[1], front)
        return node.outputs[0]

    def _reflection(self, words: dict[str, Any], base: object) -> bpy.types.NodeSocket:
        """Return a Principled shader; with an index of 1 it has no coat and is Lambertian."""
        node = self.nodes.new("ShaderNodeBsdfPrincipled", distribution="MULTI_GGX")
        for name, word in (("Metallic", "metallic"), ("Roughness", "roughness"), ("IOR", "ior")):
            node.inputs[name].default_value = words[word]
        self.nodes.put(node.inputs["Base Color"], base)
        if words["roughness_map"] is not None:
            image = number_image("roughness", np.load(self.folder / words["roughness_map"]))
            varied = self.nodes.new("ShaderNodeTexImage", image=image)
            self.nodes.put(node.inputs["Roughness"], varied.outputs["Color"])
        if words["anisotropy"] > 0:
            node.inputs["Anisotropic"].default_value = words["anisotropy"]
            self.nodes.put(node.inputs["Tangent"], self._across_grain())
        if words["diffuse"] > 0:
            return self._with_scattered(node, words, base)
        return node.outputs[0]

    def _with_scattered(
        self, node: bpy.types.Node, words: dict[str, Any], base: object
    ) -> bpy.types.NodeSocket:
        """Return a mix of a Principled shader and Lambertian scattering of a share of the light."""
        share = words["metallic"] * words["diffuse"]
        if share < 1:  # With less metal in the Principled shader, the mix has the right share.
            node.inputs["Metallic"].default_value = (words["metallic"] - share) / (1 - share)
        scattered = self.nodes.new("ShaderNodeBsdfDiffuse")
        self.nodes.put(scattered.inputs["Color"], base)
        mix = self.nodes.new("ShaderNodeMixShader")
        for place, value in enumerate((share, node.outputs[0], scattered.outputs[0])):
            self.nodes.put(mix.inputs[place], value)
        return mix.outputs[0]

    def _across_grain(self) -> bpy.types.NodeSocket:
        """Return the direction in which Cycles' facets are widest, in world coordinates."""
        own = self.nodes.new("ShaderNodeAttribute", attribute_name=GRAIN).outputs["Vector"]
        words = {"vector_type": "VECTOR", "convert_from": "OBJECT", "convert_to": "WORLD"}
        grain = self.nodes.new("ShaderNodeVectorTransform", **words)
        self.nodes.put(grain.inputs[0], own)
        normal = self.geometry.outputs["Normal"]
        return self.nodes.vector("CROSS_PRODUCT", normal, grain.outputs[0]).outputs[0]

    def _quantities(self, base: object) -> dict[str, bpy.types.NodeSocket]:
        lifted = self.nodes.vector(
            "ADD", self.geometry.outputs["True Normal"], (NORMAL_OFFSET,) * 3
        )
        info = self.nodes.new("ShaderNodeObjectInfo")
        sockets = {
            "albedo": base,
            "position": self.geometry.outputs["Position"],
            "normal": lifted.outputs[0],
            "instance": info.outputs["Object Index"],
        }
        return {name: self._emitted(value) for name, value in sockets.items()}

    def _emitted(self, value: object) -> bpy.types.NodeSocket:
        node = self.nodes.new("ShaderNodeEmission")
        self.nodes.put(node.inputs["Color"], value)
        return node.outputs[0]
