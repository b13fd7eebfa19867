"""What is installed on this machine, and what each missing piece is for."""

import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .. import __version__
from ..base.errors import DeviceError
from ..rendering.cycles import examine_cycles
from ..rendering.device import OLDEST_LLVM, choose_device, examine_cuda, find_llvm, list_llvm
from ..rendering.trial import try_device

_OLDEST_PYTHON = (3, 11)
_PACKAGES = {  # Each distribution has a text on what it gives.
    "numpy": "arrays, which every command needs",
    "mitsuba": "rendering",
    "drjit": "rendering",
    "numba": "fast decoding",
    "rapier3d": "dropping parts",
    "manifold3d": "convex decomposition of parts",
    "pyoidn": "denoised colour pictures on a processor",
}
_OPTIONAL = {  # Each distribution has the command that installs it, and what it gives.
    "torch": ("pip install 'graycast[detect]'", "detectors: detector train, find and study"),
    "torchvision": ("pip install 'graycast[detect]'", "detectors: --model mask-rcnn"),
    "onnx": ("pip install 'graycast[detect]'", "detectors: detector onnx"),
    "onnxruntime": ("pip install 'graycast[detect]'", "detectors: the check of detector onnx"),
    "libreyolo": ("pip install --no-deps libreyolo", "detectors: --model yolov7"),
    "rfdetr": ("pip install 'graycast[rf-detr]'", "detectors: --model rf-detr"),
    "pin": ("pip install 'graycast[pick]'", "robots: kinematics and collision"),
    "ompl": ("pip install 'graycast[pick]'", "robots: planning"),
    "toppra": ("pip install 'graycast[pick]'", "robots: timing of paths"),
    "scikit-learn": ("pip install 'graycast[twin]'", "real compare --classifier, and real twin"),
    "ray": ("pip install 'graycast[ray]'", "workers on a cluster: --engine ray"),
    "pyarrow": ("pip install 'graycast[parquet]'", "dataset export --format parquet"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One piece that was looked for; `gives` is what it is for. Not all pieces are needed."""

    name: str
    found: str
    ok: bool
    gives: str
    needed: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """All findings, in the order of reading."""

    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """Whether every needed piece was found."""
        return all(finding.ok for finding in self.findings if finding.needed)


def examine() -> Diagnosis:
    """Look for everything that Graycast can use; what may end a process is tried in a child."""
    return Diagnosis(findings=tuple((*_software(), *_machine(), *_devices())))


def describe(diagnosis: Diagnosis) -> str:
    """One line for each finding, and below a missing piece what it is for."""
    width = max(len(finding.name) for finding in diagnosis.findings)
    lines = []
    for finding in diagnosis.findings:
        mark = "ok" if finding.ok else ("MISSING" if finding.needed else "none")
        lines.append(f"{mark:8}{finding.name:{width}}  {finding.found}")
        if not finding.ok:
            lines.append(f"{'':8}{'':{width}}  it is for: {finding.gives}")
    lines.append(
        "ready"
        if diagnosis.ready
        else "This machine is not ready: install what is marked MISSING above."
    )
    return "\n".join(lines)


def _software() -> Iterator[Finding]:
    yield Finding(name="graycast", found=__version__, ok=True, gives="this program")
    yield Finding(
        name="Python",
        found=platform.python_version(),
        ok=tuple(map(int, platform.python_version_tuple()[:2])) >= _OLDEST_PYTHON,
        gives=f"Python {'.'.join(map(str, _OLDEST_PYTHON))} or newer runs Graycast",
    )
    for package, gives in _PACKAGES.items():
        yield _package(package, f"pip install {package}", gives, needed=True)
    for package, (command, gives) in _OPTIONAL.items():
        yield _package(package, command, gives, needed=False)


def _package(name: str, command: str, gives: str, *, needed: bool) -> Finding:
    try:
        found, ok = version(name), True
    except PackageNotFoundError:
        found, ok = f"not installed; run: {command}", False
    return Finding(name=name, found=found, ok=ok, gives=gives, needed=needed)


def _machine() -> Iterator[Finding]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    model = _field(Path("/proc/cpuinfo"), "model name") or platform.machine()
    yield Finding(name="CPU", found=f"{usable} cores, {model}", ok=True, gives="all computing")
    total, free = (_kib(key) for key in ("MemTotal", "MemAvailable"))
    amount, known = "unknown", False
    if total is not None and free is not None:
        known = True
        amount = f"{total / 2**20:.1f} GiB, {free / 2**20:.1f} GiB available"
    gives = "rendering, which needs about 4 GiB for a scene of 1032 x 772 pixels"
    yield Finding(name="memory", found=amount, ok=known, gives=gives, needed=False)


def _devices() -> Iterator[Finding]:
    libraries = ", ".join(f"{library.major} ({library.path})" for library in list_llvm())
    yield Finding(
        name="LLVM found",
        found=libraries or "none",
        ok=bool(libraries),
        gives=f"rendering on the processor, with version {OLDEST_LLVM} or newer",
        needed=False,
    )
    try:
        chosen = find_llvm()
        words = str(chosen) if chosen else f"no version {OLDEST_LLVM} or newer is installed"
    except DeviceError as error:
        chosen, words = None, str(error)
    gives = "rendering on the processor; rendering on a GPU does not need it"
    yield Finding(name="LLVM used", found=words, ok=bool(chosen), gives=gives, needed=False)

    cycles = examine_cycles()
    yield Finding(
        name="Blender Cycles",
        found=cycles.problem or f"bpy {cycles.version} ({cycles.python})",
        ok=cycles.usable,
        gives="a second renderer: --backend cycles",
        needed=False,
    )
    cuda = examine_cuda()
    gpus = f"{', '.join(cuda.devices)}; driver for CUDA {cuda.driver_cuda}"
    yield Finding(
        name="NVIDIA GPU",
        found=gpus if cuda.devices else (cuda.problem or "none"),
        ok=bool(cuda.devices),
        gives="rendering on the GPU, together with OptiX",
        needed=False,
    )
    yield Finding(
        name="OptiX",
        found="libnvoptix.so.1" if cuda.has_optix else "libnvoptix.so.1 cannot be loaded",
        ok=cuda.has_optix,
        gives="ray tracing on an NVIDIA GPU; it is part of the driver",
        needed=False,
    )
    if chosen:
        yield _trial("llvm")
    if cuda.usable:
        yield _trial("cuda")
    try:
        device, ok = choose_device("auto"), True
    except DeviceError as error:
        device, ok = str(error), False
    yield Finding(name="device auto", found=device, ok=ok, gives="rendering at all")


def _trial(device: str) -> Finding:
    """What came of a small picture, rendered and denoised in a process of its own."""
    trial = try_device(device)
    where = {"cpu": "the processor", "cuda": "the GPU", None: ""}[trial.denoiser]
    return Finding(
        name=f"picture on {device}",
        found=trial.problem or f"rendered, and denoised on {where}, in {trial.seconds:.1f} s",
        ok=trial.problem is None,
        gives="rendering on this device",
        needed=False,
    )


def _kib(key: str) -> int | None:
    text = _field(Path("/proc/meminfo"), key)
    return int(text.split()[0]) if text else None


def _field(path: Path, key: str) -> str | None:
    """The value of the first `key : value` line; None where the system has no such file."""
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == key:
            return value.strip()
    return None
