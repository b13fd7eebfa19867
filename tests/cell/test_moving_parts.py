"""Parts that roll or swing during a scan, and the flow of all points: laws of rigid motion."""

from dataclasses import replace

import numpy as np
import pytest
from stage import box_part, in_camera, lambert, layout_in_camera

from graycast.base.errors import ConfigError
from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.camera.exposure import ExposureTimes
from graycast.cell.motion import MotionSection, pose_at
from graycast.cell.moving_light import MovingLight
from graycast.cell.moving_parts import flow_px, layout_at, parts_speed_px_s
from graycast.rendering import GroundTruth, Quality
from graycast.rig.optics import points, project
from graycast.rig.pair import preset_rig
from graycast.world.scene import Layout

RADIUS_M = 0.05
POSE = rigid(axis_rotation("x", 0.3), np.array([0.02, -0.01, RADIUS_M]))


def layout_of(*poses):
    return Layout(T_world_part=np.stack(poses), part_index=np.zeros(len(poses), dtype=np.int64))


def moving(**own):
    return MotionSection(parts=[{"part": 0, **own}])


@pytest.fixture(scope="module")
def rig():
    """Return a window of the PhoXi M's camera."""
    rig = preset_rig("like-phoxi-m", "small")
    camera = replace(rig.camera, width_px=96, height_px=48, cx_px=48.0, cy_px=24.0)
    return replace(rig, camera=camera)


@pytest.fixture
def stage(rig):
    """Return a scene with one box, and its layout."""
    part = box_part(np.array([0.03, 0.02, 0.01]), lambert(0.5))
    scene = in_camera(rig, parts=(part,))
    turned = axis_rotation("x", 0.4)
    return scene, layout_in_camera([0], [rigid(turned, np.array([0.0, 0.0, 0.7]))])


def test_the_contact_point_of_a_rolling_wheel_follows_a_cycloid():
    """A wheel turns about y and moves by its radius times the angle, so the contact point rests."""
    rate_deg_s = 90.0
    speed_m_s = RADIUS_M * np.radians(rate_deg_s)
    motion = moving(velocity_m_s=(speed_m_s, 0, 0), turn_deg_s=(0, rate_deg_s, 0))
    contact_m = transform_points(inverse(POSE), POSE[:3, 3] - np.array([0, 0, RADIUS_M]))
    for time_s in (-0.4, 0.001, 0.5, 2.0):
        T = layout_at(layout_of(POSE), motion, time_s).T_world_part[0]
        angle = np.radians(rate_deg_s) * time_s
        cycloid_m = RADIUS_M * np.array([angle - np.sin(angle), 0, 1 - np.cos(angle)])
        expected_m = POSE[:3, 3] - np.array([0, 0, RADIUS_M]) + cycloid_m
        assert np.allclose(transform_points(T, contact_m), expected_m, atol=1e-12)


def test_a_part_that_swings_keeps_its_distance_from_the_pivot():
    pivot_m = np.array([0.1, 0.0, 0.4])
    motion = moving(turn_deg_s=(0, 30, 0), pivot_m=tuple(pivot_m))
    start_m = POSE[:3, 3] - pivot_m
    end_m = layout_at(layout_of(POSE), motion, 1.5).T_world_part[0][:3, 3] - pivot_m
    assert np.linalg.norm(end_m) == pytest.approx(np.linalg.norm(start_m))
    assert np.allclose(end_m, axis_rotation("y", np.pi / 4) @ start_m)


def test_other_parts_stay_and_the_poses_of_the_ground_truth_are_those_at_time_0():
    layout = layout_of(POSE, np.eye(4))
    motion = moving(velocity_m_s=(0.1, 0, 0), turn_deg_s=(10, 20, 30), pivot_m=(0.0, 0.1, 0.2))
    later = layout_at(layout, motion, 0.7).T_world_part
    assert np.array_equal(later[1], np.eye(4)) and not np.allclose(later[0], POSE)
    assert np.allclose(layout_at(layout, motion, 0.0).T_world_part, layout.T_world_part)
    assert layout_at(layout, MotionSection(), 0.7) is layout


