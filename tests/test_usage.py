"""Time and memory of this process and its children, against what they were made to use; GPUs."""

import mmap
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from graycast.bench import figures
from graycast.usage import GpuWatch, children, children_peak_rss_bytes, cpu_s, rss_bytes

WORK = """
import time
big = bytearray(80_000_000)
while time.process_time() < 0.3: sum(range(100_000))
print("done", flush=True)
input()
"""


@pytest.fixture
def worker():
    child = subprocess.Popen(
        [sys.executable, "-c", WORK], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    yield child
    child.kill()
    child.communicate()


def test_a_childs_time_and_memory_count(worker):
    """0.3 s of work; ticks of a hundredth. It may have begun before the first look."""
    before_s = cpu_s()
    assert worker.stdout.readline() == "done\n"
    assert worker.pid in children()
    assert 0.15 < cpu_s() - before_s < 1.0
    assert 80e6 < children_peak_rss_bytes() < 400e6


def test_memory_that_was_just_taken_is_there():
    """Mapped, not allocated: an allocator may hand out pages that are resident already."""
    before = rss_bytes()
    with mmap.mmap(-1, 50_000_000) as block:
        block.write(b"x" * len(block))
        assert rss_bytes() - before == pytest.approx(50e6, rel=0.1)


class NoDriver(Exception):
    pass


def fake_driver(busy):
    """The functions of NVML that are used, for GPUs that are busy by these percentages."""
    return SimpleNamespace(
        NVMLError=NoDriver,
        nvmlInit=lambda: None,
        nvmlShutdown=lambda: None,
        nvmlDeviceGetCount=lambda: len(busy),
        nvmlDeviceGetHandleByIndex=lambda number: number,
        nvmlDeviceGetUtilizationRates=lambda number: SimpleNamespace(gpu=next(busy[number])),
    )


def test_the_share_is_the_mean_over_gpus_and_samples(monkeypatch):
    """Oracle: by hand, (100 + 0) / 2 and (50 + 30) / 2, then 0.45 again and again."""
    first, second = iter([100, 50, *[45] * 1000]), iter([0, 30, *[45] * 1000])
    monkeypatch.setitem(sys.modules, "pynvml", fake_driver([first, second]))
    with GpuWatch(period_s=0.001) as gpu:
        while gpu.share is None:
            time.sleep(0.001)
        time.sleep(0.05)
    assert gpu.share == pytest.approx(0.45)


def test_without_a_driver_nothing_is_watched(monkeypatch):
    def missing():
        raise NoDriver

    driver = fake_driver([])
    driver.nvmlInit = missing
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    with GpuWatch(period_s=0.001) as gpu:
        time.sleep(0.01)
    assert gpu.share is None


def test_the_peak_is_that_of_the_process_that_did_the_work():
    """A process of 300 MB has ended: its memory was left out, and a small parent's was stated."""
    words = "x = bytearray(300_000_000); x[::4096] = x[::4096]"
    script = (
        "import subprocess, sys; from graycast.usage import peak_rss_bytes;"
        f"subprocess.run([sys.executable, '-c', {words!r}], check=True);"
        "print(peak_rss_bytes())"
    )
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert 300e6 < int(told.stdout) < 350e6


def test_a_benchmark_states_that_peak(monkeypatch):
    monkeypatch.setattr(figures, "peak_rss_bytes", lambda: 5)
    assert figures.stamped("x", {})["peak_rss_bytes"] == 5
