"""Motion during a scan: poses and times, the light over time, and what a decoder makes of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stage import SOMEWHERE, in_camera, lambert, leaning_wall

from graycast.base.errors import ArgumentError, ConfigError
from graycast.base.frames import axis_rotation, inverse, rigid, transform_points
from graycast.camera.decode import DecodeSpec, Levels, decode
from graycast.camera.exposure import ExposureSpec, ExposureTimes
from graycast.camera.scanner import Scanner, measure, preset, scan, take_exposures
from graycast.camera.sensor import Capture, SensorSpec, stored_saturation_dn
from graycast.cell.motion import MotionSection, pose_at, speed_px_s, timeline
from graycast.cell.moving_light import MovingLight, _merged, plan_renders
from graycast.cell.resolve import patterns_of
from graycast.rendering import Quality, open_renderer
from graycast.rig.optics import points, project
from graycast.rig.pair import preset_rig
from graycast.rig.pattern import CodeSpec
from graycast.world.scene import EMPTY_LAYOUT

DISTANCE_M, PERIOD_PX = 0.75, 16.0
ONE = ExposureTimes(reference_s=1e-4, times_s=(1e-4,))
DOWN = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.9]))


@pytest.fixture(scope="module")
def rig():
    """Return a strip of the PhoXi M's camera, with pinholes."""
    rig = preset_rig("like-phoxi-m", "small")
    camera = replace(rig.camera, width_px=120, height_px=4, cx_px=60.0, cy_px=1.5)
    return replace(rig, camera=camera, contrast_ratio=math.inf)


# --- poses and times -----------------------------------------------------------------------------


def test_a_belt_that_moves_in_x_moves_the_camera_against_x_in_the_frame_of_the_parts():
    pose = pose_at(DOWN, MotionSection(belt_m_s=(0.2, 0.0, 0.0)), 0.5)
    assert np.allclose(pose, rigid(DOWN[:3, :3], np.array([-0.1, 0.0, 0.9])))


def test_a_rig_turns_about_the_axes_of_its_own_camera():
    pose = pose_at(DOWN, MotionSection(rig_deg_s=(0.0, 0.0, 90.0)), 0.5)
    assert np.allclose(pose[:3, :3], DOWN[:3, :3] @ axis_rotation("z", np.pi / 4))
    assert np.allclose(pose[:3, 3], DOWN[:3, 3])


def test_a_path_in_the_frame_of_a_robot_moves_the_rig_as_the_same_velocities_do():
    T_base_world = rigid(axis_rotation("z", 0.7), np.array([0.3, -0.2, 0.1]))
    velocities = MotionSection(rig_m_s=(0.1, 0.05, -0.02), rig_deg_s=(0.0, 10.0, 0.0))
    poses = [(t, T_base_world @ pose_at(DOWN, velocities, t)) for t in (-1.0, 0.5, 2.0)]
    path = [{"time_s": t, "T_base_cam": tuple(T.ravel())} for t, T in poses]
    motion = MotionSection(path=path)
    for time_s in (-0.9, 0.0, 0.3, 1.7):
        expected = pose_at(DOWN, velocities, time_s)
        assert np.allclose(pose_at(DOWN, motion, time_s), expected, atol=1e-9)


@pytest.mark.parametrize("sections", [(0, 0.0), (9, 0.02), (None, 0.02)])
def test_the_stated_picture_has_the_time_of_the_ground_truth(sections):
    picture, picture_s = sections
    times = ExposureTimes(reference_s=0.002, times_s=(0.002, 0.008))
    line = timeline(
        MotionSection(truth_picture=picture, picture_s=picture_s or None), times, frames=6
    )
    assert line.middle_s.ravel()[6 if picture is None else picture] == pytest.approx(0.0)
    steps = (0.012, 0.018) if not picture_s else (0.02, 0.02)
    assert np.allclose(np.diff(line.start_s, axis=1).T, steps)
    assert line.start_s[1, 0] - line.start_s[0, -1] == pytest.approx(steps[0])
    assert line.scan_s == pytest.approx(6 * sum(steps))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"belt_m_s": (11, 0, 0)}, "belt_m_s"),
        ({"path": [{"time_s": t, "T_base_cam": [0.0] * 16} for t in (0, 1)]}, "not a rotation"),
        ({"path": [{"time_s": t, "T_base_cam": [0.0]} for t in (0, 1)]}, "give 16"),
        ({"path": [{"time_s": 1, "T_base_cam": np.eye(4).ravel().tolist()}] * 2}, "sort its poses"),
        (
            {"path": [{"time_s": t, "T_base_cam": np.eye(4).ravel().tolist()} for t in (0.1, 0.2)]},
            "must include 0",
        ),
        (
            {
                "rig_m_s": (1, 0, 0),
                "path": [{"time_s": t, "T_base_cam": np.eye(4).ravel().tolist()} for t in (0, 1)],
            },
            "remove path",
        ),
    ],
)
def test_a_wrong_motion_is_refused_with_its_remedy(settings, words):
    with pytest.raises(ArgumentError, match=words):
        MotionSection(**settings)


