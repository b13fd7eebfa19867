"""The package works as users install it: a wheel in a fresh environment makes a scene."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from small_cell import write_cell

ROOT = Path(__file__).resolve().parents[1]
BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"


def run(command, folder, **environment):
    """Run a command without access to the sources and to this process's settings."""
    variables = {key: os.environ[key] for key in ("PATH", "HOME", "LANG") if key in os.environ}
    done = subprocess.run(
        list(map(str, command)),
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        env=variables | environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build a wheel from a copy of a clone, with the build back end of pyproject.toml."""
    pytest.importorskip("setuptools", minversion="77", reason="needs setuptools 77: see make test")
    copy = tmp_path_factory.mktemp("clone")
    tracked = run(["git", "ls-files", "src", "pyproject.toml", "README.md", "LICENSE"], ROOT)
    for name in tracked.splitlines():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes((ROOT / name).read_bytes())
    folder = tmp_path_factory.mktemp("wheel")
    run([sys.executable, "-c", BUILD, folder], copy)
    (file,) = folder.glob("graycast-*.whl")
    return file


@pytest.mark.slow
def test_the_wheel_contains_every_file_of_the_package(wheel):
    """The wheel also has the page's templates, Blender's scripts and the marker of types."""
    tracked = run(["git", "ls-files", "src/graycast"], ROOT).splitlines()
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert inside == {name.removeprefix("src/") for name in tracked}


@pytest.mark.slow
def test_the_wheel_installed_in_a_fresh_environment_makes_a_scene(wheel, tmp_path):
    """The dependencies come from this environment, so that nothing is downloaded."""
    run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "fresh"], tmp_path)
    python = tmp_path / "fresh/bin/python"
    here = sysconfig.get_path("purelib")
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check"]
    run([*pip, "install", "--quiet", "--no-deps", "--no-index", wheel], tmp_path)
    program = "import graycast, sys; print(graycast.__file__)"
    where = run([python, "-c", program], tmp_path, PYTHONPATH=here)
    assert Path(where.strip()).is_relative_to(tmp_path / "fresh")
    cell, out = write_cell(tmp_path), tmp_path / "out"
    command = tmp_path / "fresh/bin/graycast"
    run([command, "generate", cell, "--scenes", "1", "--out", out], tmp_path, PYTHONPATH=here)
    output = run([command, "validate", out], tmp_path, PYTHONPATH=here)
    assert output.strip() == f"{out}: valid"
