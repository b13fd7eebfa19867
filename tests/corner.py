"""A corner of two walls with a box and a ball in it, to compare renderers."""

import numpy as np
from stage import (
    box_part,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    leaning_wall,
    make_rig,
    turned,
)

from graycast.base.frames import rigid
from graycast.world.parts import Material
from graycast.world.scene import Sphere

METAL = Material(base_color=(0.9, 0.8, 0.7), metallic=1.0, roughness=0.5)
COAT = Material(base_color=(0.6, 0.3, 0.2), roughness=0.4)


def corner_scene(*, metal=METAL, coat=COAT):
    """Return two walls that illuminate each other, with a metal box and a coated ball."""
    rig = make_rig(
        centred(48, 36, 52),
        centred(48, 36, 62),
        baseline_m=(0.15, 0.02, 0.01),
        rotation=turned(0.0, -0.15, 0.0),
        band_weights=(0.5, 0.3, 0.2),
    )
    pose = rigid(turned(0.4, 0.5, 0.1), np.array([-0.12, 0.02, 0.8]))
    return in_camera(
        rig,
        leaning_wall([0.8, 0.0, 1.0], 0.85, lambert(0.9, 0.8, 0.7)),
        leaning_wall([-0.8, 0.0, 1.0], 0.85, lambert(0.7, 0.8, 0.9)),
        Sphere(center_m=(0.1, 0.0, 0.85), radius_m=0.08, material=coat),
        parts=(box_part(0.06, metal),),
    ), layout_in_camera([0], [pose])
