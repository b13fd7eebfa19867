"""Memory of this process (from /proc, Linux) and load of the GPUs (from NVIDIA's NVML)."""

import resource
import threading
from pathlib import Path


def rss_bytes() -> int:
    """Return the memory that this process uses at present [bytes]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


class GpuWatch:
    """Sampler of the load of this machine's NVIDIA GPUs, while the `with` block runs.

    A GPU counts as busy while any process runs a kernel on it; NVML averages this over up to a
    second. Without a driver, nothing is sampled.
    """

    def __init__(self, period_s: float = 0.5) -> None:
        self._period_s, self._sum, self._count = period_s, 0.0, 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    @property
    def share(self) -> float | None:
        """Mean share of the time that a GPU was busy, 0 to 1; None before the first sample."""
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
            return  # Without a driver, `share` stays None.
        numbers = range(pynvml.nvmlDeviceGetCount())
        gpus = [pynvml.nvmlDeviceGetHandleByIndex(number) for number in numbers]
        while gpus and not self._ended.wait(self._period_s):
            busy = [pynvml.nvmlDeviceGetUtilizationRates(gpu).gpu / 100 for gpu in gpus]
            self._sum += sum(busy) / len(busy)
            self._count += 1
        pynvml.nvmlShutdown()
