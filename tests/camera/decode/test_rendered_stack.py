"""From rendered pictures to depth, with both lenses distorted."""

import cv2
import numpy as np
import pytest
from lenses import BEAM, LENS, opencv_rays
from stage import in_camera, lambert, leaning_wall, make_rig, optics, turned

from graycast.camera.decode import DecodeSpec, Reason, decode, levels_of, triangulate
from graycast.camera.sensor import SensorSpec
from graycast.rendering import Quality
from graycast.rig.pattern import gray
from graycast.world.scene import EMPTY_LAYOUT, Sphere

SENSOR = SensorSpec(offset_dn=0.0, gain_dn_per_e=0.1, full_well_e=1e6, bit_depth=12)


def noiseless(radiance, sensor):
    """Return a perfect converter: the brightest value is at 90 % of the range."""
    scale = 0.9 * sensor.max_dn / radiance.max()
    return np.rint(radiance * scale).astype(np.uint16)


@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("inverses", [False, True])
def test_a_rendered_plane_and_a_sphere_are_decoded_to_half_a_column(
    mitsuba_renderer, vertical, inverses
):
    """All is lit. The true point, projected by OpenCV, is within half a column of the decoded one,
    and the error of depth is at most that of half a column.
    """
    camera = optics(120, 90, 130, distortion=LENS)
    projector = optics(48, 40, 50, distortion=BEAM)
    rotation = turned(-0.2, 0.0, 0.02) if vertical else turned(0.0, -0.2, 0.02)
    baseline = (0.01, -0.2, 0.0) if vertical else (0.2, 0.01, 0.0)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    code = gray(48, 40, inverses=inverses)
    scene = in_camera(
        rig,
        leaning_wall([0.2, -0.1, 1.0], 1.0, lambert(0.6)),
        Sphere(center_m=(0.02, 0.03, 0.85), radius_m=0.12, material=lambert(0.8)),
    )
    rendering = mitsuba_renderer.render(
        scene, EMPTY_LAYOUT, code.render(), quality=Quality(samples=16, depth=1), seed=0
    )
    frames = noiseless(rendering.radiance.pattern, SENSOR)
    codes = decode(frames, code, DecodeSpec(), levels_of(SENSOR))
    depth = triangulate(codes, rig)

    z = rendering.truth.depth_m.astype(float)
    ray = opencv_rays(camera)
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)

    def across(depth_m):
        uv = cv2.projectPoints(
            (ray * depth_m[..., None]).reshape(-1, 3),
            cv2.Rodrigues(T_proj_cam[:3, :3])[0],
            T_proj_cam[:3, 3],
            projector.K,
            np.array(BEAM),
        )[0].reshape(90, 120, 2)
        return uv[..., int(vertical)]

    where = across(z)
    columns_per_m = (across(z + 1e-4) - across(z - 1e-4)) / 2e-4
    white = rendering.radiance.pattern[0]
    flat = np.abs(np.gradient(z)).sum(axis=0) < 0.02
    lit = cv2.erode((flat & (white > 0)).astype(np.uint8), np.ones((3, 3))) > 0
    footprint = np.abs(np.gradient(where)).sum(axis=0)
    assert lit.mean() > 0.5
    decoded = codes.reason == Reason.DECODED
    assert decoded[lit].mean() > 0.995
    use = lit & (depth.reason == Reason.DECODED)
    read = codes.row if vertical else codes.column
    bound = 0.5 + 0.5 * footprint
    assert (np.abs(read - where) <= bound)[use].all()
    assert (np.abs(read - where) <= 0.5)[use].mean() > 0.93
    error_m = np.abs(depth.depth_m - z)
    assert (error_m <= 1.1 * bound / np.abs(columns_per_m))[use].all()
    assert (error_m <= 0.5 / np.abs(columns_per_m) * 1.02)[use].mean() > 0.93
    sphere = use & (z < 0.86)
    assert sphere.sum() > 200
