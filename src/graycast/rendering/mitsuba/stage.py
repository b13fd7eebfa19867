"""Data that all light paths through a scene share: surfaces, camera, projector and patterns."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ...base.frames import inverse
from ...world.scene import Scene
from ..radiance import Quality
from .patterns import PackedPatterns, finest_patterns
from .projector import ProjectorLight
from .scene import MitsubaWorld
from .sight import Sight

ROULETTE_FROM = 2  # The number of vertices of a path before Russian roulette begins.
MAX_SURVIVAL = 0.95  # Below 1, so that paths between perfectly white surfaces end.


class Stage:
    """A scene under a stack of patterns, at one quality."""

    def __init__(self, world: MitsubaWorld, scene: Scene, pattern: np.ndarray, quality: Quality):
        rig = scene.rig
        self.world, self.quality = world.scene, quality
        self.sight = Sight(world.scene, glass=world.glass, thin=world.thin)
        self.camera, self.light = rig.camera, ProjectorLight(scene)
        self.R_world_cam = mi.Matrix3f(scene.T_world_cam[:3, :3])
        self.T_cam_world = mi.Matrix4f(inverse(scene.T_world_cam))
        self.eye = mi.Point3f(scene.T_world_cam[:3, 3])
        self.weights = mi.Color3f(rig.band_weights)
        self.context = mi.BSDFContext()
        self.patterns = PackedPatterns(pattern, rig)
        self.finest = finest_patterns(pattern, rig)
        self.strays = self.finest if quality.depth > 1 else {}
        self.pixels = rig.camera.width_px * rig.camera.height_px


def survival(throughput: mi.Color3f, playing: mi.Bool) -> mi.Float:
    """Return the probability with which a path continues: 1 without Russian roulette."""
    return dr.select(playing, dr.minimum(dr.max(throughput), MAX_SURVIVAL), 1.0)