def test_a_scan_longer_than_the_path_is_refused():
    eye = np.eye(4).ravel().tolist()
    motion = MotionSection(path=[{"time_s": t, "T_base_cam": eye} for t in (0, 0.1)])
    with pytest.raises(ConfigError, match="add poses before or after"):
        pose_at(DOWN, motion, 0.2)


def test_pictures_cannot_follow_each_other_faster_than_they_are_exposed():
    times = ExposureTimes(reference_s=0.002, times_s=(0.03,))
    with pytest.raises(ConfigError, match="at least the exposure"):
        timeline(MotionSection(picture_s=0.02), times, frames=6)
    with pytest.raises(ConfigError, match="pictures 0 to 5"):
        timeline(MotionSection(truth_picture=6), times, frames=6)


def test_the_speed_of_the_picture_is_that_of_its_nearest_point(rig):
    """At a distance z, f v / z pixels a second; the projector has the longer focal length here."""
    speed = speed_px_s(rig, DOWN, MotionSection(belt_m_s=(0.0, 0.1, 0.0)), start_s=-1.0, end_s=1.0)
    in_camera = rig.camera.fy_px * 0.1 / rig.near_m
    assert in_camera * 0.99 <= speed
    assert speed <= 1.5 * max(rig.camera.fy_px, rig.projector.fy_px) * 0.1 / rig.near_m


# --- few renders for many pictures ---------------------------------------------------------------


def test_light_that_changes_in_proportion_to_time_is_interpolated_without_error():
    start_s = np.arange(20) * 0.011
    duration_s = np.full(20, 0.004)
    for longest_s in (0.001, 0.003, 0.02, 0.1):
        plan = plan_renders(start_s, duration_s, longest_s=longest_s)
        mean = plan.weight @ (3.0 - 5.0 * plan.time_s)
        assert np.allclose(mean, 3.0 - 5.0 * (start_s + duration_s / 2))


def test_a_slow_motion_needs_few_renders_and_a_fast_one_some_for_each_picture():
    start_s, duration_s = np.arange(20) * 0.01, np.full(20, 0.002)
    renders = [
        len(plan_renders(start_s, duration_s, longest_s=s).time_s)
        for s in (math.inf, 0.1, 0.02, 0.005, 0.0005)
    ]
    assert renders == [1, 3, 11, 20, 80]


def test_an_exposure_longer_than_the_motion_between_renders_is_a_mean_over_its_time():
    plan = plan_renders(np.zeros(1), np.ones(1), longest_s=0.1)
    assert plan.weight @ np.cos(plan.time_s) == pytest.approx(math.sin(1.0), rel=1e-3)


# --- a plane that moves --------------------------------------------------------------------------


def decoded_columns(rig, motion, *, steps, wall_z_m=DISTANCE_M):
    """Return decoded columns of a facing wall that moves, and the timeline of the scan."""
    code = CodeSpec(codec="gray_phase", axes=("column",), period_px=PERIOD_PX, steps=steps).code(
        rig.projector.width_px, rig.projector.height_px
    )
    scene = in_camera(rig, leaning_wall((0, 0, 1), wall_z_m, lambert(0.6), half_m=0.6))
    moving = MovingLight(
        open_renderer("reference"), scene, EMPTY_LAYOUT, code.render(), motion,
        quality=Quality(samples=16, depth=1), seed=0,
    )  # fmt: skip
    (light,) = moving(ONE)
    frames = np.round(light.stack / light.stack.max() * 60_000).astype(np.uint16)
    levels = Levels(offset_dn=0.0, floor_dn2=1.0, slope_dn=0.0, saturation_dn=65_000.0)
    codes = decode(frames, code, DecodeSpec(), levels)
    return codes.column, timeline(motion, ONE, len(code.frames)), code


