"""The memory of this process against what it was made to use, and how busy GPUs are."""

import mmap
import sys
import time
from types import SimpleNamespace

import pytest

from graycast.base.usage import GpuWatch, rss_bytes


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
