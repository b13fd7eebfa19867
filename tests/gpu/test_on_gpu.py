"""The commands on an NVIDIA GPU, and its pictures beside those of the processor.

`make test-gpu` runs them. They have the mark `gpu` and skip where there is no GPU.
"""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_cell import GRAYCAST, write_cell

from graycast.render.device import choose_device, examine_cuda, find_llvm

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not examine_cuda().usable, reason="needs an NVIDIA GPU with OptiX"),
]
DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
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
    given = request.config.getoption("--made-on-cpu")
    if given is not None:
        return given
    if find_llvm() is None:
        pytest.skip("the processor cannot render here: give --made-on-cpu (tests/gpu/README.md)")
    out = tmp_path_factory.mktemp("cpu") / "demo"
    graycast("generate", DEMO, "--out", out, "--scenes", SCENES, "--device", "cpu")
    return out


def test_the_doctor_renders_and_denoises_a_picture_on_the_gpu():
    lines = graycast("doctor").splitlines()
    (line,) = [line for line in lines if "picture on cuda" in line]
    assert line.startswith("ok") and "rendered, and denoised on the GPU" in line


def test_automatic_choice_takes_the_gpu():
    assert choose_device("auto") == "cuda"


def test_the_renderers_contract_holds_on_the_gpu():
    """Every test of the contract that a process with this device can run."""
    folder = Path(__file__).resolve().parents[1] / "contract"
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


@pytest.mark.parametrize("scene", range(SCENES))
def test_truth_is_that_of_the_processor(on_gpu, on_cpu, scene):
    """Beside it on one machine, to the bit; beside another type of processor, but for its rounding,
    which moves a part by micrometres and the edge of a mask from pixel to pixel.
    """
    gpu, cpu = (out / "train" / f"{scene:06d}" for out in (on_gpu, on_cpu))
    one, other = (_poses_mm(at) for at in (gpu, cpu))
    assert np.abs(one - other).max() < 0.01
    same = np.array_equal(one, other)
    depth = [picture(at, "depth").astype(int) for at in (gpu, cpu)]
    assert (np.abs(depth[0] - depth[1]) > (0 if same else 1)).mean() <= (0 if same else 1e-3)
    masks = sorted(path.name for path in (cpu / "mask_visib").iterdir())
    assert masks == sorted(path.name for path in (gpu / "mask_visib").iterdir())
    for name in masks:
        mask = [cv2.imread(str(at / "mask_visib" / name)) for at in (gpu, cpu)]
        assert (mask[0] != mask[1]).mean() <= (0 if same else 1e-4), name


def _poses_mm(scene):
    parts = json.loads((scene / "scene_gt.json").read_text())["0"]
    turn = np.array([part["cam_R_m2c"] for part in parts])
    # A turn of 1 moves what is 100 mm from a part's origin by 100 mm.
    return np.hstack([100 * turn, [part["cam_t_m2c"] for part in parts]])


@pytest.mark.parametrize("scene", range(SCENES))
def test_scanner_depth_is_that_of_the_processor_but_for_rays_that_graze_edges(
    on_gpu, on_cpu, scene
):
    """Seeds are the same, so only rounding differs, which decides where a ray meets an edge."""
    gpu, cpu = (out / "train" / f"{scene:06d}" for out in (on_gpu, on_cpu))
    scale = json.loads((cpu / "scene_camera_sl.json").read_text())["0"]["depth_scale"]
    one, other = (picture(at, "depth_sl").astype(float) * scale for at in (gpu, cpu))
    assert ((one > 0) == (other > 0)).mean() > 0.997
    both = (one > 0) & (other > 0)
    assert both.mean() > 0.5
    assert (np.abs(one - other)[both] > 1.0).mean() < 3e-3


@pytest.mark.parametrize("scene", range(SCENES))
def test_the_colour_picture_is_that_of_the_processor_but_for_rounding(on_gpu, on_cpu, scene):
    """One network denoises on both devices, in 16 bits on a GPU; the seed of the noise is one."""
    gpu, cpu = (out / "train" / f"{scene:06d}" for out in (on_gpu, on_cpu))
    one, other = (picture(at, "rgb").astype(float) for at in (gpu, cpu))
    assert other.std() > 10
    assert np.abs(one - other).mean() < 2
    assert abs(one.mean() - other.mean()) < 0.5


def test_a_dataset_made_on_the_gpu_is_valid(on_gpu):
    graycast("validate", on_gpu)


def test_a_scene_of_the_gpu_comes_out_the_same_again(on_gpu):
    assert "the same" in graycast("rerender", on_gpu, 0, "--device", "cuda")


def test_live_shows_a_cell_on_the_gpu(tmp_path):
    graycast("bench", "live", write_cell(tmp_path), "--rounds", 2, "--device", "cuda")


def test_a_design_is_scanned_on_the_gpu(tmp_path):
    study = tmp_path / "study.yaml"
    cell = write_cell(tmp_path)
    study.write_text(f"cell: {cell.name}\nlayouts: 1\nsweeps: [{{distance_m: [0.6]}}]\n")
    graycast("design", study, "--out", tmp_path / "design", "--device", "cuda")
    assert list((tmp_path / "design").rglob("*.csv"))


def test_a_detector_is_trained_and_used_on_the_gpu(tmp_path):
    torch = pytest.importorskip("torch", reason="needs torch: make extras")
    if not torch.cuda.is_available():
        pytest.skip("this torch has no CUDA")
    out, run = tmp_path / "data", tmp_path / "run"
    graycast("generate", write_cell(tmp_path), "--out", out, "--scenes", 10, "--device", "cuda")
    graycast("train", out, "--out", run, "--epochs", 2, "--size", 128, "--device", "cuda")
    graycast("detect", run, out, "--split", "test", "--out", tmp_path / "found", "--device", "cuda")
    assert (tmp_path / "found").is_dir()


def test_a_robot_picks_before_the_gpu_s_scanner(tmp_path):
    for package in ("pinocchio", "ompl", "toppra"):
        pytest.importorskip(package, reason="needs make extras")
    cell = Path(DEMO).parent / "cells" / "ur5e_suction.yaml"
    graycast("pick", cell, "--bins", 1, "--out", tmp_path / "picks", "--device", "cuda")
