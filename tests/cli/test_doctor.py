"""The findings of the doctor agree with those of other programs on this machine."""

import json
import os
import pwd
import subprocess
import sys

import pytest

from graycast.cli import doctor
from graycast.cli.doctor import Finding, describe, examine
from graycast.rendering.device import CudaState
from graycast.rendering.trial import Trial

# The doctor's picture, rendered in a child, takes seconds and is tested in test_device.py.
PROGRAM = """
import json, sys
from graycast.cli import doctor
from graycast.rendering.trial import Trial
doctor.try_device = lambda device: Trial(device="llvm", seconds=0.0, denoiser="cpu")
found = {finding.name: finding.text for finding in doctor.examine()}
heavy = sorted({"mitsuba", "drjit", "numba", "rapier3d", "pyoidn"} & set(sys.modules))
llvm = "libLLVM" in open("/proc/self/maps").read()
import drjit, mitsuba, numba, numpy, platform
stated = {m.__name__: m.__version__ for m in (drjit, mitsuba, numba, numpy)}
stated["Python"] = platform.python_version()
print(json.dumps([found, stated, heavy, llvm]))
"""


@pytest.fixture(scope="module")
def examined():
    return json.loads(subprocess.check_output([sys.executable, "-c", PROGRAM], text=True))


@pytest.fixture
def no_trial(monkeypatch):
    """Skip the picture in a child process, which takes seconds."""
    trial = Trial(device="llvm", seconds=0.0, denoiser="cpu")
    monkeypatch.setattr(doctor, "try_device", lambda device: trial)


def test_versions_of_modules_are_read_without_loading_the_modules(examined):
    report, stated, heavy, llvm = examined
    assert {name: report[name] for name in stated} == stated
    assert heavy == []
    assert not llvm


def test_memory_and_cores_agree_with_the_system(examined):
    report = examined[0]
    total_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    assert float(report["memory"].split()[0]) == pytest.approx(total_gib, abs=0.06)
    assert report["CPU"].startswith(f"{len(os.sched_getaffinity(0))} cores")


@pytest.mark.slow
def test_a_missing_package_is_reported_with_its_remedy_and_use(monkeypatch, no_trial):
    monkeypatch.setattr(doctor, "_PACKAGES", {"no-such-package-here": "flying"})
    text = describe(examine())
    assert "MISSING no-such-package-here" in text
    assert "pip install no-such-package-here" in text
    assert "it is for: flying" in text
    assert text.endswith("This machine is not ready: install what is marked MISSING above.")


@pytest.mark.slow
def test_an_unusable_library_named_by_the_user_is_reported_without_an_error(monkeypatch, no_trial):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/gone/libLLVM-19.so")
    findings = {finding.name: finding for finding in examine()}
    assert not findings["LLVM used"].ok
    assert "/gone/libLLVM-19.so, which is not a file" in findings["LLVM used"].text


def test_the_program_is_ready_even_if_optional_packages_are_missing():
    gpu = Finding(name="GPU", text="none", ok=False, gives="speed")
    numpy = Finding(name="numpy", text="2.0", ok=True, gives="arrays", needed=True)
    assert describe((gpu, numpy)).splitlines() == [
        "none    GPU    none",
        "               it is for: speed",
        "ok      numpy  2.0",
        "ready",
    ]


@pytest.mark.slow
def test_a_gpu_is_named_with_its_driver(monkeypatch, no_trial):
    state = CudaState(devices=("NVIDIA A", "NVIDIA B"), driver_cuda="12.8", has_optix=True)
    monkeypatch.setattr(doctor, "examine_cuda", lambda: state)
    findings = {finding.name: finding for finding in examine()}
    assert findings["NVIDIA GPU"].text == "NVIDIA A, NVIDIA B; driver for CUDA 12.8"
    assert findings["OptiX"].ok


def test_an_unwritable_cache_is_reported_as_a_finding_with_its_variable(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    good = doctor._cache()
    assert good.ok and good.text == str(tmp_path / "graycast")
    (tmp_path / "file").write_text("in the place of a folder")
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        with monkeypatch.context() as patch:
            patch.setenv(name, str(tmp_path / "file"))
            bad = doctor._cache()
        assert not bad.ok and not bad.needed
        assert f"(Not a directory): set {name} to a folder" in bad.text.replace(
            "File exists", "Not a directory"
        )
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(pwd, "getpwuid", lambda user: {}[user])
    assert "no home: set XDG_CACHE_HOME" in doctor._cache().text
