"""A cell without files, and a comparison of scenes value by value."""

from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from stage import box_part

from graycast.cell.config import Config
from graycast.cell.domain import resolve_domain
from graycast.rig.pair import place, preset_rig
from graycast.world.parts import Material
from graycast.world.scene import Bin, Environment, Lamp, Scene

TARGET_M, DISTANCE_M, TILT_RAD, AZIMUTH_RAD = (0.03, -0.02, 0.05), 0.8, 0.2, 0.5
HALF_M = np.array([0.02, 0.015, 0.01])


PAINT, STEEL = Material(base_color=(0.2, 0.3, 0.4)), Material(metallic=1.0)


def cell(materials=(PAINT, STEEL), **words):
    """Return a cell of two kinds of boxes in a bin under two lamps, with a tilted rig."""
    rig = preset_rig("paper")
    T_world_cam = place(
        rig,
        target_m=np.array(TARGET_M),
        distance_m=DISTANCE_M,
        tilt_rad=TILT_RAD,
        azimuth_rad=AZIMUTH_RAD,
    )
    parts = tuple(box_part(HALF_M, m, name=f"box{i}") for i, m in enumerate(materials))
    scene = {
        "rig": rig,
        "T_world_cam": T_world_cam,
        "parts": parts,
        "bin": Bin(inner_m=(0.4, 0.3, 0.15)),
        "environment": Environment(radiance=(0.2, 0.3, 0.1)),
        "lamps": (Lamp(center_m=(0.7, -0.5, 1.6)), Lamp(center_m=(-0.7, 0.5, 1.6), size_m=0.2)),
    }
    return Scene(**(scene | words))


def domain(scene, content, folder=Path()):
    """Return the domain of a configuration with this content under that key."""
    config = Config.model_validate({"parts": [{"builtin": "toothpaste"}], "domain": content})
    return resolve_domain(config.domain, folder, scene=scene)


def differences(a, b, where="scene"):
    """Return where two values differ in any bit; empty if they are equal."""
    if is_dataclass(a) and type(a) is type(b):
        pairs = [(getattr(a, f.name), getattr(b, f.name), f".{f.name}") for f in fields(a)]
    elif isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        pairs = [(x, y, f"[{i}]") for i, (x, y) in enumerate(zip(a, b, strict=True))]
    elif isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        same = a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        return [] if same else [where]
    elif isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return [where]
    else:
        return [] if a == b and repr(a) == repr(b) else [where]
    return [diff for x, y, name in pairs for diff in differences(x, y, where + name)]
