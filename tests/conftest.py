"""Fixtures of all tests: the render device of the process, and shared data."""

import gc
import os
import shutil
import signal
from pathlib import Path

import pytest

# Background runs ignore Ctrl-C, and processes that tests interrupt would inherit this setting.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Imports create many permanent objects. Repeated garbage collection over these objects took a
# quarter of the time of test collection.
gc.set_threshold(100_000, 20, 100)

# Parallel workers (-n) that all use every core wait for each other, which took a third of the
# processor time. The threads of NumPy must be set before it is loaded; the others are set below.
# PyTorch's threads (also in child processes) spin while they wait: two threads took eight times as
# long as one. The threads of the denoiser would use the same cores in each worker.
BESIDE_OTHERS = "PYTEST_XDIST_WORKER" in os.environ
if BESIDE_OTHERS:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OIDN_NUM_THREADS", "1")
    os.environ.setdefault("OIDN_SET_AFFINITY", "0")


def pytest_addoption(parser):
    parser.addoption(
        "--device",
        default="cpu",
        choices=("cpu", "cuda"),
        help="The device on which Mitsuba renders in the tests of one process.",
    )
    parser.addoption(
        "--made-on-cpu",
        type=Path,
        metavar="DATASET",
        help="Scenes of the demonstration made by a processor; tests/gpu/README.md says how.",
    )
    parser.addoption(
        "--skips-allowed",
        type=Path,
        metavar="FILE",
        help="List the skipped tests, and fail where this file does not allow a reason.",
    )
    parser.addoption(
        "--lacks",
        default="",
        metavar="WORDS",
        help="What this machine lacks, in the words of the file's first column.",
    )


def pytest_configure(config):
    file = config.getoption("--skips-allowed")
    if file is not None and not BESIDE_OTHERS:  # Only the main process receives all reports.
        from skips import Skips

        config.pluginmanager.register(Skips(file, config.getoption("--lacks").split()))


def pytest_collection_finish():
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def one_thread_beside_others():
    """Let Numba use a single thread; tests of threads set the number themselves."""
    if BESIDE_OTHERS:
        import numba

        numba.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def one_compiler_beside_others(tmp_path_factory):
    """Compile each kernel only once: Numba takes a third of the CPU time in a fresh clone."""
    if not BESIDE_OTHERS:
        yield
        return
    from one_compiler import one_compiler_a_kernel

    folder = tmp_path_factory.getbasetemp().parent / "kernels"
    folder.mkdir(exist_ok=True)
    with one_compiler_a_kernel(folder):
        yield


@pytest.fixture(scope="session")
def mitsuba_renderer(request):
    """Return Mitsuba on the run's device (CPU by default), which a process cannot change."""
    from graycast.rendering import open_renderer

    return open_renderer("mitsuba", device=request.config.getoption("--device"))


@pytest.fixture(scope="session")
def cpu_device(mitsuba_renderer):
    """Prepare Mitsuba for tests that call it directly."""


@pytest.fixture(scope="session")
def cycles_renderer():
    """Return Blender's Cycles, in a child process that ends with the tests."""
    from graycast.rendering import open_renderer
    from graycast.rendering.cycles import examine_cycles

    state = examine_cycles()
    if not state.usable:
        pytest.skip(state.problem)
    with open_renderer("cycles", device="cpu") as renderer:
        yield renderer


@pytest.fixture(scope="session")
def robots():
    """Require the robot libraries, for tests that plan, move or check collisions."""
    for name in ("pinocchio", "coal", "ompl", "toppra"):
        pytest.importorskip(name, reason=f"needs {name}: pip install 'graycast[pick]'")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the folder of test data next to the repository; skip the test if it is missing."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("needs ../shared/data beside the repository, which is not here")
    return folder.parent


# The browser has no display, and draws WebGL on the processor.
BROWSER_FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="session")
def browser():
    """Return the installed Chromium; nothing is downloaded."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="needs playwright: pip install 'graycast[test]'"
    )
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("needs chromium: apt-get install chromium")
    with playwright.sync_playwright() as running:
        yield running.chromium.launch(executable_path=path, args=BROWSER_FLAGS)
