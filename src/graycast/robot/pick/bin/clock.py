"""Computing time in seconds by stage."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """A stopwatch: `with clock("plan"): ...` adds the elapsed time to the stage "plan"."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
