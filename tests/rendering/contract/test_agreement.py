"""Each renderer is compared with the exact reference on one scene with all its features."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter
from stage import askew_rig, in_camera, lambert, leaning_wall, optics, wall

from graycast.rendering import Quality, open_renderer
from graycast.world.scene import EMPTY_LAYOUT, Sphere

DIRECT = Quality(samples=64, depth=1)


@pytest.mark.slow
def test_each_renderer_agrees_with_the_exact_renderer(path_tracer):
    """Oracle: another program, on a scene with shadows, borders, and distortion in both lenses.

    Inside surfaces both give the value at the pixel's centre, one by a regular grid and Mitsuba by
    mirrored pairs: a hundredth of the difference of neighbours is enough. At borders each may miss
    an eighth of a pixel's range (8 x 8 positions), and both together a quarter. Cycles' samples are
    random but evenly spread: their mean is within a twentieth of a pixel, and at a border it has a
    standard deviation of a sixteenth of the range.
    """
    lens, beam = (-0.2, 0.08, 0.003, -0.002, 0.0), (0.1, -0.03, -0.003, 0.004, 0.0)
    camera, projector = optics(96, 72, 90, distortion=lens), optics(33, 21, 24, distortion=beam)
    scene = in_camera(
        askew_rig(camera=camera, projector=projector),
        leaning_wall([0.2, -0.1, 1.0], 1.0, lambert(0.7, 0.5, 0.3)),
        Sphere(center_m=(-0.1, 0.05, 0.8), radius_m=0.12, material=lambert(0.9)),
        wall(0.7, lambert(0.2, 0.4, 0.6), half_m=0.06),
    )
    pattern = np.random.default_rng(5).integers(0, 256, (4, 21, 33)).astype(np.uint8)
    pattern[0] = 255
    exact, other = (
        one.render(scene, EMPTY_LAYOUT, pattern, quality=DIRECT, seed=2)
        for one in (open_renderer("reference"), path_tracer)
    )
    same = np.abs(exact.truth.depth_m - other.truth.depth_m) < 1e-5
    assert (~same).sum() <= 5  # centres on a border in float32
    a, b = exact.radiance.pattern, other.radiance.pattern
    assert np.abs(a - b).max() < 0.25 * a.max()
    depth = exact.truth.depth_m
    jump = np.abs(np.gradient(depth)).sum(axis=0) > 0.02
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (maximum_filter(a[0], 3) - minimum_filter(a[0], 3)) / a[0]  # relative to depth
        error = np.abs(a[0] / b[0] - 1)
    inside = ~jump & (slope < 0.3)
    assert inside.mean() > 0.7
    off_px = 0.01 if path_tracer.name == "mitsuba" else 0.05
    assert (error < 1e-4 + off_px * slope)[inside].all()
    assert np.abs(a.sum(axis=(1, 2)) / b.sum(axis=(1, 2)) - 1).max() < 2e-3
    assert np.abs(exact.radiance.albedo - other.radiance.albedo).mean() < 2e-3
