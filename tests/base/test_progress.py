"""The line of progress that public functions show in a terminal or a notebook."""

import io
import sys

import pytest

from graycast.base.argument_check import checked
from graycast.base.progress import MOST_COLUMNS, UNWATCHED, ProgressMeter, Stages, StatusLine


class Terminal(io.StringIO):
    def isatty(self):
        return True


class OutStream(io.StringIO):
    """Output stream of a notebook, which is not a terminal."""


OutStream.__module__ = "ipykernel.iostream"


def work(*, progress: ProgressMeter = UNWATCHED) -> str:
    progress.stage("compiling\nthe decoder")
    progress.count("scenes", 1, 3)
    progress.stage("rendering " * 30)
    return "done"


def each(count: int, *, progress: ProgressMeter = UNWATCHED):
    for k in range(count):
        progress.stage(f"scene {k}")
        yield k


def last_row(text):
    """Return the last row that a terminal shows after these characters."""
    row = []
    for part in text.rsplit("\n", 1)[-1].split("\r"):
        row[: len(part)] = part
    return "".join(row).rstrip()


@pytest.mark.parametrize("stream", [Terminal(), OutStream()], ids=["terminal", "notebook"])
def test_a_progress_line_is_shown_in_a_terminal_and_removed_at_the_end(stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    assert checked(work)() == "done"
    text = stream.getvalue()
    assert "graycast: compiling the decoder ..." in text and "graycast: 1 of 3 scenes" in text
    assert "\n" not in text and last_row(text) == ""
    assert max(map(len, text.split("\r"))) <= MOST_COLUMNS


def test_no_progress_line_is_shown_in_a_pipe_or_to_a_caller_with_a_meter(monkeypatch):
    pipe, heard = io.StringIO(), []
    monkeypatch.setattr(sys, "stderr", pipe)
    checked(work)()
    assert list(checked(each)(2)) == [0, 1]
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    checked(work)(progress=Stages(heard.append))
    assert pipe.getvalue() == terminal.getvalue() == "" and len(heard) == 2


def test_text_printed_inside_a_loop_starts_on_an_empty_line(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    for k in checked(each)(3):
        assert f"graycast: scene {k} ..." in terminal.getvalue()
        assert last_row(terminal.getvalue()) == ""
        terminal.write(f"own line {k}\n")
    assert last_row(terminal.getvalue()) == ""


def test_breaking_out_of_a_loop_closes_its_iterator(monkeypatch):
    closed = []

    def scenes(*, progress: ProgressMeter = UNWATCHED):
        try:
            yield 1
            yield 2
        finally:
            closed.append(True)

    monkeypatch.setattr(sys, "stderr", Terminal())
    loop = checked(scenes)()
    assert next(loop) == 1
    loop.close()
    assert closed == [True]


def test_a_note_remains_above_the_progress_line():
    terminal = Terminal()
    line = StatusLine(terminal)
    line.stage("falling")
    line.note("coarse hulls")
    line.stage("rendering")
    assert terminal.getvalue().count("graycast: note: coarse hulls\n") == 1
    assert last_row(terminal.getvalue()) == "graycast: rendering ..."
