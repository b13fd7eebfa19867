"""A session without its process: settings and undo."""

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


@pytest.mark.slow
def test_undone_settings_cannot_be_redone_after_another_change(session):
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


@pytest.mark.slow
def test_consecutive_drafts_are_a_single_undo_step(session):
    session.set("ambient", 2.0)
    for ambient in (3.0, 4.0, 5.0):
        session.set("ambient", ambient, draft=True)
    assert where(session)[:2] == (5.0, 2)
    session.set("ambient", 6.0)  # The user releases the mouse button.
    assert where(session) == (6.0, 2, 0)
    session.undo()
    assert where(session) == (2.0, 1, 1)
    session.set("ambient", 7.0, draft=True)  # The user begins another movement.
    assert where(session) == (7.0, 2, 0)
