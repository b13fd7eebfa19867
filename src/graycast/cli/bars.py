"""Progress bars of the command line, with the remaining time."""

from types import TracebackType
from typing import TYPE_CHECKING, final

from rich.markup import escape

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress, TaskID

# The rest of rich is imported only when bars are drawn, so that --help answers at once.


@final
class Bars:
    """A `ProgressMeter` that shows a bar for each counted kind, and the current stage.

    Use `line` to print text, so that text and bars do not overwrite each other.
    """

    def __init__(self, progress: "Progress") -> None:
        self._progress = progress
        self._tasks: dict[str | None, TaskID] = {}  # stages have the kind ""

    def stage(self, text: str) -> None:
        self._progress.reset(self._task(None), description=escape(text), total=None, visible=True)

    def count(self, what: str, done: int, total: int) -> None:
        task = self._task(what)
        before = self._progress.tasks[self._progress.task_ids.index(task)]
        if done < before.completed:  # the next bar of the same kind; its time starts again
            self._progress.reset(task)
        self._progress.update(task, completed=done, total=total, visible=True)

    def note(self, text: str) -> None:
        self.line(f"note: {text}")

    def line(self, text: str) -> None:
        """Print a line above the bars."""
        self._progress.console.print(text, markup=False, soft_wrap=True)

    def _task(self, what: str | None) -> "TaskID":
        if what not in self._tasks:
            self._tasks[what] = self._progress.add_task(
                escape(what or ""), total=None, visible=False
            )
        return self._tasks[what]

    def __enter__(self) -> "Bars":
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if None in self._tasks:  # no stage is active
            self._progress.update(self._tasks[None], visible=False)
        self._progress.stop()


def open_bars() -> Bars:
    """Return progress bars that stay visible after the end."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class OfCounted(ProgressColumn):
        """A column that is empty for a stage, because a stage has no count and no known end."""

        def __init__(self, column: ProgressColumn) -> None:
            super().__init__()
            self.column = column

        def render(self, task: Task) -> "RenderableType":
            return Text() if task.total is None else self.column(task)

    return Bars(
        Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            OfCounted(MofNCompleteColumn()),
            TimeElapsedColumn(),
            OfCounted(TextColumn("left")),
            OfCounted(TimeRemainingColumn()),
        )
    )


def open_stages() -> Bars:
    """Return a line with the current stage and its duration, which disappears at the end."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    return Bars(Progress(*columns, transient=True))
