"""LLVM is chosen by file name; old versions are never loaded, and the chosen version works."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from graycast.base.errors import DeviceError
from graycast.rendering import device, trial
from graycast.rendering.device import CudaState, choose_device, find_llvm, list_llvm, open_device

HAS_LLVM = find_llvm() is not None
NEEDS_LLVM = pytest.mark.skipif(not HAS_LLVM, reason="no shared LLVM >= 19 on this machine")
NO_GPU = CudaState(problem="no NVIDIA driver")
GPU = CudaState(devices=("NVIDIA X",), driver_cuda="12.8", has_optix=True)


@pytest.fixture
def no_user_choice(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)


def make_library(folder, name, *, header=None):
    """Write a file that looks like a library of this machine: the head of the running Python."""
    folder.mkdir(parents=True, exist_ok=True)
    own = Path(sys.executable).read_bytes()[:64]
    (folder / name).write_bytes(own if header is None else header)
    return folder / name


@pytest.mark.parametrize(
    ("name", "major"),
    [
        ("libLLVM-14.so.1", 14),
        ("libLLVM-14.0.6.so.1", 14),
        ("libLLVM-19.so.1", 19),
        ("libLLVM-19.so", 19),
        ("libLLVM.so.19.1", 19),
        ("libLLVM.so.22.1", 22),
        ("libLLVM-20.1.so", 20),
        ("libLLVM.so.100.0", 100),
    ],
)
def test_the_llvm_release_is_read_from_common_file_names(tmp_path, name, major):
    path = make_library(tmp_path, name)
    assert [(library.path, library.major) for library in list_llvm([tmp_path])] == [(path, major)]


@pytest.mark.parametrize(
    "name", ["libLLVM.so", "libLLVM-C.so", "libLLVM-19-rust-1.82.0-stable.so", "libLLVMCore.so.19"]
)
def test_library_names_without_a_release_are_ignored(tmp_path, name):
    make_library(tmp_path, name)
    assert list_llvm([tmp_path]) == ()


def test_libraries_for_another_machine_and_other_files_are_ignored(tmp_path):
    own = bytearray(Path(sys.executable).read_bytes()[:64])
    other_size, other_machine = own.copy(), own.copy()
    other_size[4] ^= 3  # 64 bit to 32 bit
    other_machine[18] ^= 0xFF
    make_library(tmp_path, "libLLVM.so.19.1", header=bytes(other_size))
    make_library(tmp_path, "libLLVM.so.20.1", header=bytes(other_machine))
    make_library(tmp_path, "libLLVM.so.21.1", header=b"INPUT(-lLLVM-21)")
    make_library(tmp_path, "libLLVM.so.22.1", header=b"")
    assert list_llvm([tmp_path]) == ()


def test_the_newest_library_is_chosen_and_links_are_ignored(tmp_path, no_user_choice):
    old = make_library(tmp_path / "a", "libLLVM-15.so.1")
    good = make_library(tmp_path / "a", "libLLVM.so.19.1")
    newest = make_library(tmp_path / "b", "libLLVM.so.22.1")
    (tmp_path / "a" / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    (tmp_path / "b" / "libLLVM.so").symlink_to("libLLVM.so.22.1")
    (tmp_path / "b" / "libLLVM-23.so").symlink_to("gone.so")
    folders = [tmp_path / "a", tmp_path / "b"]
    assert [library.path for library in list_llvm(folders)] == [newest, good, old]
    assert find_llvm(folders) == newest


def test_llvm_libraries_that_are_too_old_are_not_used(tmp_path, no_user_choice):
    for major in (14, 15, 16, 18):
        make_library(tmp_path, f"libLLVM-{major}.so.1")
    assert find_llvm([tmp_path]) is None


def test_the_user_s_llvm_library_is_preferred_to_a_newer_library(tmp_path, monkeypatch):
    library = make_library(tmp_path / "mine", "libLLVM.so.19.1")
    make_library(tmp_path / "system", "libLLVM.so.22.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert find_llvm([tmp_path / "system"]) == library


def test_the_target_of_a_user_s_library_link_is_checked(tmp_path, monkeypatch):
    make_library(tmp_path, "libLLVM-15.so.1")
    (tmp_path / "libLLVM-19.so").symlink_to("libLLVM-15.so.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-19.so"))
    with pytest.raises(DeviceError, match=r"LLVM 15, which can crash the process.*unset"):
        find_llvm()


@pytest.mark.parametrize(
    ("name", "message"),
    [("gone/libLLVM-19.so", "which is not a file: unset"), ("odd.so", "whose version is unknown")],
)
def test_an_unusable_llvm_library_chosen_by_the_user_is_refused(
    tmp_path, monkeypatch, name, message
):
    make_library(tmp_path, "odd.so")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / name))
    with pytest.raises(DeviceError, match=message) as error:
        choose_device("cpu")
    assert "DRJIT_LIBLLVM_PATH" in str(error.value)
    assert "\n" not in str(error.value)


@NEEDS_LLVM
def test_an_llvm_library_without_a_release_in_its_name_is_loaded_in_a_child(tmp_path, monkeypatch):
    real = next(library for library in list_llvm() if library.major >= 19)
    copy = tmp_path / "libfoo.so"
    copy.symlink_to(real.path)
    monkeypatch.setattr(device, "_major_from_name", lambda path: None)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(copy))
    assert find_llvm() == copy
    assert device._major_from_child(str(copy)) == real.major


@pytest.mark.parametrize(
    ("name", "cuda", "llvm", "expected"),
    [
        ("auto", GPU, True, "cuda"),
        ("auto", NO_GPU, True, "llvm"),
        ("auto", CudaState(devices=("NVIDIA X",)), True, "llvm"),  # a driver without OptiX
        ("auto", CudaState(has_optix=True), True, "llvm"),
        ("auto", GPU, False, "cuda"),
        ("cpu", GPU, True, "llvm"),
        ("llvm", NO_GPU, True, "llvm"),
        ("cuda", GPU, False, "cuda"),
    ],
)
def test_the_device_auto_means_the_best_available_device(monkeypatch, name, cuda, llvm, expected):
    monkeypatch.setattr(device, "examine_cuda", lambda: cuda)
    monkeypatch.setattr(device, "find_llvm", lambda: Path("libLLVM.so.19.1") if llvm else None)
    good = trial.Trial(device="cuda", seconds=1.0, denoiser="cuda")
    monkeypatch.setattr(trial, "tried_before", lambda name, machine: good)
    assert choose_device(name) == expected


@pytest.mark.parametrize("name", ["auto", "cpu", "llvm"])
@pytest.mark.parametrize(("user", "sudo"), [(0, ""), (1000, "sudo ")])
def test_the_error_without_an_llvm_library_names_one_command(
    monkeypatch, tmp_path, name, user, sudo
):
    old = (
        device.LlvmLibrary(path=Path("a"), major=15),
        device.LlvmLibrary(path=Path("b"), major=14),
    )
    monkeypatch.setattr(device, "examine_cuda", lambda: NO_GPU)
    monkeypatch.setattr(device, "find_llvm", lambda: None)
    monkeypatch.setattr(device, "list_llvm", lambda: old)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(device.shutil, "which", lambda word: f"/usr/bin/{word}")
    with pytest.raises(DeviceError) as error:
        choose_device(name)
    assert str(error.value).endswith(
        f"found only 14, 15, too old); run: {sudo}apt-get install libllvm19"
    )


@pytest.mark.parametrize(
    ("cuda", "why"),
    [(NO_GPU, "no NVIDIA driver"), (CudaState(devices=("X",)), "libnvoptix.so.1 cannot be loaded")],
)
def test_the_error_for_a_missing_cuda_states_the_reason(monkeypatch, cuda, why):
    monkeypatch.setattr(device, "examine_cuda", lambda: cuda)
    with pytest.raises(DeviceError, match=why):
        choose_device("cuda")


def test_the_error_for_an_unknown_device_lists_the_known_devices():
    with pytest.raises(ValueError, match="auto, cpu, llvm, cuda"):
        choose_device("gpu")
    with pytest.raises(ValueError, match="llvm or cuda"):
        open_device("auto")


KERNEL = """
import json, os, sys
from graycast.base.errors import DeviceError
from graycast.rendering.device import open_device
open_device("llvm", threads=1)
open_device("llvm", threads=1)
import drjit as dr, mitsuba as mi
from drjit.llvm import Float
n = 1000
x = dr.arange(Float, n)
y = n / 2 + 0 * x
dr.make_opaque(x, y)
maps = open("/proc/self/maps").read()
loaded = sorted({line.split()[-1] for line in maps.splitlines() if "libLLVM" in line})
try:
    open_device("cuda")
    refused = ""
