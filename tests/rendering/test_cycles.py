"""Cycles' child process may die without loss of frames; features that only Cycles has."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from corner import corner_scene
from noisy_pictures import agree, blocks
from stage import (
    askew_rig,
    box_part,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    leaning_wall,
    make_rig,
    optics,
    plain_pattern,
    turned,
    wall,
)

from graycast.base.errors import DeviceError, GraycastError
from graycast.base.frames import rigid
from graycast.rendering import Quality, open_renderer
from graycast.rendering.cycles.job import is_simple
from graycast.rendering.cycles.process import PYTHON_VARIABLE, WORKER, examine_cycles
from graycast.rig.pattern import gray
from graycast.world.parts import Material
from graycast.world.scene import EMPTY_LAYOUT, Environment, Lamp, Sphere

pytestmark = pytest.mark.slow  # each render of Cycles takes some seconds

ON_LINUX = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
SOURCE = WORKER.parents[2]


@pytest.fixture
def open_cycles():
    """Open renderers that a test may damage."""
    state = examine_cycles()
    if not state.usable:
        pytest.skip(state.problem)
    opened = []

    def open_one(**words):
        opened.append(open_renderer("cycles", device="cpu", **words))
        return opened[-1]

    yield open_one
    for renderer in opened:
        renderer.close()


def children(parent):
    """Return process ids of a process's living children, without zombies."""
    pids = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, ppid = stat.read_text().rpartition(")")[2].split()[:2]
        except (OSError, ValueError):  # The process ended meanwhile.
            continue
        if int(ppid) == parent and state != "Z":
            pids.append(int(stat.parent.name))
    return pids


def small_scene():
    """Return a wall and a ball in the light of a projector and a lamp."""
    rig = make_rig(centred(40, 30, 50), centred(32, 24, 40), baseline_m=(0.1, 0.0, 0.0))
    ball = Sphere(center_m=(0.0, 0.02, 0.7), radius_m=0.1, material=lambert(0.6))
    lamp = Lamp(center_m=(0.2, -0.3, 0.2), target_m=(0.0, 0.0, 0.9))
    scene = in_camera(rig, wall(0.9, lambert(0.5)), ball, T_world_cam=np.eye(4), lamps=(lamp,))
    pattern = np.random.default_rng(2).integers(0, 256, (4, 24, 32)).astype(np.uint8)
    return scene, pattern


def render_small(renderer, *, samples=4, seed=3):
    scene, pattern = small_scene()
    quality = Quality(samples=samples, depth=2)
    return renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)


def assert_same_bits(one, other):
    for name in one.radiance.__dataclass_fields__:
        pair = getattr(one.radiance, name), getattr(other.radiance, name)
        assert np.array_equal(*pair, equal_nan=name == "place_px")
    for name in ("depth_m", "normal", "instance"):
        a, b = getattr(one.truth, name), getattr(other.truth, name)
        assert np.array_equal(a, b, equal_nan=name != "instance")


@ON_LINUX
def test_a_child_killed_during_a_scene_is_replaced_and_no_frame_is_lost_or_repeated(
    open_cycles, cycles_renderer
):
    """The child is killed in its third frame; the result has the same bits as without the kill."""
    before = set(children(os.getpid()))
    done, killed = [], []

    def on_frame(count, total):
        done.append((count, total))
        if count == 2 and not killed:
            (child,) = set(children(os.getpid())) - before
            os.kill(child, signal.SIGKILL)
            killed.append(child)

    rendering = render_small(open_cycles(on_frame=on_frame))
    (child,) = set(children(os.getpid())) - before
    assert killed and child != killed[0]
    total = done[0][1]
    assert [count for count, _ in done] == sorted({count for count, _ in done})  # never twice
    assert done[-1] == (total, total)
    assert_same_bits(rendering, render_small(cycles_renderer))


@ON_LINUX
def test_a_scene_that_kills_every_child_gives_one_error_and_the_next_succeeds(open_cycles):
    before, deaths = set(children(os.getpid())), []

    def on_frame(count, total):
        for child in set(children(os.getpid())) - before:
            os.kill(child, signal.SIGKILL)
            deaths.append(child)

    renderer = open_cycles(on_frame=on_frame)
    with pytest.raises(GraycastError, match=r"(?s)ended 3 times on one scene: .*\(signal 9\)"):
        render_small(renderer, samples=400)
    assert len(set(deaths)) == 3
    renderer.on_frame = lambda count, total: None
    assert np.isfinite(render_small(renderer).truth.depth_m).all()


