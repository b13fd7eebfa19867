"""Check that `skips.txt` lists the reason of each test that a run skipped."""

import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path

import pytest


class Skips:
    """Plugin that lists the reasons at the end of a run, and fails the run for unlisted reasons.

    Args:
        file: a file with a line for each reason, as `tests/skips.txt` describes.
        lacks: features that this machine lacks, in the words of the file's first column.
    """

    def __init__(self, file: Path, lacks: Collection[str]):
        lines = [line.split(maxsplit=1) for line in file.read_text(encoding="utf-8").splitlines()]
        rules = [line for line in lines if line and not line[0].startswith("#")]
        unknown = set(lacks) - {where for where, _ in rules}
        if unknown:
            raise pytest.UsageError(f"--lacks names {', '.join(sorted(unknown))}, {file} does not")
        self._allowed = [re.compile(reason) for where, reason in rules if where in {*lacks, "any"}]
        self._file, self._count = file, Counter()

    def pytest_runtest_logreport(self, report):
        self._note(report)

    def pytest_collectreport(self, report):
        self._note(report)

    def _note(self, report):
        if report.skipped and not hasattr(report, "wasxfail"):
            self._count[report.longrepr[2].removeprefix("Skipped: ")] += 1

    def _is_allowed(self, reason):
        return any(pattern.search(reason) for pattern in self._allowed)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session):
        if session.exitstatus == 0 and not all(map(self._is_allowed, self._count)):
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter):
        if self._count:
            terminalreporter.section("tests that were skipped, by reason")
        for reason, count in sorted(self._count.items()):
            wrong = "" if self._is_allowed(reason) else f"  NOT ALLOWED HERE by {self._file}"
            terminalreporter.write_line(f"{count:4}  {reason}{wrong}")
