"""Time and memory of this process and its children, against what they were made to use."""

import mmap
import subprocess
import sys

import pytest

from graycast.usage import children, children_peak_rss_bytes, cpu_s, rss_bytes

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