PARENT = """
import sys
sys.path.insert(0, {tests!r})
from stage import *
from graycast.rig.pattern import gray
from graycast.rendering import Quality, open_renderer
from graycast.world.scene import EMPTY_LAYOUT
rig = askew_rig()
def tell(done, total):
    print(done == total, flush=True)
renderer = open_renderer("cycles", device="cpu", on_frame=tell)
scene = in_camera(rig, wall(0.9, lambert(0.5)))
for seed in range(10**6):
    quality = Quality(samples=16384, depth=1) if seed else Quality(samples=1, depth=1)
    renderer.render(scene, EMPTY_LAYOUT, plain_pattern(rig, 255), quality=quality, seed=seed)
"""


@ON_LINUX
def test_the_child_process_ends_if_its_parent_is_killed(open_cycles):
    """It is killed during a frame that takes a minute."""
    open_cycles()  # This skips the test if Cycles is missing.
    program = PARENT.format(tests=str(Path(__file__).parents[1]))
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    try:
        while (line := parent.stdout.readline()) == "False\n":
            pass  # the frames of a first, small render
        assert line == "True\n"
        time.sleep(1.0)
        (child,) = children(parent.pid)
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    end = time.monotonic() + 10
    while Path(f"/proc/{child}").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not Path(f"/proc/{child}").exists()


def rss_mib(pid):
    words = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+) kB", words)[1]) / 1024


@ON_LINUX
def test_rendering_many_scenes_in_one_child_does_not_increase_its_memory(open_cycles):
    """Each scene has 5 MiB of new meshes and textures, so that leaks would be noticed."""
    before = set(children(os.getpid()))
    renderer, rng = open_cycles(), np.random.default_rng(0)
    rig = make_rig(centred(40, 30, 50), centred(256, 192, 300), baseline_m=(0.1, 0.0, 0.0))
    memory = []
    for seed in range(16):
        texture = rng.integers(0, 256, (512, 512, 3)).astype(np.uint8)
        box = box_part(rng.uniform(0.03, 0.06, 3), Material(texture=texture))
        places = np.array([0.0, 0.0, 0.6]) + rng.uniform(-0.2, 0.2, (20, 3))
        poses = [rigid(turned(*rng.uniform(0, 3, 3)), place) for place in places]
        scene = in_camera(rig, wall(0.9, lambert(0.5)), parts=(box,))
        pattern = rng.integers(0, 256, (6, 192, 256)).astype(np.uint8)
        layout = layout_in_camera(
            [0] * 20, [rigid(p[:3, :3], p[:3, 3] + [0, 0, 0.6]) for p in poses]
        )
        quality = Quality(samples=1, depth=2)
        renderer.render(scene, layout, pattern, quality=quality, seed=seed)
        (child,) = set(children(os.getpid())) - before
        memory.append(rss_mib(child))
    assert len(set(children(os.getpid())) - before) == 1
    growth = np.polyfit(np.arange(12), memory[4:], 1)[0]  # MiB per scene, after some scenes
    assert abs(growth) < 0.5, memory
    assert max(memory[4:]) < memory[4] + 10, memory


@pytest.mark.parametrize("kind", ["missing", "no program", "without Blender"])
def test_the_error_for_a_python_without_cycles_names_this_python(monkeypatch, tmp_path, kind):
    """The missing package is noticed before anything is rendered."""
    place = {"missing": tmp_path / "gone", "no program": tmp_path / "text"}
    (tmp_path / "text").write_text("not a program")
    (tmp_path / "text").chmod(0o755)
    python = place.get(kind, Path(sys.executable))
    monkeypatch.setenv(PYTHON_VARIABLE, str(python))
    with pytest.raises(DeviceError, match=re.escape(str(python))):
        open_renderer("cycles", device="cpu")


def test_an_error_in_cycles_states_its_reason_and_the_next_scene_is_rendered(
    cycles_renderer, tmp_path
):
    scene, pattern = small_scene()
    file = tmp_path / "no_such_map.exr"
    dark = in_camera(scene.rig, wall(0.9, lambert(0.5)), environment=Environment(map_file=file))
    with pytest.raises(GraycastError, match=r"Blender Cycles: .*no_such_map\.exr"):
        cycles_renderer.render(
            dark, EMPTY_LAYOUT, pattern, quality=Quality(samples=1, depth=1), seed=0
        )
    assert np.isfinite(render_small(cycles_renderer).truth.depth_m).all()


def test_only_the_child_process_imports_blender(cycles_renderer):
    render_small(cycles_renderer)
    assert "bpy" not in sys.modules and "_cycles" not in sys.modules
    imports = re.compile(r"^\s*(import|from) (bpy|_cycles|mathutils)\b", re.MULTILINE)
    places = [file for file in SOURCE.rglob("*.py") if imports.search(file.read_text())]
    assert places and all(WORKER in file.parents for file in places)


