"""A session without its process: what is set, and the way back."""

import pytest
from small_cell import write_cell

from graycast.show.live.session import Session


@pytest.fixture
def session(tmp_path):
    session = Session(write_cell(tmp_path), device="cpu")
    yield session
    session.close()


def where(session):
    state = session.state()
    return state["values"]["ambient"], state["undo"], state["redo"]


def test_what_was_undone_is_gone_once_something_else_is_set(session):
    for ambient in (2.0, 3.0, 4.0):
        session.set("ambient", ambient)
    session.undo(2)
    assert where(session) == (2.0, 1, 2)
    session.undo(-1)
    assert where(session) == (3.0, 2, 1)
    session.set("ambient", 5.0)
    assert where(session) == (5.0, 3, 0)
    session.undo(-7)
    assert where(session) == (5.0, 3, 0)
    session.undo(7)
    assert where(session) == (1.0, 0, 3)


def test_drafts_in_a_row_are_one_step_of_undo(session):
    session.set("ambient", 2.0)
    for ambient in (3.0, 4.0, 5.0):
        session.set("ambient", ambient, draft=True)
    assert where(session)[:2] == (5.0, 2)
    session.set("ambient", 6.0)  # the hand lets go
    assert where(session) == (6.0, 2, 0)
    session.undo()
    assert where(session) == (2.0, 1, 1)
    session.set("ambient", 7.0, draft=True)  # another hand
    assert where(session) == (7.0, 2, 0)
