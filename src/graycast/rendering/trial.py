"""Trial of a render device: a child process, which may crash, renders and denoises a small picture.

A driver or an incomplete library can crash the process that uses it, without an exception. So a
device is tried in a child process before it is used. A successful trial is stored in the user's
cache folder, and is valid until a driver, a GPU or a library changes.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version

from ..base.errors import GraycastError
from ..base.file_limits import parse_json
from ..base.folder import cache_folder, write_whole
from ..base.version import __version__

_LIMIT_S = 300.0  # Compilation for the first picture on a GPU takes about 10 s.
_CHILD = f"{__package__}.trial_picture"
_PACKAGES = ("mitsuba", "drjit", "pyoidn")


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Result of a trial: `problem` is a failure's reason, `denoiser` the denoiser's device."""

    device: str
    seconds: float
    denoiser: str | None = None
    problem: str | None = None


def try_device(device: str, *, program: Sequence[str] = ("-m", _CHILD)) -> Trial:
    """Render and denoise a small picture on 'llvm' or 'cuda' in a child process.

    Args:
        program: arguments of the child's Python before the device.
    """
    start, denoiser, problem = time.perf_counter(), None, None
    command = [sys.executable, *program, device]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        child = subprocess.run(command, env=env, capture_output=True, text=True, timeout=_LIMIT_S)
    except subprocess.TimeoutExpired:
        problem = f"a small picture was not finished in {_LIMIT_S:.0f} s"
    else:
        if child.returncode == 0:
            denoiser = parse_json(child.stdout.splitlines()[-1])["denoiser"]
        else:
            problem = _obituary(child)
    seconds = time.perf_counter() - start
    return Trial(device=device, seconds=seconds, denoiser=denoiser, problem=problem)


def tried_before(device: str, machine: object) -> Trial:
    """Return the stored result of a successful trial on the same machine, or try the device now.

    Args:
        machine: state, in addition to installed packages, on which the trial depends: the driver.
    """
    versions = [__version__, sys.version, *(version(name) for name in _PACKAGES)]
    stated = repr((device, machine, versions))
    key = hashlib.sha256(stated.encode()).hexdigest()[:32]
    folder = cache_folder("devices")
    if folder is None:
        return try_device(device)
    file = folder / f"{key}.json"
    try:
        return Trial(**parse_json(file.read_bytes()))
    except (OSError, ValueError, TypeError):  # There was no trial yet, or the file is damaged.
        trial = try_device(device)
    if trial.problem is None:
        with suppress(OSError, GraycastError):  # Without a file, the next process tries again.
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, json.dumps(asdict(trial)).encode())
    return trial


def _obituary(child: subprocess.CompletedProcess[str]) -> str:
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    how = f"ended with exit code {child.returncode}"
    if child.returncode < 0:
        how = f"was ended by {signal.Signals(-child.returncode).name}"
    why = f": {lines[-1]}" if lines else ""
    return f"a process that rendered a small picture on it {how}{why}"
