"""Messages of a long task to its caller, by way of an object that is handed down to it.

After the progress meters of diffrax: a task takes a `ProgressMeter`, and the caller chooses what is
done with it. The command line draws bars. What a meter raises ends the task.
"""

from collections.abc import Callable
from typing import Protocol, final, runtime_checkable


@runtime_checkable
class ProgressMeter(Protocol):
    """Receiver of a task's progress; it is called in the thread that waits for the task."""

    def stage(self, text: str) -> None:
        """Report that the task begins something that may take seconds; `text` says what."""
        ...

    def count(self, what: str, done: int, total: int) -> None:
        """Report that `done` of `total` are finished; earlier results count as finished."""
        ...

    def note(self, text: str) -> None:
        """Report something that the user should read, also after the task."""
        ...


@final
class Stages:
    """A `ProgressMeter` that passes the stages to a function and ignores the rest."""

    def __init__(self, hear: Callable[[str], None]) -> None:
        self.stage = hear

    def count(self, what: str, done: int, total: int) -> None: ...

    def note(self, text: str) -> None: ...


UNWATCHED = Stages(lambda text: None)
