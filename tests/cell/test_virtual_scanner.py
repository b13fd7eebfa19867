"""A virtual scanner gives the frames of its cell, and the errors of a device."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_cell import write_cell

from graycast.base.errors import ArgumentError, ConfigError, ScannerError
from graycast.base.frames import rigid
from graycast.base.streams import image_seeds
from graycast.camera.decode import Reason
from graycast.camera.scanner import measure, preset, take
from graycast.cell.config import resolve_quality
from graycast.cell.resolve import load_cell
from graycast.cell.simulate import make_scene
from graycast.cell.virtual_scanner import SETTABLE, VirtualScanner
from graycast.rig.pair import preset_rig, standoff_m
from graycast.rig.pattern import CodeSpec

SEED = 5
MAPS = ("depth_m", "sigma_m", "reason", "gray", "rgb")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return load_cell(write_cell(tmp_path_factory.mktemp("cell")))


@pytest.fixture
def scanner(cell, mitsuba_renderer):
    with VirtualScanner(cell, seed=SEED, device=mitsuba_renderer.device) as scanner:
        yield scanner


def assert_equal_frames(one, other):
    for name in MAPS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


# --- frames --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_first_frame_equals_scene_0_of_the_cell(cell, scanner, mitsuba_renderer):
    frame, truth = scanner.trigger(), scanner.truth()
    sample = make_scene(cell, 0, seed=SEED, renderer=mitsuba_renderer).sample
    measured = sample.scanner_depth
    scene = SimpleNamespace(
        depth_m=measured.depth_m, sigma_m=measured.sigma_m, reason=measured.reason,
        gray=sample.gray, rgb=sample.rgb,
    )  # fmt: skip
    assert_equal_frames(frame, scene)
    np.testing.assert_array_equal(truth.instance, sample.truth.instance)
    T_world_part = scanner.T_world_cam @ truth.T_cam_part
    np.testing.assert_allclose(T_world_part, sample.layout.T_world_part, atol=1e-12)


def test_points_are_depth_that_is_back_projected_by_the_camera_matrix(scanner):
    """Oracle: K^-1 (u, v, 1) z, which holds because this rig has no distortion."""
    frame = scanner.trigger()
    v, u = np.indices(frame.depth_m.shape)
    ray = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(frame.K).T
    np.testing.assert_allclose(frame.points, ray * frame.depth_m[..., None], atol=1e-9)
    none = frame.reason != Reason.DECODED
    assert none.any() and np.isnan(frame.points[none]).all()
    assert np.isfinite(frame.points[~none]).all()


@pytest.mark.slow
def test_the_duration_of_a_frame_is_exposures_and_read_out_of_every_picture(scanner):
    """Each pattern is taken once with 20 ms and once with 80 ms, and read out in 10 ms."""
    scanner.set("exposure.exposure_s", 0.02)
    scanner.set("exposure.factors", [1, 4])
    first, second = scanner.trigger(), scanner.trigger()
    patterns = len(scanner.settings.light_code().frames)
    assert first.pictures == 2 * patterns
    assert first.duration_s == pytest.approx(patterns * (0.02 + 0.08 + 2 * 0.01))
    assert (first.index, first.time_s) == (0, 0)
    assert (second.index, second.time_s) == (1, first.duration_s)


def test_a_program_that_waits_takes_as_long_as_the_device(scanner, monkeypatch):
    """The scan takes 16 s or more, of which the simulation has used a part already."""
    pauses = []
    monkeypatch.setattr(time, "sleep", pauses.append)
    scanner.set("exposure.exposure_s", 1.0)
    start_s = time.perf_counter()
    frame = scanner.trigger(wait=True)
    spent_s = time.perf_counter() - start_s
    assert frame.duration_s - spent_s <= pauses[0] < frame.duration_s


@pytest.mark.slow
def test_the_same_seed_and_calls_give_the_same_frames(cell, scanner, mitsuba_renderer):
    def run(scanner):
        frames = [scanner.trigger(), scanner.trigger()]
        scanner.bin.lift(1)
        scanner.bin.nudge()
        return [*frames, scanner.trigger()]

    with VirtualScanner(cell, seed=SEED, device=mitsuba_renderer.device) as again:
        frames, others = run(scanner), run(again)
    for one, other in zip(frames, others, strict=True):
        assert_equal_frames(one, other)
    assert (frames[0].gray != frames[1].gray).any()  # Each frame has its own noise.


# --- several scanners over one bin ---------------------------------------------------------------


@pytest.mark.slow
def test_two_scanners_see_the_same_bin_after_a_part_is_lifted(
    cell, scanner, mitsuba_renderer, tmp_path
):
    """Behind the part is something farther, and single steps give the same depth."""
    tilted = load_cell(write_cell(tmp_path, view={"tilt_deg": 15.0}))
    with VirtualScanner(tilted, seed=7, bin=scanner.bin, device="cpu") as other:
        both = (scanner, other)
        before = [(each.trigger(), each.truth()) for each in both]
        scanner.bin.lift(1)
        after = [(each.trigger(), each.truth()) for each in both]
    poses = [each.T_world_cam for each in both]
    for (old, old_truth), (new, truth), T_world_cam in zip(before, after, poses, strict=True):
        assert truth.number.tolist() == [0, 2] and {*truth.instance.ravel()} == {-1, 0, 2}
        farther_m = (new.depth_m - old.depth_m)[(old_truth.instance == 1) & (truth.instance == -1)]
        assert np.nanmedian(farther_m) > 0.01
        np.testing.assert_allclose(
            T_world_cam @ truth.T_cam_part, scanner.bin.layout.T_world_part, atol=1e-12
        )
    assert abs(poses[0] - poses[1]).max() > 0.05
    seeds = image_seeds(7, 0, station=0, image=1)
    rendering = mitsuba_renderer.render(
        tilted.scene, scanner.bin.layout, tilted.patterns(),
        quality=resolve_quality(tilted.config), seed=seeds["render"],
    )  # fmt: skip
    capture = take(tilted.scanner, rendering.radiance, seed=seeds["noise"])
    _, depth = measure(tilted.scanner, capture, path_noise=rendering.radiance.path_noise)
    np.testing.assert_array_equal(after[1][0].depth_m, depth.depth_m)


def test_a_rig_of_the_shelf_looks_at_the_bin_of_another_scanner(scanner):
    """The camera has the rig's own size, and hangs at its own distance."""
    other = VirtualScanner("like-phoxi-m", seed=7, bin=scanner.bin, device="cpu")
    rig = preset_rig("like-phoxi-m", "low")
    with other:
        assert other.settings.rig.camera.width_px == rig.camera.width_px
        assert other.settings.decode.max_p_wrong == preset("like-phoxi-m").decode.max_p_wrong
    height_m = standoff_m(rig) + scanner.bin.scene.bin.inner_m[2] / 3
    assert other.T_world_cam[2, 3] == pytest.approx(height_m, rel=0.05)
    with pytest.raises(ArgumentError, match="like-phoxi-m is a rig without parts: give bin="):
        VirtualScanner("like-phoxi-m", seed=7)


