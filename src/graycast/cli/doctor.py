"""List the libraries and devices of this machine, and what each missing one is needed for."""

import os
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..base.errors import DeviceError
from ..base.folder import cache_folder, why_unwritable
from ..base.version import __version__
from ..rendering.cycles import examine_cycles
from ..rendering.device import OLDEST_LLVM, choose_device, examine_cuda, find_llvm, list_llvm
from ..rendering.trial import try_device

_OLDEST_PYTHON = (3, 11)
_PACKAGES = {  # each distribution, and what it adds
    "numpy": "arrays, which every command needs",
    "mitsuba": "rendering",
    "drjit": "rendering",
    "numba": "fast decoding",
    "rapier3d": "dropping parts",
    "manifold3d": "convex decomposition of parts",
    "pyoidn": "denoised colour pictures on a processor",
}
_OPTIONAL = {  # each distribution, the command that installs it, and what it adds
    "torch": ("pip install 'graycast[detect]'", "detectors: detector train, find and study"),
    "torchvision": ("pip install 'graycast[detect]'", "detectors: --model mask-rcnn"),
    "onnx": ("pip install 'graycast[detect]'", "detectors: detector onnx"),
    "onnxruntime": ("pip install 'graycast[detect]'", "detectors: the check of detector onnx"),
    "libreyolo": ("pip install --no-deps libreyolo", "detectors: --model yolov7"),
    "pin": ("pip install 'graycast[pick]'", "robots: kinematics and collision"),
    "ompl": ("pip install 'graycast[pick]'", "robots: planning"),
    "toppra": ("pip install 'graycast[pick]'", "robots: timing of paths"),
    "scikit-learn": ("pip install 'graycast[twin]'", "real compare --classifier, and real twin"),
    "ray": ("pip install 'graycast[ray]'", "workers on a cluster: --engine ray"),
    "pyarrow": ("pip install 'graycast[parquet]'", "dataset export --format parquet"),
    "rosbags": ("pip install 'graycast[ros]'", "dataset export --format ros2bag and mcap"),
    "rerun-sdk": ("pip install 'graycast[rerun]'", "dataset export --format rerun"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of the search for one library or device; `gives` describes its use."""

    name: str
    text: str
    ok: bool
    gives: str
    needed: bool = False


def examine() -> tuple[Finding, ...]:
    """Return findings for all libraries and devices; risky checks run in a child process."""
    return (*_software(), *_machine(), *_devices())


def describe(findings: Sequence[Finding]) -> str:
    """Return a line for each finding, with the use of each missing one, and the verdict."""
    width = max(len(finding.name) for finding in findings)
    lines = []
    for finding in findings:
        mark = "ok" if finding.ok else ("MISSING" if finding.needed else "none")
        lines.append(f"{mark:8}{finding.name:{width}}  {finding.text}")
        if not finding.ok:
            lines.append(f"{'':8}{'':{width}}  it is for: {finding.gives}")
    ready = all(finding.ok for finding in findings if finding.needed)
    not_ready = "This machine is not ready: install what is marked MISSING above."
    return "\n".join([*lines, "ready" if ready else not_ready])


def _software() -> Iterator[Finding]:
    yield Finding(name="graycast", text=__version__, ok=True, gives="this program")
    yield Finding(
        name="Python",
        text=platform.python_version(),
        ok=sys.version_info >= _OLDEST_PYTHON,
        gives=f"Python {'.'.join(map(str, _OLDEST_PYTHON))} or newer runs Graycast",
        needed=True,
    )
    needed = {name: (f"pip install {name}", gives) for name, gives in _PACKAGES.items()}
    for name, (command, gives) in (needed | _OPTIONAL).items():
        try:
            text, ok = version(name), True
        except PackageNotFoundError:
            text, ok = f"not installed; run: {command}", False
        yield Finding(name=name, text=text, ok=ok, gives=gives, needed=name in needed)


def _machine() -> Iterator[Finding]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    model = _field(Path("/proc/cpuinfo"), "model name") or platform.machine()
    yield Finding(name="CPU", text=f"{usable} cores, {model}", ok=True, gives="all computing")
    total, free = (_field(Path("/proc/meminfo"), key) for key in ("MemTotal", "MemAvailable"))
    amount = "unknown"
    if total and free:
        total_gib, free_gib = (int(text.split()[0]) / 2**20 for text in (total, free))  # from KiB
        amount = f"{total_gib:.1f} GiB, {free_gib:.1f} GiB available"
    gives = "rendering, which needs about 4 GiB for a scene of 1032 x 772 pixels"
    yield Finding(name="memory", text=amount, ok=amount != "unknown", gives=gives)
    yield _cache()


def _cache() -> Finding:
    """Return a finding about the folders in which results are kept between commands."""
    stated, usual = os.environ.get("NUMBA_CACHE_DIR"), cache_folder("")
    problems = ["this user has no home: set XDG_CACHE_HOME to a folder"] if usual is None else []
    folders = [] if usual is None else [usual]
    folders += [Path(stated)] if stated else []
    for folder in folders:
        if (problem := why_unwritable(folder)) is not None:
            name = "XDG_CACHE_HOME" if folder == usual else "NUMBA_CACHE_DIR"
            problems.append(f"{problem}: set {name} to a folder that can be written")
    return Finding(
        name="cache",
        text="; ".join(problems) or ", ".join(map(str, folders)),
        ok=not problems,
        gives="keeping compiled code and collision hulls, so that later commands start sooner",
    )


def _devices() -> Iterator[Finding]:
    libraries = ", ".join(f"{library.major} ({library.path})" for library in list_llvm())
    yield Finding(
        name="LLVM found",
        text=libraries or "none",
        ok=bool(libraries),
        gives=f"rendering on the processor, with version {OLDEST_LLVM} or newer",
    )
    try:
        llvm = find_llvm()
        text = str(llvm) if llvm else f"no version {OLDEST_LLVM} or newer is installed"
    except DeviceError as error:
        llvm, text = None, str(error)
    gives = "rendering on the processor; rendering on a GPU does not need it"
    yield Finding(name="LLVM used", text=text, ok=bool(llvm), gives=gives)

    cycles = examine_cycles()
    yield Finding(
        name="Blender Cycles",
        text=cycles.problem or f"bpy {cycles.version} ({cycles.python})",
        ok=cycles.usable,
        gives="a second renderer: --backend cycles",
    )
    cuda = examine_cuda()
    gpus = f"{', '.join(cuda.devices)}; driver for CUDA {cuda.driver_cuda}"
    yield Finding(
        name="NVIDIA GPU",
        text=gpus if cuda.devices else (cuda.problem or "none"),
        ok=bool(cuda.devices),
        gives="rendering on the GPU, together with OptiX",
    )
    yield Finding(
        name="OptiX",
        text="libnvoptix.so.1" if cuda.has_optix else "libnvoptix.so.1 cannot be loaded",
        ok=cuda.has_optix,
        gives="ray tracing on an NVIDIA GPU; it is part of the driver",
    )
    if llvm:
        yield _trial("llvm")
    if cuda.usable:
        yield _trial("cuda")
    try:
        device, ok = choose_device("auto"), True
    except DeviceError as error:
        device, ok = str(error), False
    yield Finding(name="device auto", text=device, ok=ok, gives="rendering at all", needed=True)


def _trial(device: str) -> Finding:
    """Return the result of rendering and denoising a small picture in its own process."""
    trial = try_device(device)
    where = {"cpu": "the processor", "cuda": "the GPU", None: ""}[trial.denoiser]
    return Finding(
        name=f"picture on {device}",
        text=trial.problem or f"rendered, and denoised on {where}, in {trial.seconds:.1f} s",
        ok=trial.problem is None,
        gives="rendering on this device",
    )


def _field(path: Path, key: str) -> str | None:
    """Return the value of a key in `key : value` lines; None if file or key does not exist."""
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == key:
            return value.strip()
    return None
