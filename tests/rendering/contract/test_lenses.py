"""Blur of both lenses, compared with closed forms of the thin lens."""

import math
from dataclasses import replace

import numpy as np
import pytest
from backends import slow
from edge_spread import (
    BLUR_M,
    NEAR_BY,
    ROWS,
    blurred,
    camera_spread,
    light_of,
    projector_spread,
    spread,
)
from stage import centred, in_camera, lambert, make_rig, plain_pattern, wall

from graycast.world.scene import Quad, Sphere


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "z_m"),
    [
        ("camera", 0.35), slow("camera", 0.5), slow("camera", 0.8), slow("camera", 1.5),
        slow("projector", 0.35), slow("projector", 0.5), slow("projector", 0.8), ("projector", 1.5),
    ],
)  # fmt: skip
def test_the_blur_of_an_edge_is_half_the_thin_lens_radius(path_tracer, device, z_m):
    """The line spread of a disc of radius R has the standard deviation R / 2. R follows from
    similar triangles: rays from the pupil's rim to a point at z cross the plane in focus, at f, at
    a distance of A |z - f| / z, where f / fx is a pixel.
    """
    focus_m, psf_px, f_px, samples = 0.5, 1.5, 300.0, 1024
    if path_tracer.name == "cycles":
        samples = 256
        if device == "projector":
            psf_px = 0.0  # The lens has no blur that is equal at all depths.
            if z_m == focus_m:
                pytest.skip("a projector in focus has no blur in Cycles")
    lens = blurred(centred(96, ROWS, f_px), focus_m, psf_px=psf_px)
    defocus_px = BLUR_M / 2 * abs(z_m - focus_m) / z_m / focus_m * f_px
    measure = camera_spread if device == "camera" else projector_spread
    deviation, error = measure(path_tracer, lens, z_m, samples=samples)
    expected = math.hypot(defocus_px, psf_px) / 2
    assert error < 0.01 * math.sqrt(1024 / samples) * expected
    assert abs(deviation - expected) < 4 * error + 0.003 * expected


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_a_tiny_pupil_gives_the_picture_of_a_pinhole(path_tracer, device):
    plain = make_rig(centred(48, 36, 60), centred(32, 24, 40), baseline_m=(0.1, 0.0, 0.0))
    lens = replace(getattr(plain, device), aperture_m=1e-7, focus_m=0.3)
    checker = (np.indices((24, 32)).sum(axis=0) % 2 * 255).astype(np.uint8)[None]
    ball = Sphere(center_m=(0.0, 0.05, 0.7), radius_m=0.1, material=lambert(0.6))
    images = [
        light_of(
            path_tracer, in_camera(rig, wall(0.9, lambert(0.5)), ball), checker, samples=64
        ).pattern[0]
        for rig in (plain, replace(plain, **{device: lens}))
    ]
    assert images[0].max() > 0.5
    differing = np.abs(images[0] - images[1]) > 1e-3 * images[0].max()
    assert differing.mean() < 0.01  # a ray in sixty on the other side of a border


@pytest.mark.slow
@pytest.mark.parametrize("picture", ["spot", "white"])
def test_defocus_conserves_light(path_tracer, picture):
    """A bright square, and the whole field with its borders, keep their sum of light on a wall."""
    psf_px, samples = (1.0, 256) if path_tracer.name == "mitsuba" else (0.0, 64)
    sharp = make_rig(centred(96, 96, 60), centred(32, 24, 40), baseline_m=NEAR_BY)
    soft = replace(
        sharp,
        camera=blurred(sharp.camera, 0.4, aperture_m=10e-3),
        projector=blurred(sharp.projector, 0.4, aperture_m=30e-3, psf_px=psf_px),
    )
    pattern = np.zeros((1, 24, 32), dtype=np.uint8)
    if picture == "spot":
        pattern[0, 8:14, 10:20] = 255
    else:
        pattern[:] = 255
    total = []
    for rig in (sharp, soft):
        scene = in_camera(rig, wall(1.0, lambert(0.8)))
        light = light_of(path_tracer, scene, pattern, samples=samples)
        if picture == "white" and path_tracer.name == "mitsuba":
            assert np.abs(light.pattern[0] - light.white).max() < 1e-5 * light.white.max()
        total.append(float(light.pattern[0].sum()))
    assert total[1] / total[0] == pytest.approx(1, abs=2e-3)


@pytest.mark.slow
def test_the_width_of_a_soft_shadow_follows_from_the_width_of_the_pupil(path_tracer):
    """Oracle: by similar triangles, the pupil's disc is (z2 - z1) / z1 as large on the wall."""
    z1, z2, f_px, aperture_m = 0.5, 0.8, 200.0, 30e-3
    camera = centred(120, ROWS, f_px)
    projector = blurred(centred(64, 64, 20), z2, aperture_m=aperture_m)
    rig = make_rig(camera, projector, baseline_m=(0.2, 0.0, 0.0))
    edge_m = 0.13  # in the camera frame; its shadow is next to its image
    screen = Quad(
        center_m=(edge_m + 1.0, 0.0, z1),
        half_u_m=(1.0, 0.0, 0.0),
        half_v_m=(0.0, -1.0, 0.0),
        material=lambert(0.0),
    )
    back = wall(z2, lambert(0.8))
    samples = 1024 if path_tracer.name == "mitsuba" else 256
    shadowed, whole = (
        light_of(
            path_tracer, in_camera(rig, *surfaces), plain_pattern(rig, 255), samples=samples
        ).white
        for surfaces in ((back, screen), (back,))
    )
    middle_m = 0.2 + (edge_m - 0.2) * z2 / z1
    middle_px = f_px * middle_m / z2 + 59.5
    lit = (shadowed / whole)[:, int(middle_px) - 20 : int(middle_px) + 20]
    deviation, error = spread(1 - lit)
    expected = aperture_m / 2 * (z2 - z1) / z1 * f_px / z2 / 2
    assert abs(deviation - expected) < 4 * error + 0.01 * expected
    assert error < 0.01 * math.sqrt(1024 / samples) * expected