def test_a_scanner_of_several_is_named_and_has_its_own_pose(tmp_path):
    aside = rigid(np.eye(3), np.array([0.1, 0.0, 0.0])).ravel().tolist()
    scanners = [{"name": name, "rig": "rig.yaml"} for name in ("left", "right")]
    scanners[1]["T_first_cam"] = aside
    cell = load_cell(write_cell(tmp_path, "rig", scanners=scanners))
    left = VirtualScanner(cell, seed=SEED)
    right = VirtualScanner(cell, seed=SEED, name="right", bin=left.bin)
    moved_m = np.linalg.inv(left.T_world_cam) @ right.T_world_cam
    np.testing.assert_allclose(moved_m[:3, 3], [0.1, 0, 0], atol=1e-12)
    with pytest.raises(ArgumentError, match="name is 'middle': the cell has left, right"):
        VirtualScanner(cell, seed=SEED, name="middle", bin=left.bin)


# --- settings and errors -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("exposure.target", 3, "exposure.target is 3: it should be less than or equal to 1"),
        ("exposure.time", 3, r"unknown key exposure\.time: "),
        ("sensor.gain_dn_per_e", 1, r"sensor\.gain_dn_per_e is no setting .* code, exposure"),
        ("code.axes", ["row"], "code.axes is row: rig small needs column"),
    ],
)
def test_a_refused_setting_names_key_value_and_range_and_changes_nothing(scanner, key, value, text):
    before = scanner.settings
    with pytest.raises(ConfigError, match=text):
        scanner.set(key, value)
    assert scanner.settings == before
    scanner.set("exposure.percentile", 98)
    assert scanner.settings.exposure == replace(before.exposure, percentile=98.0)


