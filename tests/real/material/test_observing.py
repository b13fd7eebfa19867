"""Observed light against Lambert's law: without distance and vignetting, it is the cosine."""

from dataclasses import replace

import numpy as np
import pytest
from stage import askew_rig, lambert, optics

from graycast.camera.decode import CodeMap, Levels, Mark, Reason
from graycast.real.material.observing import observe, observe_picture
from graycast.rendering import Quality
from graycast.rendering.reference import ReferenceRenderer
from graycast.world.scene import EMPTY_LAYOUT, Environment, Scene, Sphere

LEVELS = Levels(offset_dn=0.0, saturation_dn=4095.0, floor_dn2=1e-6, slope_dn=0.0)


def vignetted_rig():
    camera = replace(optics(160, 120, 200), natural_vignetting=True, falloff=0.3)
    projector = replace(optics(64, 48, 52), natural_vignetting=True, falloff=0.4)
    return askew_rig(camera=camera, projector=projector)


@pytest.fixture(scope="module")
def ball():
    """The rig, and the depth and white light of a matt ball by the exact renderer."""
    rig = vignetted_rig()
    scene = Scene(
        rig=rig,
        parts=(),
        bin=None,
        surfaces=(Sphere(center_m=(0.02, -0.01, 0.6), radius_m=0.15, material=lambert(0.8)),),
        environment=Environment(radiance=(0.0, 0.0, 0.0)),
        lamps=(),
        T_world_cam=np.eye(4),
    )
    white = np.full((1, rig.projector.height_px, rig.projector.width_px), 255, dtype=np.uint8)
    quality = Quality(samples=4, depth=1)
    rendering = ReferenceRenderer().render(scene, EMPTY_LAYOUT, white, quality=quality, seed=0)
    return rig, np.array(rendering.truth.depth_m), np.array(rendering.radiance.white)


def codes_of(depth_m, mark=None):
    reason = np.where(np.isfinite(depth_m), Reason.DECODED, Reason.SHADOW).astype(np.uint8)
    zero = np.zeros(depth_m.shape)
    maps = {name: zero.copy() for name in ("column", "row", "sigma_column", "sigma_row")}
    return CodeMap(**maps, modulation=zero.copy(), reason=reason, mark=mark)


def test_the_light_of_a_matt_ball_is_its_reflectance_times_the_cosine(ball):
    """Oracle: Lambert's law and the exact renderer, which shares no code with the division."""
    rig, depth_m, white = ball
    observed = observe(rig, codes_of(depth_m), depth_m, white, LEVELS)
    expected = 0.8 / np.pi * rig.intensity_w_sr * observed.light_cosine
    steep = observed.light_cosine > 0.5
    assert steep.sum() > 300
    ratio = observed.light[steep] / expected[steep]
    assert np.median(ratio) == pytest.approx(1, abs=0.01)
    assert np.abs(np.quantile(ratio, [0.05, 0.95]) - 1).max() < 0.06


def test_a_picture_alone_gives_the_observations_of_a_stack_without_indirect_light(ball):
    """The matt ball has no indirect light, so its white picture is its direct light."""
    rig, depth_m, white = ball
    inside = np.isfinite(depth_m)
    clipped = np.zeros(white.shape, dtype=bool)
    noise = np.full(white.shape, np.sqrt(2 * LEVELS.floor_dn2))
    own = observe_picture(rig, depth_m, white, noise, inside=inside, clipped=clipped)
    stack = observe(rig, codes_of(depth_m), depth_m, white, LEVELS)
    for name in ("normal", "light", "sigma", "pixel", "to_projector"):
        np.testing.assert_array_equal(getattr(own, name), getattr(stack, name))
    dark = observe_picture(rig, depth_m, 0 * white, noise, inside=inside, clipped=clipped)
    assert len(own) > 1000 and len(dark) == 0


def test_doubling_the_exposure_does_not_change_the_measured_light(ball):
    rig, depth_m, white = ball
    exposure = np.ones(white.shape)
    exposure[:, ::2] = 2
    one = observe(rig, codes_of(depth_m), depth_m, white, LEVELS)
    both = observe(rig, codes_of(depth_m), depth_m, white * exposure, LEVELS, exposure=exposure)
    assert np.allclose(both.light, one.light)


def test_a_clipped_pixel_is_distinguished_from_a_pixel_outside_the_mask(ball):
    rig, depth_m, white = ball
    mark = np.zeros(white.shape, dtype=np.uint8)
    mark[55:60, 75:85] = Mark.CLIPPED
    mask = np.zeros(white.shape, dtype=bool)
    mask[50:70, 70:90] = True
    observed = observe(rig, codes_of(depth_m, mark), depth_m, white, LEVELS, mask=mask)
    assert 0 < len(observed) <= 400
    assert observed.clipped.sum() == 50


def test_a_saturated_pixel_with_a_surface_counts_as_clipped(ball):
    rig, depth_m, white = ball
    reason = codes_of(depth_m).reason.copy()
    reason[55:60, 75:85] = Reason.SATURATED
    codes = replace(codes_of(depth_m), reason=reason)
    observed = observe(rig, codes, depth_m, white, LEVELS)
    assert observed.clipped.sum() == 50
    assert len(observed) == len(observe(rig, codes_of(depth_m), depth_m, white, LEVELS))
