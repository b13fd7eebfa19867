"""Conversions to Blender: poses, images, shader nodes."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix


def place(body: bpy.types.Object, T_world: list[list[float]], *, flipped: bool = False) -> None:
    """Put an object at a pose; `flipped` is for camera and projector, which look along +z."""
    T = np.array(T_world)
    if flipped:
        T = T @ np.diag([1.0, -1.0, -1.0, 1.0])
    body.matrix_world = Matrix(T.tolist())


def number_image(name: str, picture: np.ndarray) -> bpy.types.Image:
    """Make a float image without a colour space from an array (h, w, 3), rows from the top."""
    height, width = picture.shape[:2]
    image = bpy.data.images.new(name, width, height, float_buffer=True, is_data=True)
    rgba = np.ones((height, width, 4), dtype=np.float32)
    rgba[..., :3] = picture
    image.pixels.foreach_set(rgba[::-1].ravel())
    return image


def texture_image(file: Path) -> bpy.types.Image:
    """Load a colour picture in sRGB."""
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "sRGB"
    return image


class Nodes:
    """A node tree that is built like formulas: functions of numbers and sockets return sockets."""

    def __init__(self, tree: bpy.types.NodeTree):
        self.tree = tree
        tree.nodes.clear()

    def new(self, kind: str, **properties: object) -> bpy.types.Node:
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        return node

    def put(self, socket: bpy.types.NodeSocket, value: object) -> None:
        """Set a socket to a value, or link the socket to the output of a node."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation: str, *values: object) -> bpy.types.NodeSocket:
        node = self.new("ShaderNodeMath", operation=operation)
        for socket, value in zip(node.inputs, values, strict=False):
            self.put(socket, value)
        return node.outputs[0]

    def add(self, a: object, b: object) -> bpy.types.NodeSocket:
        return self.math("ADD", a, b)

    def mul(self, a: object, b: object) -> bpy.types.NodeSocket:
        return self.math("MULTIPLY", a, b)

    def fma(self, a: object, b: object, c: object) -> bpy.types.NodeSocket:
        return self.math("MULTIPLY_ADD", a, b, c)

    def vector(self, operation: str, *values: object) -> bpy.types.Node:
        node = self.new("ShaderNodeVectorMath", operation=operation)
        for socket, value in zip(node.inputs, values, strict=False):
            self.put(socket, value)
        return node

    def dot(self, a: object, b: object) -> bpy.types.NodeSocket:
        return self.vector("DOT_PRODUCT", a, b).outputs["Value"]
