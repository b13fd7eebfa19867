"""The commands on an NVIDIA GPU, and its pictures beside those of the processor.

`make test-gpu` runs them. They have the mark `gpu` and skip where there is no GPU.
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_cell import GRAYCAST, write_cell

from graycast.base.frames import rigid
from graycast.camera.picture import color_picture
from graycast.camera.scanner import measure, take
from graycast.cell.config import load_config, resolve_quality
from graycast.cell.resolve import resolve_cell
from graycast.rendering import Rendering, open_renderer
from graycast.rendering.device import choose_device, examine_cuda, find_llvm
from graycast.world.scene import Layout

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not examine_cuda().usable, reason="needs an NVIDIA GPU with OptiX"),
]
ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "configs" / "demo.yaml"
SCENES = 2


def graycast(*arguments):
    command = [*GRAYCAST, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr}"
    return ended.stdout + ended.stderr


def picture(scene, kind):
    return cv2.imread(str(scene / kind / "000000.png"), cv2.IMREAD_UNCHANGED)


@pytest.fixture(scope="module")
def on_gpu(tmp_path_factory):
    """The demonstration, made on the GPU by two workers that share it."""
    out = tmp_path_factory.mktemp("gpu") / "demo"
    graycast("generate", DEMO, "--out", out, "--scenes", SCENES, "--device", "cuda",
             "--workers", 2, "--threads", 2)  # fmt: skip
    return out


@pytest.fixture(scope="module")
def on_cpu(request, tmp_path_factory):
    """The same scenes made by the processor, here or on another machine."""
    folder = request.config.getoption("--made-on-cpu")
    if folder is not None:
        return folder
    if find_llvm() is None:
        pytest.skip("the processor cannot render here: give --made-on-cpu (tests/gpu/README.md)")
    out = tmp_path_factory.mktemp("cpu") / "demo"
    graycast("generate", DEMO, "--out", out, "--scenes", SCENES, "--device", "cpu")
    return out


def test_the_doctor_renders_and_denoises_a_picture_on_the_gpu():
    lines = graycast("doctor").splitlines()
    (line,) = [line for line in lines if "picture on cuda" in line]
    assert line.startswith("ok") and "rendered, and denoised on the GPU" in line


def test_the_automatic_choice_of_a_device_selects_the_gpu():
    assert choose_device("auto") == "cuda"


def test_the_renderer_on_the_gpu_meets_the_contract_of_renderers():
    """Every test of the contract that a process with this device can run."""
    folder = Path(__file__).resolve().parents[1] / "render/contract"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        str(folder),
        "--tb=short",
    ]
    command += ["--device", "cuda", "-k", "not cycles and not reference"]
    ended = subprocess.run(command, capture_output=True, text=True)
    print(ended.stdout[-3000:])
    assert ended.returncode == 0


@dataclass(frozen=True, kw_only=True)
class Again:
    """A scene of the processor, `folder`, rendered and decoded again on the GPU."""

    folder: Path
    rendering: Rendering
    depth_m: np.ndarray
    rgb: np.ndarray


@pytest.fixture(scope="module", params=range(SCENES))
def again(request, on_cpu):
    """With the processor's own layout: another type of processor would let the parts fall anew,
    and rounding moves some of them by a tenth of a millimetre.
    """
    folder = on_cpu / "train" / f"{request.param:06d}"
    seeds = json.loads((folder / "manifest.json").read_text())["seeds"]
    cell = resolve_cell(load_config(DEMO), DEMO.parent)
    parts = json.loads((folder / "scene_gt.json").read_text())["0"]
    poses = [
        cell.scene.T_world_cam
        @ rigid(np.reshape(p["cam_R_m2c"], (3, 3)), 1e-3 * np.array(p["cam_t_m2c"]))
        for p in parts
    ]
    layout = Layout(T_world_part=np.array(poses), part_index=np.zeros(len(parts), dtype=int))
    with open_renderer("mitsuba", device="cuda") as renderer:
        rendering = renderer.render(
            cell.scene, layout, cell.patterns(),
            quality=resolve_quality(cell.config), seed=seeds["render"],
        )  # fmt: skip
        rgb = color_picture(
            cell.scanner, rendering, denoiser=renderer.denoiser, seed=seeds["picture"]
        )
    capture = take(cell.scanner, rendering.radiance, seed=seeds["noise"])
    _, depth = measure(cell.scanner, capture, path_noise=None)
    return Again(folder=folder, rendering=rendering, depth_m=depth.depth_m, rgb=rgb)


def in_mm(folder, kind, camera):
    scale = json.loads((folder / camera).read_text())["0"]["depth_scale"]
    return picture(folder, kind) * scale, scale


def test_the_true_labels_equal_those_of_the_processor(again):
    """Rays meet the same triangles: depth to the step of its file, instances pixel by pixel."""
    expected, step_mm = in_mm(again.folder, "depth", "scene_camera.json")
    depth_mm = 1e3 * np.nan_to_num(again.rendering.truth.depth_m)
    assert (np.abs(depth_mm - expected) > 0.51 * step_mm).mean() < 1e-5
    masks = sorted((again.folder / "mask_visib").iterdir())
    assert len(masks) == 30
    instance = again.rendering.truth.instance
    for number, file in enumerate(masks):
        mask = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) > 0
        assert (mask != (instance == number)).mean() < 1e-5, file.name


def test_scanner_depth_equals_that_of_the_processor_except_at_edges(again):
    """Seeds are the same, so only rounding differs, which decides where a ray meets an edge."""
    other, _ = in_mm(again.folder, "depth_sl", "scene_camera_sl.json")
    one = 1e3 * np.nan_to_num(again.depth_m)
    assert ((one > 0) == (other > 0)).mean() > 0.999
    both = (one > 0) & (other > 0)
    assert both.mean() > 0.5
    assert (np.abs(one - other)[both] > 1.0).mean() < 2e-3


def test_the_colour_picture_equals_that_of_the_processor_except_for_rounding(again):
    """One network denoises on both devices, in 16 bits on a GPU; the seed of the noise is one."""
    other = picture(again.folder, "rgb")[..., ::-1].astype(float)
    one = again.rgb.astype(float)
    assert other.std() > 10
    assert np.abs(one - other).mean() < 2
    assert abs(one.mean() - other.mean()) < 0.5


def test_a_dataset_made_on_the_gpu_is_valid(on_gpu):
    graycast("validate", on_gpu)


def test_a_scene_made_on_the_gpu_is_reproducible(on_gpu):
    assert "the same" in graycast("dataset", "rerender", on_gpu, "--device", "cuda")


def test_live_shows_a_cell_on_the_gpu(tmp_path):
    words = [sys.executable, "-m", "benchmarks", "live", write_cell(tmp_path), "--rounds", "2"]
    subprocess.run(words, cwd=ROOT, check=True)


def test_a_rig_design_study_runs_on_the_gpu(tmp_path):
    study = tmp_path / "study.yaml"
    cell = write_cell(tmp_path)
    study.write_text(f"cell: {cell.name}\nlayouts: 1\nsweeps: [{{distance_m: [0.6]}}]\n")
    graycast("rig", "design", study, "--out", tmp_path / "design", "--device", "cuda")
    assert list((tmp_path / "design").rglob("*.csv"))


def test_a_detector_is_trained_and_used_on_the_gpu(tmp_path):
    torch = pytest.importorskip("torch", reason="needs torch: make extras")
    if not torch.cuda.is_available():
        pytest.skip("this torch has no CUDA")
    out, run = tmp_path / "data", tmp_path / "run"
    graycast("generate", write_cell(tmp_path), "--out", out, "--scenes", 10, "--device", "cuda")
    graycast(
        "detector",
        "train",
        out,
        "--out",
        run,
        "--epochs",
        2,
        "--longest-side",
        128,
        "--device",
        "cuda",
    )
    graycast(
        "detector",
        "find",
        run,
        out,
        "--split",
        "test",
        "--out",
        tmp_path / "found",
        "--device",
        "cuda",
    )
    assert (tmp_path / "found").is_dir()


def test_a_robot_picks_with_a_scanner_that_runs_on_the_gpu(tmp_path):
    for package in ("pinocchio", "ompl", "toppra"):
        pytest.importorskip(package, reason="needs make extras")
    cell = Path(DEMO).parent / "cells" / "ur5e_suction.yaml"
    graycast("robot", "pick", cell, "--bins", 1, "--out", tmp_path / "picks", "--device", "cuda")