except DeviceError as error:
    refused = str(error)
print(json.dumps({
    "low": dr.sum(dr.minimum(x, y))[0], "high": dr.sum(dr.maximum(x, y))[0], "loaded": loaded,
    "variant": mi.variant(), "threads": dr.thread_count(), "refused": refused,
}))
"""


@pytest.mark.slow
@NEEDS_LLVM
def test_minimum_and_maximum_compile_and_run_with_the_chosen_library():
    """With LLVM 15 these two abort the process (AVX-512); sums by hand for n = 1000 around 500."""
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    report = json.loads(
        subprocess.check_output([sys.executable, "-c", KERNEL], text=True, env=environment)
    )
    assert report["low"] == sum(min(k, 500) for k in range(1000))
    assert report["high"] == sum(max(k, 500) for k in range(1000))
    newest = next(library for library in list_llvm() if library.major >= 19)
    assert report["loaded"] == [str(newest.path)]
    assert report["variant"] == "llvm_ad_rgb"
    assert report["threads"] == 1
    assert "already renders with llvm_ad_rgb; start another process" in report["refused"]


@pytest.mark.slow
@NEEDS_LLVM
def test_opening_a_renderer_after_drjit_loaded_without_llvm_is_an_error():
    program = (
        "import os; os.environ['DRJIT_LIBLLVM_PATH'] = '/gone.so'\n"
        "import drjit\nfrom graycast.rendering.device import open_device\n"
        "try:\n    open_device('llvm')\nexcept Exception as e:\n    print(type(e).__name__, e)"
    )
    output = subprocess.check_output([sys.executable, "-c", program], text=True)
    assert output.startswith("DeviceError Dr.Jit has no LLVM: /gone.so cannot be loaded")


def test_a_number_of_threads_below_one_is_refused():
    with pytest.raises(ValueError, match="threads is 0"):
        open_device("llvm", threads=0)


def test_the_error_for_optix_with_mitsuba_lists_the_possible_devices():
    with pytest.raises(
        ValueError, match=r"optix exists only for Cycles .*choose auto, cpu or cuda"
    ):
        choose_device("optix")


def test_a_device_that_crashes_while_rendering_is_not_chosen(monkeypatch, tmp_path):
    """For example, a file of the driver is missing: the child dies, and this process continues."""
    dying = partial(trial.try_device, program=("-c", "import os; os.abort()"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(trial, "try_device", dying)
    monkeypatch.setattr(device, "examine_cuda", lambda: GPU)
    monkeypatch.setattr(device, "find_llvm", lambda: Path("libLLVM.so.19.1"))
    assert choose_device("auto") == "llvm"
    with pytest.raises(DeviceError, match=r"ended by SIGABRT.*use --device cpu"):
        choose_device("cuda")
    assert not list(tmp_path.rglob("*.json"))  # Without a file, a repair is followed by a trial.


def test_a_successful_device_trial_is_not_repeated_until_the_machine_changes(monkeypatch, tmp_path):
    names = []

    def good(name):
        names.append(name)
        return trial.Trial(device=name, seconds=1.0, denoiser="cuda")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(trial, "try_device", good)
    first, again = (trial.tried_before("cuda", "driver 1") for _ in range(2))
    assert (first, names) == (again, ["cuda"])
    trial.tried_before("cuda", "driver 2")
    assert len(names) == 2


def test_a_working_device_is_used_even_if_its_trial_cannot_be_recorded(monkeypatch, tmp_path):
    (tmp_path / "home").write_text("a file in the place of a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    good = trial.Trial(device="cuda", seconds=1.0, denoiser="cuda")
    monkeypatch.setattr(trial, "try_device", lambda name: good)
    assert trial.tried_before("cuda", "driver 1") == good
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    assert trial.tried_before("cuda", "driver 1") == good


def no_home():
    raise RuntimeError("Could not determine home directory.")


@pytest.mark.slow
def test_a_small_picture_is_rendered_and_denoised_on_the_processor():
    result = trial.try_device("llvm")
    assert (result.problem, result.denoiser) == (None, "cpu")