@pytest.mark.parametrize("rig", ["rig.yaml", "like-phoxi-m", "like-zivid-2-m70"])
def test_each_listed_setting_accepts_its_value_and_limits_and_nothing_just_outside(tmp_path, rig):
    """The limits are read from the JSON Schema of each setting."""
    scanner = VirtualScanner(load_cell(write_cell(tmp_path, rig=rig)), seed=SEED, device="cpu")
    refused = 0
    with scanner:
        before, ranges = scanner.settings, scanner.setting_ranges()
        for key, setting in ranges.items():
            section, word = key.split(".")
            assert setting.value == getattr(getattr(before, section), word)
            scanner.set(key, setting.value)
            assert scanner.settings == before, key
            one = setting.schema.get("items", setting.schema)
            step = 1 if one["type"] == "integer" else 1e-6
            outside = [one[k] - step for k in ("minimum",) if k in one]
            outside += [one[k] for k in ("exclusiveMinimum", "exclusiveMaximum") if k in one]
            outside += [one[k] + step for k in ("maximum",) if k in one]
            outside += ["neither"] if one["type"] in ("boolean", "string") else []
            for value in outside:
                with pytest.raises(ConfigError, match=key.replace(".", r"\.")):
                    scanner.set(key, [value] if "items" in setting.schema else value)
                refused += 1
            assert scanner.settings == before
    assert refused > 25 and {key.split(".")[0] for key in ranges} == set(SETTABLE)
    assert ("code.steps" in ranges) == (before.code.codec == "gray_phase")
    target = ranges["exposure.target"]
    assert (target.allowed, target.unit) == ("number > 0, ≤ 1", "")
    assert ranges["exposure.exposure_s"].unit == "s" and "sensor's range" in target.description


def test_none_returns_a_setting_to_the_value_of_the_rig(scanner):
    before = scanner.settings
    scanner.set("code.codec", "gray_phase")
    scanner.set("code.steps", 5)
    scanner.set("filters.island_px", 9)
    assert scanner.settings.code == CodeSpec(codec="gray_phase", steps=5, axes=before.code.axes)
    for key in ("code.codec", "filters.island_px"):
        scanner.set(key, None)
    assert scanner.settings == before


@pytest.mark.slow
def test_a_scanner_that_is_not_connected_neither_scans_nor_changes_settings(cell):
    scanner = VirtualScanner(cell, seed=SEED, device="cpu")
    calls = (
        scanner.trigger,
        lambda: scanner.settings,
        lambda: scanner.set("exposure.factors", [1, 4]),
    )
    for call in calls:
        with pytest.raises(ScannerError, match=r"small is not connected: call connect\(\)"):
            call()
    with pytest.raises(ScannerError, match="no frame yet: call trigger"):
        scanner.truth()
    scanner.connect()
    frame = scanner.trigger()
    scanner.disconnect()
    with pytest.raises(ScannerError, match="not connected"):
        scanner.trigger()
    with scanner:
        assert scanner.trigger().time_s == frame.duration_s  # The clock goes on.


@pytest.mark.slow
def test_a_cap_and_a_dark_scene_are_errors_and_a_short_exposure_is_a_frame_without_depth(
    tmp_path, mitsuba_renderer
):
    light = {"environment": {"radiance": [0, 0, 0]}, "lamps": []}
    cell = load_cell(write_cell(tmp_path, light=light))
    with VirtualScanner(cell, seed=SEED, device=mitsuba_renderer.device) as scanner:
        scanner.cap = True
        with pytest.raises(ScannerError, match=r"no light .* small: take its cap off"):
            scanner.trigger()
        scanner.cap = False
        down = scanner.T_world_cam
        scanner.T_world_cam = rigid(np.eye(3), down[:3, 3])  # It looks at the black sky.
        with pytest.raises(ScannerError, match="small takes no picture: "):
            scanner.trigger()
        scanner.T_world_cam = down
        scanner.set("exposure.exposure_s", 1e-7)
        frame = scanner.trigger()
    assert frame.index == 0  # A refused trigger makes no frame.
    assert np.isnan(frame.depth_m).all() and (frame.reason != Reason.DECODED).all()
