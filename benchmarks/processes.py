"""Processor time and memory of this process and its child processes, from /proc (Linux)."""

import os
import resource
import time
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def children() -> list[int]:
    """Return the ids of the running child processes of this process."""
    pids = []
    for task in Path("/proc/self/task").iterdir():
        pids += [int(pid) for pid in (task / "children").read_text().split()]
    return pids


def cpu_s() -> float:
    """Return the processor time of this process, all threads, and of its running children."""
    return time.process_time() + sum(_cpu_s(pid) for pid in children())


def children_peak_rss_bytes() -> int:
    """Return the largest peak memory of a running child process; 0 without a child."""
    return max((_peak_rss_bytes(str(pid)) for pid in children()), default=0)


def peak_rss_bytes() -> int:
    """Return the peak memory of this process or, if larger, of a child process that has ended."""
    ended = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return max(_peak_rss_bytes("self"), ended)


def _peak_rss_bytes(pid: str) -> int:
    """Return the peak memory from /proc; `ru_maxrss` of a child would include its parent's."""
    words = Path(f"/proc/{pid}/status").read_text().split()
    # The line is missing if a child has just ended.
    return 1024 * int(words[words.index("VmHWM:") + 1]) if "VmHWM:" in words else 0


def _cpu_s(pid: int) -> float:
    # The process name in brackets may contain spaces. After it, fields 12 and 13 are the user and
    # system ticks.
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S
