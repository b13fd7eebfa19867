"""What this process, its children and the GPUs have used: /proc (Linux), and NVIDIA's NVML."""

import os
import resource
import threading
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
    return max((_peak_rss_bytes(str(pid)) for pid in children()), default=0)


def peak_rss_bytes() -> int:
    """The largest memory that this process has had, or one that it started and that has ended."""
    ended = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return max(_peak_rss_bytes("self"), ended)


def _peak_rss_bytes(pid: str) -> int:
    """Of the program that runs: the kernel's `ru_maxrss` of a child includes its parent's."""
    words = Path(f"/proc/{pid}/status").read_text().split()
    # A child that has just ended has none.
    return 1024 * int(words[words.index("VmHWM:") + 1]) if "VmHWM:" in words else 0


def _cpu_s(pid: int) -> float:
    # The name in brackets may hold blanks; user and system ticks are the 12th and 13th after it.
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S


class GpuWatch:
    """Samples how busy this machine's NVIDIA GPUs are, while the `with` block runs.

    A GPU counts as busy while a kernel runs on it, whoever started that; NVML means this over up
    to a second. Without a driver there is nothing to watch.
    """

    def __init__(self, period_s: float = 0.5) -> None:
        self._period_s, self._sum, self._count = period_s, 0.0, 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    @property
    def share(self) -> float | None:
        """The mean share of the time that a GPU was busy, 0 to 1; None before the first sample."""
        return self._sum / self._count if self._count else None

    def __enter__(self) -> "GpuWatch":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        import pynvml

        try:
            pynvml.nvmlInit()
        except pynvml.NVMLError:
            return  # no driver: `share` stays None
        numbers = range(pynvml.nvmlDeviceGetCount())
        gpus = [pynvml.nvmlDeviceGetHandleByIndex(number) for number in numbers]
        while gpus and not self._ended.wait(self._period_s):
            busy = [pynvml.nvmlDeviceGetUtilizationRates(gpu).gpu / 100 for gpu in gpus]
            self._sum += sum(busy) / len(busy)
            self._count += 1
        pynvml.nvmlShutdown()
