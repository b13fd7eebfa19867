"""The memory that this process uses, and the load of GPUs."""

import mmap
import sys
import time
from types import SimpleNamespace

import pytest

from graycast.base.usage import GpuWatch, rss_bytes


def test_resident_memory_includes_newly_mapped_pages():
    """The memory is mapped, because an allocator may return pages that are already resident."""
    before = rss_bytes()
    with mmap.mmap(-1, 50_000_000) as block:
        block.write(b"x" * len(block))
        assert rss_bytes() - before == pytest.approx(50e6, rel=0.1)


class NoDriver(Exception):
    pass


def fake_driver(busy):
    """Return the functions of NVML that are used, for GPUs with these loads in percent."""
    return SimpleNamespace(
        NVMLError=NoDriver,
        nvmlInit=lambda: None,
        nvmlShutdown=lambda: None,
        nvmlDeviceGetCount=lambda: len(busy),
        nvmlDeviceGetHandleByIndex=lambda number: number,
        nvmlDeviceGetUtilizationRates=lambda number: SimpleNamespace(gpu=next(busy[number])),
    )


def test_the_reported_gpu_load_is_the_mean_over_gpus_and_samples(monkeypatch):
    """Oracle, by hand: (100 + 0) / 2, (50 + 30) / 2, and then 0.45 repeatedly."""
    first, second = iter([100, 50, *[45] * 1000]), iter([0, 30, *[45] * 1000])
    monkeypatch.setitem(sys.modules, "pynvml", fake_driver([first, second]))
    with GpuWatch(period_s=0.001) as gpu:
        while gpu.share is None:
            time.sleep(0.001)
        time.sleep(0.05)
    assert gpu.share == pytest.approx(0.45)


def test_a_missing_gpu_driver_gives_no_gpu_load(monkeypatch):
    def missing():
        raise NoDriver

    driver = fake_driver([])
    driver.nvmlInit = missing
    monkeypatch.setitem(sys.modules, "pynvml", driver)
    with GpuWatch(period_s=0.001) as gpu:
        time.sleep(0.01)
    assert gpu.share is None
