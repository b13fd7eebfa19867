"""The progress that the command line shows."""

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from graycast.base.progress import UNWATCHED, ProgressMeter
from graycast.cli.bars import Bars, open_bars


@pytest.fixture
def progress():
    return Progress(console=Console(file=io.StringIO(), width=60), auto_refresh=False)


def test_each_kind_of_progress_has_a_bar_and_the_stage_has_a_line_below_the_notes(progress):
    with Bars(progress) as bars:
        bars.stage("reading [red].stl")
        bars.count("scenes", 2, 5)
        bars.count("pictures", 1, 9)
        bars.count("scenes", 3, 5)
        bars.note("a part [is] coarse " + 60 * "-")
    assert [(task.completed, task.total) for task in progress.tasks] == [(0, None), (3, 5), (1, 9)]
    text = progress.console.file.getvalue()
    assert "note: a part [is] coarse " + 60 * "-" + "\n" in text
    assert all(words in text for words in ("scenes", "pictures")) and "reading" not in text


def test_a_stage_has_no_number_and_disappears_at_the_end(monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr("rich.progress.get_console", lambda: Console(file=file, width=90))
    with open_bars() as bars:
        bars.count("scenes", 1, 5)
        bars.stage("reading [red].stl")
        bars._progress.refresh()
        (line,) = [part for part in bars._progress.get_renderables()]
        console = Console(file=io.StringIO(), width=90)
        console.print(line)
        lines = console.file.getvalue().splitlines()
    assert "1/5" in lines[0] and "left" in lines[0]
    assert "reading [red].stl" in lines[1] and "?" not in lines[1] and "left" not in lines[1]
    assert "scenes" in file.getvalue() and "reading" not in file.getvalue()


def test_the_time_of_a_bar_starts_again_with_the_next_task_of_its_kind(progress):
    """Renders, for example, are counted from one again in the next scene."""
    bars = Bars(progress)
    bars.count("renders", 22, 22)
    first = progress.tasks[0]
    assert first.finished
    bars.count("renders", 1, 22)
    assert not first.finished and first.completed == 1 and first.start_time > 0


def test_bars_implement_the_protocol_of_progress_meters(progress):
    assert isinstance(Bars(progress), ProgressMeter) and isinstance(UNWATCHED, ProgressMeter)