def columns_of_wall(rig, z_m):
    """Return the projector columns that light a facing wall at a distance, from the geometry."""
    size = rig.camera.height_px, rig.camera.width_px
    point_m = points(rig.camera, np.full(size, z_m))
    return project(rig.projector, transform_points(inverse(rig.T_cam_proj), point_m))[..., 0]


def phase_of_moving_cosine(phase, epsilon, steps):
    """Return the phase that N even steps give if it grows by `epsilon` per picture [rad].

    `phase` is that in the middle of the steps. Closed form: the sum of I_k exp(i d_k) is
    exp(i phase) D(epsilon) + exp(-i phase) R, with two geometric series D and R.
    """
    middle = (steps - 1) / 2
    theta = 4 * np.pi / steps - epsilon
    direct = np.sin(steps * epsilon / 2) / np.sin(epsilon / 2)
    ripple = np.exp(1j * middle * (epsilon + theta)) * np.sin(steps * theta / 2)
    total = np.exp(1j * phase) * direct + np.exp(-1j * phase) * ripple / np.sin(theta / 2)
    return np.angle(total)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [4, 5, 8])
def test_a_plane_that_approaches_has_the_phase_error_of_the_closed_form(rig, steps):
    """The error is the motion until the middle of the steps, and a ripple of twice the phase."""
    speed_m_s = -0.06
    velocity_m_s = tuple(speed_m_s * SOMEWHERE[:3, 2])  # Along the axis of the camera
    motion = MotionSection(belt_m_s=velocity_m_s, picture_s=0.02, truth_picture=0)
    column, line, code = decoded_columns(rig, motion, steps=steps)
    time_s = line.middle_s[0, [k for k, f in enumerate(code.frames) if f.kind == "phase"]]
    now, first, middle, last = (
        columns_of_wall(rig, DISTANCE_M + speed_m_s * t)
        for t in (0.0, time_s[0], time_s.mean(), time_s[-1])
    )
    phase, epsilon = 2 * np.pi * middle / PERIOD_PX, 2 * np.pi * (last - first) / PERIOD_PX
    off = phase_of_moving_cosine(phase, epsilon / (steps - 1), steps) - phase
    ripple_px = np.angle(np.exp(1j * off)) * PERIOD_PX / (2 * np.pi)
    error_px = column - now
    known = np.isfinite(error_px)
    assert known.mean() > 0.5
    expected_px = middle - now + ripple_px
    rest_px = (error_px - expected_px)[known]
    rest_px -= PERIOD_PX * np.rint(rest_px / PERIOD_PX)  # The Gray code may count one too many.
    assert np.sqrt(np.mean(rest_px**2)) < 0.05 * np.sqrt(np.mean(expected_px[known] ** 2))
    assert np.corrcoef(rest_px + ripple_px[known], ripple_px[known])[0, 1] > 0.95


def scans(scanner, motions, renderer, *, patches):
    """Return depth maps of a leaning wall with grey patches, one for each motion."""
    checks = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((8, 8)))
    texture = np.repeat((60 + 120 * checks)[..., None], 3, axis=-1).astype(np.uint8)
    material = replace(lambert(0.6), texture=texture) if patches else lambert(0.6)
    scene = in_camera(scanner.rig, leaning_wall((0.2, 0.1, 1.0), DISTANCE_M, material, half_m=0.4))
    patterns, quality = patterns_of(scanner), Quality(samples=64, depth=1)
    still = renderer.render(scene, EMPTY_LAYOUT, patterns, quality=quality, seed=1)
    depths, renders = [], []
    for motion in motions:
        moving = MovingLight(
            renderer, scene, EMPTY_LAYOUT, patterns, motion, quality=quality, seed=1
        )
        exposures = take_exposures(scanner, still.radiance, seed=2, light_of=moving)
        depths.append(measure(scanner, moving.at_rest(scanner, exposures), path_noise=None)[1])
        renders.append(moving.record["renders"])
    still_depth = scan(scanner, still.radiance, seed=2).depth
    return still_depth, depths, renders, still.truth