def test_frames_of_one_scene_rendered_by_cycles_have_independent_noise(cycles_renderer):
    """Two equal patterns of one render differ by as much as those of two renders."""
    scene, layout = corner_scene()
    pattern = plain_pattern(scene.rig, 254, 254)
    quality = Quality(samples=4, depth=3)
    one, other = (
        cycles_renderer.render(scene, layout, pattern, quality=quality, seed=seed).radiance
        for seed in (0, 1)
    )
    within = np.mean((one.pattern[0] - one.pattern[1]) ** 2)
    also = np.mean((one.pattern[0] - 254 / 255 * one.white) ** 2)
    between = np.mean((one.pattern[0] - other.pattern[0]) ** 2)
    assert 0.7 < within / between < 1.4 and 0.7 < also / between < 1.4


@pytest.mark.parametrize("size", [(48, 36), (36, 48)])
def test_blender_s_own_camera_agrees_with_the_exact_renderer(cycles_renderer, size):
    """Square pixels and an off-centre axis, in a wide and in a tall picture. The mean of 64 evenly
    spread samples is within a twentieth of a pixel of the pixel's centre.
    """
    width, height = size
    camera = replace(centred(width, height, 60), cx_px=0.5 * width - 5.3, cy_px=0.5 * height + 3.2)
    assert is_simple(camera)
    scene = in_camera(askew_rig(camera=camera), leaning_wall([0.4, -0.3, 1.0], 0.7, lambert(0.6)))
    pattern = plain_pattern(scene.rig, 255)
    quality = Quality(samples=64, depth=1)
    exact, cycles = (
        one.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=1)
        for one in (open_renderer("reference"), cycles_renderer)
    )
    assert np.abs(cycles.truth.depth_m / exact.truth.depth_m - 1).max() < 2e-6
    a, b = exact.radiance.pattern[0], cycles.radiance.pattern[0]
    slope = np.abs(np.gradient(a)).sum(axis=0)
    inside = (a > 0) & (slope < 0.1 * a)
    assert inside.mean() > 0.5
    assert (np.abs(a - b) < 1e-4 * a + 0.05 * slope)[inside].all()
    # Half a pixel would be noticed: neighbours differ by far more.
    assert np.median(slope[inside] / a[inside]) > 0.005


def test_the_denoiser_reduces_noise_of_a_lit_wall_and_keeps_its_brightness(cycles_renderer):
    """The noise of a lamp's light at 4 samples is compared with 256. The lamp is out of sight.

    The picture's border is ignored: Open Image Denoise brightens its first pixel by a fifth.
    """
    rig = make_rig(centred(48, 36, 50), centred(8, 8, 8))
    lamp = Lamp(center_m=(0.2, -0.6, 0.4), target_m=(0.0, 0.0, 0.9))
    scene = in_camera(
        rig, leaning_wall([0.3, 0.0, 1.0], 0.9, lambert(0.6)), T_world_cam=np.eye(4), lamps=(lamp,)
    )

    def ambient(samples, denoise, seed):
        quality = Quality(samples=samples, depth=1, denoise=denoise)
        pattern = plain_pattern(rig, 0)
        rendering = cycles_renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)
        return rendering.radiance.ambient_rgb[..., 1].astype(float)

    truth = ambient(256, "none", 9)
    noisy, clean = (
        (ambient(4, denoise, 2) / truth - 1)[3:-3, 3:-3] for denoise in ("none", "oidn")
    )
    assert noisy.std() > 0.03
    assert clean.std() < 0.4 * noisy.std()
    assert abs(clean.mean()) < 0.01


def test_three_patterns_rendered_together_equal_separate_renders(open_cycles, cycles_renderer):
    """A laser lights coloured objects; the last render of four patterns has two unused bands."""
    scene, layout = corner_scene()
    rig = replace(scene.rig, band_weights=(0.0, 1.0, 0.0))
    scene = replace(scene, rig=rig)
    pattern = plain_pattern(rig, 255, 255, 255, 128)
    pattern[1, :, ::2], pattern[2, :12] = 0, 0
    three = open_cycles(patterns_per_render=3)
    quality = Quality(samples=16, depth=3)
    stacks = [
        np.stack(
            [
                renderer.render(scene, layout, pattern, quality=quality, seed=s).radiance.pattern
                for s in seeds
            ]
        ).astype(float)
        for renderer, seeds in ((cycles_renderer, range(8)), (three, range(20, 28)))
    ]
    one, other = (blocks(stack) for stack in stacks)
    for k in range(len(pattern)):
        assert agree(one[:, k], other[:, k])
        assert not agree(1.03 * one[:, k], other[:, k])


