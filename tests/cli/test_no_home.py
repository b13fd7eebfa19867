"""A user without a home, as in a container or on a cluster: no command needs a cache."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from graycast.base import kernels
from graycast.base.kernels import kernel
from graycast.cli import main

PROGRAM = """
import sys
import numpy as np
from graycast.camera.decode.median import median
from graycast.cli import main
assert median(np.array([3.0, 1.0, 2.0]), 3) == 2.0
sys.exit(main(["rig", "list"]))
"""


@kernel()
def _tripled(x):
    return 3 * x


def test_one_note_says_that_compiled_code_is_not_cached_and_how_to_cache_it(
    monkeypatch, tmp_path, capsys
):
    file = tmp_path / "file"
    file.write_text("in the place of a folder")
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(file / "kernels"))
    monkeypatch.setattr(kernels, "package_files", lambda: {__name__: Path(__file__)})
    assert kernel()(_tripled.py_func)(2) == 6
    assert main(["rig", "list"]) == 0
    (note,) = capsys.readouterr().err.splitlines()
    assert note.startswith(f"graycast: note: {file / 'kernels'} cannot be written (")
    assert "set XDG_CACHE_HOME, or NUMBA_CACHE_DIR if you use it, to a folder" in note
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path / "kernels"))
    assert kernel()(_tripled.py_func)(2) == 6
    assert main(["rig", "list"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.parametrize("other_user", [False, True])
def test_a_command_runs_without_a_home_folder(other_user):
    """No user can make a folder in /proc, so this also works for root."""
    command = [sys.executable, "-c", PROGRAM]
    if other_user:
        if os.geteuid() != 0 or shutil.which("setpriv") is None:
            pytest.skip("running as another user needs root")
        command = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", *command]
    env = {"PATH": "/usr/bin:/bin", "HOME": "/proc/nohome", "PYTHONPATH": str(_source())}
    run = subprocess.run(command, env=env, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "like-phoxi-m" in run.stdout
    notes = [line for line in run.stderr.splitlines() if line.startswith("graycast: ")]
    assert len(notes) == 1 and "/proc/nohome/.cache/graycast/kernels" in notes[0]
    assert "Traceback" not in run.stderr


def _source() -> Path:
    return Path(kernels.__file__).parents[2]


@pytest.mark.slow
def test_a_scene_is_made_without_a_home_folder(tmp_path):
    """Hulls, the trial of the device, Dr.Jit and Matplotlib each have a cache in the home."""
    from small_cell import write_cell

    path = write_cell(tmp_path, scenes=1, count=1)
    command = [sys.executable, "-m", "graycast", "generate", path, "--out", tmp_path / "out"]
    env = {"PATH": "/usr/bin:/bin", "HOME": "/proc/nohome", "PYTHONPATH": str(_source())}
    env["NUMBA_CACHE_DIR"] = str(kernels.kernel_folder())  # compiling takes minutes
    run = subprocess.run(command, env=env, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    depth = list((tmp_path / "out").rglob("scene_camera.json"))
    assert len(depth) == 1 and np.all([file.stat().st_size for file in depth])
