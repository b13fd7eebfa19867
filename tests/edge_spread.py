"""Measure how much the lenses of a renderer blur an edge."""

import math
from dataclasses import replace

import numpy as np
from stage import centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.rendering import Quality
from graycast.world.scene import EMPTY_LAYOUT, Quad

ROWS = 24
NEAR_BY = (1e-4, 0.0, 0.0)  # a baseline that gives no shadows and hardly any parallax
HALF_M = 0.5
BLUR_M = 20e-3  # diameter of a pupil that blurs by several pixels


def light_of(renderer, scene, pattern, *, samples=256, depth=1, seed=0):
    quality = Quality(samples=samples, depth=depth)
    rendering = renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)
    return rendering.radiance


def half_wall(z_m, material):
    """Return the half x > 0 of a wall that is perpendicular to the axis."""
    return Quad(
        center_m=(HALF_M, 0.0, z_m),
        half_u_m=(HALF_M, 0.0, 0.0),
        half_v_m=(0.0, -HALF_M, 0.0),
        material=material,
    )


def spread(edge):
    """Return standard deviation [px] and standard error of an edge's line spread along the rows.

    The edge is 0 to 1. The variance of two boxes (the pixel and the difference) is subtracted.
    """
    line = np.diff(edge, axis=1)
    assert np.abs(line.sum(axis=1) - 1).max() < 1e-3
    x = np.arange(line.shape[1])
    # The mean is common to all rows, because the mean of each row would absorb some of its noise.
    variance = (line * (x - (line.mean(axis=0) @ x)) ** 2).sum(axis=1) - 1 / 6
    error = variance.std(ddof=1) / math.sqrt(len(edge))
    deviation = math.sqrt(max(variance.mean(), 1e-12))
    return deviation, error / (2 * deviation)


def camera_spread(renderer, camera, z_m, *, samples):
    """Return the spread of the edge of a lit wall, as seen by a camera through its lens."""
    rig = make_rig(camera, centred(64, 64, 30), baseline_m=NEAR_BY)
    pattern = plain_pattern(rig, 255)
    edge, whole = (
        light_of(renderer, in_camera(rig, surface), pattern, samples=samples).white
        for surface in (half_wall(z_m, lambert(0.8)), wall(z_m, lambert(0.8)))
    )
    return spread(edge / whole)


def projector_spread(renderer, projector, z_m, *, samples, finer=2):
    """Return the spread of a projected edge; a pinhole sees each pixel as `finer` pixels."""
    camera = centred(finer * (projector.width_px - 10), ROWS, finer * projector.fx_px)
    rig = make_rig(camera, projector, baseline_m=NEAR_BY)
    pattern = plain_pattern(rig, 0)
    pattern[:, :, projector.width_px // 2 :] = 255
    light = light_of(renderer, in_camera(rig, wall(z_m, lambert(0.8))), pattern, samples=samples)
    deviation, error = spread(light.pattern[0] / light.white)
    return deviation / finer, error / finer


def blurred(optics, focus_m, *, aperture_m=BLUR_M, **words):
    return replace(optics, aperture_m=aperture_m, focus_m=focus_m, **words)