def test_three_patterns_in_one_render_of_coloured_surfaces_are_refused(open_cycles):
    """Otherwise each pattern would have another colour."""
    three = open_cycles(patterns_per_render=3)
    rig = askew_rig(camera=optics(24, 18, 30))
    pattern = plain_pattern(rig, 254, 128)
    quality = Quality(samples=4, depth=1)
    coloured = in_camera(rig, wall(0.8, lambert(0.9, 0.5, 0.1)))
    with pytest.raises(ValueError, match="one wavelength"):
        three.render(coloured, EMPTY_LAYOUT, pattern, quality=quality, seed=0)
    grey = in_camera(rig, wall(0.8, lambert(0.5)))
    light = three.render(grey, EMPTY_LAYOUT, pattern, quality=quality, seed=0).radiance
    lit = light.pattern[0] > 0
    assert lit.mean() > 0.5
    # Two bands of one render have the same paths, and therefore the same noise.
    assert np.abs(light.pattern[1][lit] / light.pattern[0][lit] - 128 / 254).max() < 1e-5


@pytest.mark.parametrize("per_render", [1, 3])
def test_a_white_pattern_is_rendered_once_and_a_black_pattern_never(open_cycles, per_render):
    rig = askew_rig(camera=optics(24, 18, 30))
    frames = []
    renderer = open_cycles(patterns_per_render=per_render, on_frame=lambda *end: frames.append(end))
    scene, quality = in_camera(rig, wall(0.8, lambert(0.5))), Quality(samples=4, depth=1)
    pattern = plain_pattern(rig, 255, 0, 128, 255)
    light = renderer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=0).radiance
    assert len(frames) == 7  # pattern 2, white, ambient, albedo, three of the truth
    for number in (0, 3):
        assert np.array_equal(light.pattern[number], light.white)
    assert light.white.max() > 0 and not light.pattern[1].any()
    lit = light.white > light.white.max() / 2
    assert np.abs(light.pattern[2][lit] / light.white[lit] * 255 / 128 - 1).max() < 0.2


@pytest.mark.parametrize(
    ("rig", "says"),
    [
        (
            askew_rig(projector=replace(optics(64, 48, 52), psf_px=1.0)),
            "blur psf_px of the projector",
        ),
    ],
)
def test_light_that_cycles_cannot_render_is_refused(cycles_renderer, rig, says):
    scene, quality = in_camera(rig, wall(0.8, lambert(0.5))), Quality(samples=1, depth=1)
    with pytest.raises(ValueError, match=says):
        cycles_renderer.render(
            scene, EMPTY_LAYOUT, plain_pattern(rig, 255), quality=quality, seed=0
        )


@pytest.mark.parametrize("weights", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_cycles_denoises_light_of_one_wavelength_in_grey(cycles_renderer, weights):
    """A denoiser blurs the stripes of a picture in one pure colour; in grey it works as for white
    light, and the colour picture keeps its colour.
    """
    rig = askew_rig(camera=optics(48, 36, 60), band_weights=weights)
    white = replace(rig, band_weights=(1 / 3, 1 / 3, 1 / 3))
    pattern = gray(rig.projector.width_px, rig.projector.height_px).render()[4:5]
    quality = Quality(samples=4, depth=1, denoise="oidn")
    one, other = (
        cycles_renderer.render(
            in_camera(own, wall(0.8, lambert(0.6))), EMPTY_LAYOUT, pattern, quality=quality, seed=1
        ).radiance
        for own in (rig, white)
    )
    assert np.abs(one.pattern - other.pattern).max() < 1e-5 * other.pattern.max()
    lit = one.white > 0.5 * one.white.max()
    band = int(np.argmax(weights))
    others = np.delete(one.white_rgb, band, axis=-1)
    assert others.mean() < 0.01 * one.white_rgb[..., band].mean()  # the denoiser leaks a little
    assert one.white_rgb[lit][:, band].mean() == pytest.approx(one.white[lit].mean(), rel=0.05)


def test_denoising_three_patterns_rendered_together_is_refused(open_cycles):
    rig = askew_rig(band_weights=(1.0, 0.0, 0.0))
    quality = Quality(samples=1, depth=1, denoise="oidn")
    with pytest.raises(ValueError, match="patterns_per_render"):
        open_cycles(patterns_per_render=3).render(
            in_camera(rig, wall(0.8, lambert(0.5))),
            EMPTY_LAYOUT,
            plain_pattern(rig, 255),
            quality=quality,
            seed=0,
        )
