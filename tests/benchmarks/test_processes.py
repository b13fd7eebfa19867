"""Processor time and memory of a process and its children, compared with known values.

Each case runs in its own process, since the test runner may have other children.
"""

import subprocess
import sys

import pytest

CHILD = """
import time
big = bytearray(80_000_000)
while time.process_time() < 0.3: sum(range(100_000))
print("done", flush=True)
input()
"""
PARENT = f"""
import subprocess, sys
from benchmarks.processes import children, children_peak_rss_bytes, cpu_s
child = subprocess.Popen(
    [sys.executable, "-c", {CHILD!r}], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
)
before_s = cpu_s()
assert child.stdout.readline() == "done\\n"
assert children() == [child.pid]
print(cpu_s() - before_s, children_peak_rss_bytes())
child.communicate("\\n")
"""
PARENT_OF_AN_ENDED_CHILD = """
import subprocess, sys
from benchmarks.processes import peak_rss_bytes
child = "x = bytearray(600_000_000); x[::4096] = x[::4096]"
subprocess.run([sys.executable, "-c", child], check=True)
print(peak_rss_bytes())
"""


def _printed(script: str) -> list[float]:
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return [float(word) for word in run.stdout.split()]


@pytest.mark.slow
def test_time_and_memory_of_a_child_process_are_counted():
    """The child computes for 0.3 s, perhaps partly before the first reading. Ticks are 10 ms."""
    used_s, peak_bytes = _printed(PARENT)
    assert 0.15 < used_s < 1.0
    assert 80e6 < peak_bytes < 400e6


@pytest.mark.slow
def test_the_peak_memory_of_a_benchmark_is_that_of_its_worker_process():
    """The child used 600 MB and has ended. Its peak counts, not that of the small parent."""
    (peak_bytes,) = _printed(PARENT_OF_AN_ENDED_CHILD)
    assert 600e6 < peak_bytes < 700e6
