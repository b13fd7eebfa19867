"""Pictures of inputs and results."""

from .parts import describe_parts, draw_parts
from .preview import draw_preview
from .rig_picture import describe_rig, draw_rig
from .shelf_list import shelf_lines

__all__ = [
    "describe_parts",
    "describe_rig",
    "draw_parts",
    "draw_preview",
    "draw_rig",
    "shelf_lines",
]
