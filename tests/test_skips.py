"""A test that is skipped for an unlisted reason fails the run of `.ci/run`."""

from types import SimpleNamespace

import pytest
from skips import Skips

LIST = "# a comment\nany     this machine has a GPU\nextras  needs torch\n"


def finished(folder, reason, lacks):
    """Return the exit status and the last lines of a run in which one test is skipped."""
    (folder / "skips.txt").write_text(LIST, encoding="utf-8")
    skips = Skips(folder / "skips.txt", lacks)
    skips.pytest_runtest_logreport(
        SimpleNamespace(skipped=True, longrepr=("test_x.py", 1, f"Skipped: {reason}"))
    )
    skips.pytest_runtest_logreport(SimpleNamespace(skipped=False))
    session, lines = SimpleNamespace(exitstatus=0), []
    skips.pytest_sessionfinish(session)
    skips.pytest_terminal_summary(SimpleNamespace(section=lines.append, write_line=lines.append))
    return session.exitstatus, lines[1:]


def test_a_skip_for_a_listed_reason_passes_on_a_machine_without_the_feature(tmp_path):
    assert finished(tmp_path, "needs torch: pip install", ["extras"]) == (
        0,
        ["   1  needs torch: pip install"],
    )
    assert finished(tmp_path, "this machine has a GPU", [])[0] == 0


@pytest.mark.parametrize("reason", ["needs torch: pip install", "needs something else"])
def test_a_skip_for_an_unlisted_reason_fails_the_run(tmp_path, reason):
    status, (line,) = finished(tmp_path, reason, [])
    assert status == 1
    assert "NOT ALLOWED HERE" in line


def test_a_missing_feature_that_is_not_on_the_list_is_refused(tmp_path):
    with pytest.raises(pytest.UsageError, match="extra"):
        finished(tmp_path, "", ["extra"])
