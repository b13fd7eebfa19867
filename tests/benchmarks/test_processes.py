"""Time and memory of this process and its children, compared with known use."""

import subprocess
import sys

import pytest

from benchmarks.processes import children, children_peak_rss_bytes, cpu_s

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


@pytest.mark.slow
def test_a_childs_time_and_memory_count(worker):
    """The child works for 0.3 s, partly perhaps before the first look; ticks are of 0.01 s."""
    before_s = cpu_s()
    assert worker.stdout.readline() == "done\n"
    assert worker.pid in children()
    assert 0.15 < cpu_s() - before_s < 1.0
    assert 80e6 < children_peak_rss_bytes() < 400e6


@pytest.mark.slow
def test_a_benchmark_s_peak_is_that_of_the_process_that_did_the_work():
    """A child of 600 MB has ended: the peak must be its peak, not that of the small parent."""
    words = "x = bytearray(600_000_000); x[::4096] = x[::4096]"
    script = (
        "import subprocess, sys; from benchmarks.processes import peak_rss_bytes;"
        f"subprocess.run([sys.executable, '-c', {words!r}], check=True);"
        "print(peak_rss_bytes())"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 600e6 < int(run.stdout) < 700e6
