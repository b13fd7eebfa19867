"""Find the render devices that work, and open a device without the risk of a crash.

Dr.Jit compiles its kernels with a shared LLVM on a processor, and with NVIDIA's driver on a GPU. It
reads `DRJIT_LIBLLVM_PATH` once, when it is imported, and accepts LLVM 15 and 16. But on some
processors these versions abort the whole process during code generation (Dr.Jit 1.5 refuses 14). So
this module chooses the library by its file name and sets the variable before it imports Dr.Jit.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..base.errors import DeviceError

OLDEST_LLVM = 19  # Versions 15 and 16 are known to abort; 17 and 18 are untested.
DEVICES = ("auto", "cpu", "llvm", "cuda")

_VARIANT = {"llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}
_USER_CHOICE = "DRJIT_LIBLLVM_PATH"
# The pattern matches libLLVM-19.so, libLLVM-19.so.1, libLLVM-14.0.6.so.1 and libLLVM.so.22.1, but
# not a compiler's reduced copy, such as libLLVM-19-rust-1.82.0.so.
_LLVM_NAME = re.compile(r"libLLVM(?:-(\d+)[\d.]*\.so[\d.]*|\.so\.(\d+)[\d.]*)")
_LLVM_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib",
    "/usr/lib",
    "/usr/local/lib",
    "/usr/local/lib64",
)
_CHILD_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LlvmLibrary:
    """A shared LLVM library on this machine, with its resolved path."""

    path: Path
    major: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CudaState:
    """The state of NVIDIA's driver; without a GPU, `devices` is empty and `problem` says why."""

    devices: tuple[str, ...] = ()
    driver_cuda: str | None = None
    has_optix: bool = False
    problem: str | None = None

    @property
    def usable(self) -> bool:
        return bool(self.devices) and self.has_optix


def list_llvm(folders: Iterable[Path] | None = None) -> tuple[LlvmLibrary, ...]:
    """Return the LLVM libraries for this processor whose file name states a version, newest first.

    Args:
        folders: folders to search; None: the usual folders of Linux, the linker's cache and conda.
    """
    files = _linker_cache() if folders is None else []
    for folder in _usual_folders() if folders is None else folders:
        files += folder.glob("libLLVM*.so*")
    libraries, own = [], _elf_kind(Path(sys.executable))
    for path in dict.fromkeys(file.resolve() for file in files):
        major = _major_from_name(path)
        if major is not None and own is not None and _elf_kind(path) == own:
            libraries.append(LlvmLibrary(path=path, major=major))
    return tuple(sorted(libraries, key=lambda library: (-library.major, str(library.path))))


def find_llvm(folders: Iterable[Path] | None = None) -> Path | None:
    """Return the LLVM to use: the user's `DRJIT_LIBLLVM_PATH`, else the newest suitable, or None.

    No library is loaded into this process, because an old one can abort it.

    Raises:
        DeviceError: `DRJIT_LIBLLVM_PATH` names a file that is missing, unknown or too old.
    """
    choice = os.environ.get(_USER_CHOICE)
    if choice:
        return _accept_user_choice(choice)
    newest = next(iter(list_llvm(folders)), None)
    return newest.path if newest is not None and newest.major >= OLDEST_LLVM else None


def examine_cuda() -> CudaState:
    """Ask NVIDIA's driver for its devices in a child process; a process cannot fork afterwards."""
    try:
        child = _run_child(_ASK_CUDA)
    except (OSError, subprocess.SubprocessError) as error:
        return CudaState(problem=f"asking the NVIDIA driver failed: {error}")
    if child.returncode != 0:
        return CudaState(
            problem=f"the NVIDIA driver ended the process that asked it ({child.returncode})"
        )
    answer = json.loads(child.stdout)
    return CudaState(**answer | {"devices": tuple(answer["devices"])})