@pytest.fixture(scope="module")
def scanner():
    """Return a PhoXi M with a window of its camera, without speckle, lines, filters and faults."""
    whole = preset("like-phoxi-m", "small")
    camera = replace(whole.rig.camera, width_px=120, height_px=48, cx_px=60.0, cy_px=24.0)
    rig = replace(whole.rig, camera=camera, speckle_contrast=0.0, line_noise=0.0)
    exposure = ExposureSpec(factors=(1.0,))
    return Scanner(rig=rig, code=whole.code, sensor=whole.sensor, exposure=exposure)


@pytest.mark.slow
def test_a_scan_at_rest_is_the_same_with_and_without_motion(scanner, mitsuba_renderer):
    still, (moved,), renders, _ = scans(scanner, [MotionSection()], mitsuba_renderer, patches=True)
    assert renders == [1]
    assert np.allclose(still.depth_m, moved.depth_m, atol=1e-5, equal_nan=True)


@pytest.mark.slow
def test_interpolated_renders_change_the_depth_by_less_than_a_tenth_of_sigma(
    scanner, mitsuba_renderer
):
    """The remaining difference is noise of 64 light paths per pixel; it halves with 256."""
    velocity_m_s = tuple(0.004 * (SOMEWHERE[:3, 1] + SOMEWHERE[:3, 2]))
    motions = [MotionSection(belt_m_s=velocity_m_s, render_px=px) for px in (0.25, 0.1)]
    _, (few, many), renders, _ = scans(scanner, motions, mitsuba_renderer, patches=False)
    pictures = len(scanner.light_code().frames)
    assert renders[0] < 0.6 * pictures and renders[1] == pictures
    ratio = np.abs(few.depth_m - many.depth_m) / many.sigma_m
    both = np.isfinite(ratio)
    assert both.mean() > 0.9
    assert np.sqrt(np.mean(ratio[both] ** 2)) < 0.1


@pytest.mark.slow
def test_a_belt_and_a_rig_with_the_opposite_velocity_give_the_same_depth(scanner, mitsuba_renderer):
    motions = [
        MotionSection(belt_m_s=(0.02, 0.01, 0.0)),
        MotionSection(rig_m_s=(-0.02, -0.01, 0.0)),
    ]
    still, (belt, hand), _, _ = scans(scanner, motions, mitsuba_renderer, patches=True)
    assert np.array_equal(belt.depth_m, hand.depth_m, equal_nan=True)
    assert not np.array_equal(belt.depth_m, still.depth_m, equal_nan=True)


def test_a_point_outside_the_pictures_of_one_exposure_has_the_values_of_the_other():
    """The pixels are good, saturated or outside in the longer exposure, and outside in both."""
    sensor = SensorSpec()
    top_dn = float(stored_saturation_dn(sensor))
    short, long = np.full((2, 3, 1, 4), 100, dtype=np.uint16)
    long += 300
    long[:, 0, 1], long[:, 0, 2:], short[:, 0, 3] = top_dn, 0, 0
    exposures = [
        Capture(frames=f, sensor=sensor, exposure_s=s) for f, s in ((short, 1.0), (long, 4.0))
    ]
    merged = _merged(exposures, top_dn)
    assert (merged.frames == [[400, 100, 100, 0]]).all()
    assert merged.exposure_s[0, :3].tolist() == [4, 1, 1]


@pytest.mark.slow
def test_two_exposures_are_taken_back_each_by_its_own_times(scanner, mitsuba_renderer):
    """Both exposures see the wall at other times; as taken, the median error is about 4 mm."""
    velocity_m_s = tuple(0.05 * SOMEWHERE[:3, 0] + 0.02 * SOMEWHERE[:3, 2])
    motion = MotionSection(belt_m_s=velocity_m_s, picture_s=0.01, render_px=1.0, compensate=True)
    error_m = []
    for factors in ((1.0,), (1.0, 3.0)):  # Bright patches are saturated in the longer exposure.
        own = replace(scanner, exposure=ExposureSpec(factors=factors, target=0.5))
        _, (depth,), _, truth = scans(own, [motion], mitsuba_renderer, patches=True)
        off_m = (depth.depth_m - truth.depth_m)[10:-10, 30:-30]  # These points stay inside.
        assert np.isfinite(off_m).mean() > 0.95
        error_m.append(np.nanquantile(np.abs(off_m), [0.5, 0.9]))
    one, two = error_m
    assert (two < 1.3 * one).all() and two[0] < 1e-4
