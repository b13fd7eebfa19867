"""What a long task tells whoever waits for it; an object that is handed down to it.

After the progress meters of diffrax: a task takes a `ProgressMeter`, and the caller chooses what is
done with it. The command line draws bars. What a meter raises ends the task.
"""

from collections.abc import Callable
from typing import Protocol, final, runtime_checkable


@runtime_checkable
class ProgressMeter(Protocol):
    """Hears how far a task is, in the thread that waits for the task."""

    def stage(self, text: str) -> None:
        """The task begins something that may take seconds; `text` says what."""
        ...

    def count(self, what: str, done: int, total: int) -> None:
        """So many are done of all `what`, such as scenes; what was there before counts as done."""
        ...

    def note(self, text: str) -> None:
        """The user should read this, also after the task."""
        ...


@final
class Stages:
    """A `ProgressMeter` that passes the stages to a function and ignores the rest."""

    def __init__(self, hear: Callable[[str], None]) -> None:
        self.stage = hear

    def count(self, what: str, done: int, total: int) -> None: ...

    def note(self, text: str) -> None: ...


UNWATCHED = Stages(lambda text: None)
