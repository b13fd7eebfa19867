"""Messages from a long task to its caller, through an object that the caller passes to it.

As in diffrax, a task takes a `ProgressMeter`, and the caller chooses how progress is shown. The
command line draws bars, and scripts get a line. An exception that a meter raises ends the task.
"""

from collections.abc import Callable
from typing import Protocol, final, runtime_checkable

MOST_COLUMNS = 78  # A longer line would be wrapped, and only its last row could be cleared.


@runtime_checkable
class ProgressMeter(Protocol):
    """Receiver of a task's progress; it is called in the thread that waits for the task."""

    def stage(self, text: str) -> None:
        """Report the start of a step that may take seconds; `text` describes this step."""
        ...

    def count(self, what: str, done: int, total: int) -> None:
        """Report that `done` of `total` items are finished; earlier results count as finished."""
        ...

    def note(self, text: str) -> None:
        """Report a message that the user should still be able to read after the task."""
        ...


@runtime_checkable
class TextStream(Protocol):
    """Receiver of text, such as `sys.stderr` or a notebook's stream, which is not a `TextIO`."""

    def write(self, text: str, /) -> object:
        """Write a text."""
        ...

    def flush(self) -> object:
        """Show the text that was written."""
        ...

    def isatty(self) -> bool:
        """Return whether a terminal shows the text."""
        ...


@final
class Stages:
    """A `ProgressMeter` that passes the stages to a function and ignores the rest."""

    def __init__(self, hear: Callable[[str], None]) -> None:
        self.stage = hear

    def count(self, what: str, done: int, total: int) -> None: ...

    def note(self, text: str) -> None: ...


@final
class StatusLine:
    """A `ProgressMeter` that shows one line in a terminal or notebook and clears it at the end."""

    def __init__(self, stream: TextStream) -> None:
        self._stream = stream
        self._counted = ""
        self._columns = 0

    def stage(self, text: str) -> None:
        self._show(f"graycast: {self._counted}{text} ...")

    def count(self, what: str, done: int, total: int) -> None:
        self._counted = f"{done} of {total} {what}; "
        self._show(f"graycast: {self._counted.removesuffix('; ')}")

    def note(self, text: str) -> None:
        self.clear()
        self._stream.write(f"graycast: note: {text}\n")

    def clear(self) -> None:
        """Clear the line, so that the next output begins on an empty line."""
        if self._columns:
            self._stream.write(f"\r{' ' * self._columns}\r")
            self._stream.flush()
        self._columns = 0

    def _show(self, text: str) -> None:
        self.clear()
        text = " ".join(text.split())[:MOST_COLUMNS]
        self._columns = len(text)
        self._stream.write(text)
        self._stream.flush()


def is_watched(stream: TextStream | None) -> bool:
    """Return whether a stream belongs to a terminal or a notebook, which shows text at once."""
    if stream is None:
        return False
    return stream.isatty() or type(stream).__module__.startswith("ipykernel")


UNWATCHED = Stages(lambda text: None)
