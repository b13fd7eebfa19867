"""The largest depth of a cell over all poses of rig and bin that its domain allows."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...base.frames import axis_rotation, inverse, rigid, transform_points
from ...world.scene import Scene, bin_of
from .domain_sections import AdaptedSection, RandomizedSection
from .vary import moved_rig

_AZIMUTHS = 37  # Over a whole turn, steps of 10 degrees miss up to 0.4 % of the bin's half size.


def deepest_m(section: AdaptedSection | RandomizedSection | None, scene: Scene) -> float:
    """Return the largest z [m], in the camera frame, that the bin's corners have in this domain."""
    corner_m = np.array(list(itertools.product(*bin_of(scene).bounds_m.T)))
    if isinstance(section, AdaptedSection):
        return _within_tolerances(section, scene, corner_m)
    if section is None or section.camera is None:
        poses, shift_m = [scene.T_world_cam], 0.0
    else:
        poses = list(_hung(section, scene))
        shift_m = max(map(abs, section.camera.shift_m)) * math.sqrt(3)
    if section is not None and section.bin is not None:
        corner_m = corner_m * section.bin.size_factor[1]
    return float(max(transform_points(inverse(T), corner_m)[:, 2].max() for T in poses)) + shift_m


def _hung(section: RandomizedSection, scene: Scene) -> Iterator[Float[np.ndarray, "4 4"]]:
    """Yield `T_world_cam` at the ends of the ranges: farthest, most tilted, at several azimuths."""
    camera = section.camera
    assert camera is not None
    for tilt_deg, roll_deg, azimuth_deg in itertools.product(
        {*camera.tilt_deg, float(np.clip(0.0, *camera.tilt_deg))},
        set(camera.roll_deg),
        np.linspace(*camera.azimuth_deg, _AZIMUTHS),
    ):
        values = {
            "distance_factor": camera.distance_factor[1],
            "tilt_rad": math.radians(tilt_deg),
            "azimuth_rad": math.radians(azimuth_deg),
            "roll_rad": math.radians(roll_deg),
            "shift_m": [0.0, 0.0, 0.0],
        }
        yield moved_rig(scene, values)


def _within_tolerances(
    section: AdaptedSection, scene: Scene, corner_m: Float[np.ndarray, "8 3"]
) -> float:
    rotation_deg = section.bin.rotation_deg
    turned = [
        transform_points(rigid(axis_rotation("z", math.radians(turn_deg)), np.zeros(3)), corner_m)
        for turn_deg in np.linspace(-rotation_deg, rotation_deg, _AZIMUTHS)
    ]
    in_cam_m = transform_points(inverse(scene.T_world_cam), np.concatenate(turned))
    aside_m = np.linalg.norm(in_cam_m[:, :2], axis=1).max()  # change of z per radian of tilt
    tilted_rad = math.radians(section.camera.rotation_deg) * math.sqrt(3)
    moved_m = section.camera.position_m * math.sqrt(3) + section.bin.position_m * math.sqrt(2)
    return float(in_cam_m[:, 2].max() + moved_m + tilted_rad * aside_m)
