"""Rigs in files: Graycast's own YAML both ways, and OpenCV stereo calibrations in."""

from .opencv import import_opencv
from .own import load_rig, resolve_rig, rig_schema, save_rig

__all__ = ["import_opencv", "load_rig", "resolve_rig", "rig_schema", "save_rig"]
