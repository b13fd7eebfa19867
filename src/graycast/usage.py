"""What this process and its children have used, by the kernel's files under /proc (Linux)."""

import os
import resource
import time
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def rss_bytes() -> int:
    """Memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def children() -> list[int]:
    """The processes that this one has started and that are alive."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        found += [int(pid) for pid in (task / "children").read_text().split()]
    return found


def cpu_s() -> float:
    """Processor time of this process and its living children, all threads."""
    return time.process_time() + sum(_cpu_s(pid) for pid in children())


def children_peak_rss_bytes() -> int:
    """The largest memory that a living child has had; 0 without one."""
    peaks = [0]
    for pid in children():
        words = Path(f"/proc/{pid}/status").read_text().split()
        if "VmHWM:" in words:  # a child that has just ended has none
            peaks.append(1024 * int(words[words.index("VmHWM:") + 1]))
    return max(peaks)


def _cpu_s(pid: int) -> float:
    # The name in brackets may hold blanks; user and system ticks are the 12th and 13th after it.
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S