def choose_device(name: str) -> str:
    """Return the device to render on: 'llvm' or 'cuda'.

    Args:
        name: 'cpu' is the same as 'llvm'; 'auto' is CUDA with a GPU and OptiX, else LLVM.

    Raises:
        DeviceError: the device is not available; the message ends with the remedy.
        ValueError: there is no such name.
    """
    if name == "optix":
        raise ValueError(
            "device optix exists only for Cycles (--backend cycles): for Mitsuba choose auto, "
            "cpu or cuda, which also uses OptiX"
        )
    if name not in DEVICES:
        raise ValueError(f"the device {name!r} does not exist: choose one of {', '.join(DEVICES)}")
    if name in ("auto", "cuda"):
        why = _why_not_cuda()
        if why is None:
            return "cuda"
        if name == "cuda":
            raise DeviceError(
                f"device cuda cannot be used: {why}; use --device cpu or repair the driver"
            )
    if find_llvm() is None:
        raise DeviceError(_no_llvm())
    return "llvm"


def _why_not_cuda() -> str | None:
    """Return the reason why the GPU cannot render, or None if it can."""
    state = examine_cuda()
    if not state.usable:
        return state.problem or "libnvoptix.so.1 cannot be loaded"
    from .trial import tried_before

    return tried_before("cuda", state).problem


def open_device(device: str, *, threads: int | None = None) -> None:
    """Make Mitsuba run on a device in this process; opening the same device again is harmless.

    It sets `DRJIT_LIBLLVM_PATH` in the environment of this process, imports Mitsuba, and sets the
    variant `llvm_ad_rgb` or `cuda_ad_rgb`.

    Args:
        device: 'llvm' or 'cuda', as `choose_device` returns it.
        threads: worker threads of the LLVM device, at least 1; None is Dr.Jit's choice.

    Raises:
        DeviceError: the device cannot be opened, another variant is active in this process, or
            Dr.Jit was imported before with an LLVM that is too old.
        ValueError: there is no such device, or `threads` is below 1.
    """
    if device not in _VARIANT:
        raise ValueError(f"the device {device!r} cannot be opened: choose {' or '.join(_VARIANT)}")
    if threads is not None and threads < 1:
        raise ValueError(f"threads is {threads}; it must be at least 1")
    if device == "llvm" and "drjit" not in sys.modules:
        library = find_llvm()
        if library is None:
            raise DeviceError(_no_llvm())
        os.environ[_USER_CHOICE] = str(library)
    import drjit as dr
    import mitsuba as mi

    variant = _VARIANT[device]
    if mi.variant() not in (None, variant):
        active = f"this process already renders with {mi.variant()}"
        raise DeviceError(f"{active}; start another process for {variant}")
    if device == "llvm":
        _check_loaded_llvm(dr)
    if mi.variant() is None:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            first_line = str(error).strip().split("\n")[0]
            raise DeviceError(f"device {device} cannot be opened: {first_line}") from error
    if threads is not None:
        dr.set_thread_count(threads)


def _check_loaded_llvm(dr) -> None:
    """Check, before any code generation, that Dr.Jit has loaded a new enough LLVM."""
    if not dr.has_backend(dr.JitBackend.LLVM):
        library = os.environ.get(_USER_CHOICE)
        why = f"{library} cannot be loaded" if library else "drjit was imported before open_device"
        remedy = f"call open_device first, with a working libllvm{OLDEST_LLVM} installed"
        raise DeviceError(f"Dr.Jit has no LLVM: {why}; {remedy}")
    version = dr.detail.llvm_version()
    if version[0] < OLDEST_LLVM:
        loaded = f"Dr.Jit was imported with LLVM {'.'.join(map(str, version))}"
        need = f"{OLDEST_LLVM} or newer is needed"
        raise DeviceError(f"{loaded}, {need}: call open_device before importing drjit")


def _accept_user_choice(choice: str) -> Path:
    path = Path(choice)
    remedy = f"unset {_USER_CHOICE}, or set it to an LLVM of version {OLDEST_LLVM} or newer"
    if "/" in choice and not path.is_file():
        raise DeviceError(f"{_USER_CHOICE} names {choice}, which is not a file: {remedy}")
    major = _major_from_name(path.resolve()) or _major_from_child(choice)
    if major is None:
        raise DeviceError(f"{_USER_CHOICE} names {choice}, whose version is unknown: {remedy}")
    if major < OLDEST_LLVM:
        danger = f"LLVM {major}, which can crash the process during code generation"
        raise DeviceError(f"{_USER_CHOICE} names {choice}, {danger}: {remedy}")
    return path