def test_a_part_that_is_not_in_the_scene_is_refused(stage):
    scene, layout = stage
    motion = MotionSection(parts=[{"part": 1}])
    with pytest.raises(ConfigError, match="the scene has 1 parts"):
        layout_at(layout, motion, 0.1)
    with pytest.raises(ConfigError, match="the scene has 1 parts"):
        parts_speed_px_s(scene, layout, motion, start_s=-0.1, end_s=0.1)


def test_flow_leads_to_the_pixel_that_sees_the_point_at_the_other_time(stage):
    """The left half sees a part that moves on its own; belt and rig move all points."""
    scene, layout = stage
    camera = scene.rig.camera
    size = camera.height_px, camera.width_px
    depth_m = np.random.default_rng(0).uniform(0.6, 0.9, size)
    instance = np.where(np.arange(size[1]) < 48, 0, -1) * np.ones(size, dtype=np.int64)
    normal = np.zeros((*size, 3))
    truth = GroundTruth(depth_m=depth_m, normal=normal, instance=instance, amodal=())
    own = {"part": 0, "velocity_m_s": (0.02, 0.03, 0.0)}
    rig_alone = MotionSection(rig_deg_s=(3.0, 0.0, 1.0))
    motion = MotionSection(belt_m_s=(0.1, -0.05, 0.02), rig_deg_s=rig_alone.rig_deg_s, parts=[own])
    flow = flow_px(scene, layout, truth, motion, 0.4)
    turned = pose_at(scene.T_world_cam, rig_alone, 0.4)
    for x, extra_m in ((20, [0.02, 0.03, 0.0]), (70, [0.0, 0.0, 0.0])):
        world_m = transform_points(scene.T_world_cam, points(camera, depth_m)[2, x])
        moved_m = world_m + (np.array([0.1, -0.05, 0.02]) + extra_m) * 0.4
        pixel = project(camera, transform_points(inverse(turned), moved_m))
        assert np.allclose(np.array([x, 2]) + flow[2, x], pixel)


def test_the_speed_of_a_part_is_that_of_its_fastest_corner(stage):
    """The box crosses the axis at a right angle, 0.7 m away; its nearest corner is nearer."""
    scene, layout = stage
    velocity_m_s = tuple(0.1 * scene.T_world_cam[:3, 1])
    speed = parts_speed_px_s(
        scene, layout, moving(velocity_m_s=velocity_m_s), start_s=-0.1, end_s=0.1
    )
    slowest = max(scene.rig.camera.fy_px, scene.rig.projector.fy_px) * 0.1 / 0.7
    assert slowest < speed < 1.15 * slowest
    assert parts_speed_px_s(scene, layout, MotionSection(), start_s=-0.1, end_s=0.1) == 0


@pytest.mark.slow
def test_a_part_that_moves_alone_gives_the_pictures_of_a_belt_that_moves_it(
    stage, mitsuba_renderer
):
    """The scene has only this part, so both motions are the same relative to the rig."""
    scene, layout = stage
    velocity_m_s = (0.05, 0.02, -0.03)
    patterns = np.zeros((2, scene.rig.projector.height_px, scene.rig.projector.width_px), np.uint8)
    patterns[:, ::16] = 255
    lights = [
        MovingLight(
            mitsuba_renderer, scene, layout, patterns, motion,
            quality=Quality(samples=16, depth=1), seed=1,
        )(ExposureTimes(reference_s=0.01, times_s=(0.01,)))[0].stack
        for motion in (
            MotionSection(belt_m_s=velocity_m_s, picture_s=0.5),
            MotionSection(
                parts=[{"part": 0, "velocity_m_s": velocity_m_s}], picture_s=0.5
            ),
            MotionSection(picture_s=0.5),
        )
    ]  # fmt: skip
    belt, alone, still = lights
    # Rounding moves single rays across the edges of the part.
    assert np.abs(alone - belt).mean() < 5e-3 * belt.mean()
    assert np.abs(still - belt).mean() > 0.1 * belt.mean()
