"""Computing time in seconds by stage."""

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """`with clock("plan"): ...` adds the time to that stage's."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
