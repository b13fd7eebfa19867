"""Pictures of inputs and results."""

from .parts import describe_parts, draw_parts
from .preview import draw_preview
from .rig_picture import describe_rig, draw_rig

__all__ = ["describe_parts", "describe_rig", "draw_parts", "draw_preview", "draw_rig"]