def _no_llvm() -> str:
    old = sorted({library.major for library in list_llvm()})
    only = f" (found only {', '.join(map(str, old))}, too old)" if old else ""
    if shutil.which("apt-get") is None:
        remedy = f"install a shared LLVM {OLDEST_LLVM} with the system's package manager"
    else:
        sudo = "" if os.geteuid() == 0 else "sudo "
        remedy = f"run: {sudo}apt-get install libllvm{OLDEST_LLVM}"
    return (
        f"rendering on the processor needs a shared LLVM {OLDEST_LLVM} or newer, which was not "
        f"found{only}; {remedy}"
    )


def _major_from_name(path: Path) -> int | None:
    match = _LLVM_NAME.fullmatch(path.name)
    return int(match.group(1) or match.group(2)) if match else None


def _major_from_child(name: str) -> int | None:
    """Return the version that a library reports in a child process; None for versions before 16."""
    try:
        child = _run_child(_ASK_LLVM, name)
    except (OSError, subprocess.SubprocessError):
        return None
    return int(child.stdout) if child.returncode == 0 else None


def _run_child(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-I", "-S", "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=_CHILD_LIMIT_S)


def _usual_folders() -> list[Path]:
    root = Path("/")
    folders = [p for pattern in _LLVM_FOLDERS for p in root.glob(pattern.lstrip("/"))]
    # Find a conda environment by Python's prefix or, with another Python, by its variable.
    conda = os.environ.get("CONDA_PREFIX")
    folders += [Path(prefix) / "lib" for prefix in {sys.prefix, sys.base_prefix, conda} if prefix]
    return folders


def _linker_cache() -> list[Path]:
    ldconfig = shutil.which("ldconfig") or shutil.which("ldconfig", path="/sbin:/usr/sbin")
    if ldconfig is None:
        return []
    listing = subprocess.run([ldconfig, "-p"], capture_output=True, text=True).stdout
    return [Path(path) for path in re.findall(r"^\s*libLLVM\S* .*=> (/\S+)$", listing, re.M)]


def _elf_kind(path: Path) -> bytes | None:
    """Return word size, byte order and machine of an ELF file from its header, or None."""
    try:
        with path.open("rb") as file:
            header = file.read(20)
    except OSError:
        return None
    # In an ELF header, bytes 4 and 5 give class and byte order, and bytes 18 and 19 the machine.
    whole = len(header) == 20 and header[:4] == b"\x7fELF"
    return header[4:6] + header[18:20] if whole else None


_ASK_LLVM = """
import ctypes, sys
major = ctypes.c_uint()
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(ctypes.byref(major), None, None)
print(major.value)
"""

_ASK_CUDA = """
import ctypes, json
answer = {"devices": [], "driver_cuda": None, "has_optix": False, "problem": None}
try:
    ctypes.CDLL("libnvoptix.so.1")
    answer["has_optix"] = True
except OSError:
    pass
try:
    cuda = ctypes.CDLL("libcuda.so.1")
except OSError:
    answer["problem"] = "no NVIDIA driver (libcuda.so.1 does not load)"
else:
    version, count, status = ctypes.c_int(), ctypes.c_int(), cuda.cuInit(0)
    if cuda.cuDriverGetVersion(ctypes.byref(version)) == 0:
        answer["driver_cuda"] = f"{version.value // 1000}.{version.value % 1000 // 10}"
    if status == 0:
        status = cuda.cuDeviceGetCount(ctypes.byref(count))
    for i in range(count.value):
        device, name = ctypes.c_int(), ctypes.create_string_buffer(256)
        cuda.cuDeviceGet(ctypes.byref(device), i)
        cuda.cuDeviceGetName(name, 256, device)
        answer["devices"].append(name.value.decode(errors="replace"))
    if status != 0:
        answer["problem"] = f"the NVIDIA driver answers with error {status}"
    elif count.value == 0:
        answer["problem"] = "the NVIDIA driver sees no GPU"
print(json.dumps(answer))
"""
