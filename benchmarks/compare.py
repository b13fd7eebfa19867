"""Comparison of the time of every stage between the working tree and another commit.

Times of different days cannot be compared, because the load of a shared machine may change them by
more than a commit does. So both trees run in turn, and the result is the ratio within a round.
"""

import importlib.metadata
import json
import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from graycast.base.tables import markdown_table

SLOWER = 1.05  # A stage with a larger ratio is marked.
LEAST_ROUNDS = 2
SIDES = ("here", "there")
Record = dict[str, Any]  # one line of output of `stages.py`, with its `side` and `round`


class CompareError(Exception):
    """Error if the comparison cannot be made; the text ends with the remedy."""


def compare(
    root: Path,
    rev: str,
    *,
    stages: Sequence[str],
    minutes: float,
    path: Path | None,
    on_progress: Callable[[str], None],
) -> list[Record]:
    """Run both trees round by round until the time is used; return their records.

    Raises:
        CompareError: there is no such commit, or it needs packages that are not installed.
    """
    end_s = time.monotonic() + 60 * minutes
    with TemporaryDirectory(prefix="graycast-compare-") as work, worktree(root, rev) as other:
        beside = [] if path is None else [str(path.resolve())]
        paths = {"here": [str(root / "src")], "there": [str(other / "src"), *beside]}

        def run(side: str, number: str) -> list[Record]:
            records: list[Record] = []
            for record in child(stages, number, work, side, os.pathsep.join(paths[side])):
                left_min = max(0.0, end_s - time.monotonic()) / 60
                on_progress(f"{left_min:.1f} min left: {side}, {number}, {record['row']}")
                records.append(record | {"side": side, "round": number})
            if side == "there":
                refuse_missing(records, other / "pyproject.toml", beside)
            return records

        for side in SIDES:
            run(side, "warm")
        return list(in_turn(run, end_s))


def in_turn(run: Callable[[str, str], list[Record]], end_s: float) -> Iterator[Record]:
    """Run rounds until `end_s`, at least two, in the order A B, B A, A B ..."""
    number, longest_s = 0, 0.0
    while number < LEAST_ROUNDS or time.monotonic() + longest_s < end_s:
        start_s = time.monotonic()
        for side in SIDES if number % 2 == 0 else reversed(SIDES):
            yield from run(side, str(number))
        longest_s, number = max(longest_s, time.monotonic() - start_s), number + 1


def git(root: Path, *words: str, refusal: str = "") -> str:
    done = subprocess.run(["git", "-C", root, *words], capture_output=True, text=True)
    if done.returncode:
        raise CompareError(refusal or f"git {shlex.join(words)} failed: {done.stderr.strip()}")
    return done.stdout.strip()


def commit_of(root: Path, rev: str) -> str:
    refusal = f"{rev!r} is no commit of {root}: give a hash, a tag or a branch"
    return git(root, "rev-parse", "--verify", f"{rev}^{{commit}}", refusal=refusal)


@contextmanager
def worktree(root: Path, rev: str) -> Iterator[Path]:
    """Check out a commit in a temporary folder, which is removed even after an error."""
    commit = commit_of(root, rev)
    with TemporaryDirectory(prefix="graycast-other-") as folder:
        git(root, "worktree", "add", "--detach", folder, commit)
        try:
            yield Path(folder)
        finally:
            git(root, "worktree", "remove", "--force", folder)


def child(
    stages: Sequence[str], number: str, work: str, side: str, python_path: str
) -> Iterator[Record]:
    """Yield the records of one process; if it fails, yield a record with the error for each stage.

    A tree that has a `stages.py` runs its own file, because its modules may have other names.
    """
    own_stages = Path(python_path.split(os.pathsep)[0]).parent / "benchmarks" / "stages.py"
    program = own_stages if own_stages.is_file() else Path(__file__).with_name("stages.py")
    command = [sys.executable, "-P", str(program), ",".join(stages), number, work]
    # Each side has its own cache of hulls, because the key of a hull may not distinguish commits.
    own = {"PYTHONPATH": python_path, "XDG_CACHE_HOME": f"{work}/{side}", "TMPDIR": work}
    with TemporaryFile("w+") as log:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=log, text=True, env=os.environ | own
        )
        with process:
            try:
                yield from map(json.loads, process.stdout or ())
                process.wait()
            finally:
                process.kill()
        log.seek(0)
        last = (log.read().strip().splitlines() or ["no message"])[-1]
    if process.returncode:
        text = f"the process ended with {process.returncode}: {last}"[:120]
        yield from ({"stage": stage, "row": stage, "error": text} for stage in stages)


def refuse_missing(records: Sequence[Record], project: Path, path: list[str]) -> None:
    """Raise a CompareError if the other commit needs packages that are not installed."""
    missing = {name for r in records if (name := r.get("missing"))}
    if all(name.startswith("graycast") for name in missing):
        return  # The commit has this module under another name and cannot run the stage.
    distributions = importlib.metadata.distributions(path=[*path, *sys.path])
    installed = {_package(each.name) for each in distributions}
    needs = tomllib.loads(project.read_text())["project"]["dependencies"]
    lacking = [need for need in needs if _package(need) not in installed] or sorted(missing)
    raise CompareError(
        f"the other commit needs {', '.join(sorted(missing))}, which is not installed: "
        f"pip install --no-deps --target DIR {shlex.join(lacking)}, then give --path DIR"
    )


def _package(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement)[0].replace("_", "-").lower()


def summarise(records: Sequence[Record]) -> list[Record]:
    """Return the rows of the table: medians over rounds, and ratios within rounds."""
    rows = dict.fromkeys((record["stage"], record["row"]) for record in records)
    named = {stage for stage, row in rows if row != stage}
    return [_row(records, *row) for row in rows if row[0] != row[1] or row[0] not in named]


def _values(records: Sequence[Record], row: str, side: str) -> dict[str, float]:
    own = [r for r in records if (r["row"], r["side"]) == (row, side)]
    return {r["round"]: r["value"] for r in own if "value" in r}


def _row(records: Sequence[Record], stage: str, row: str) -> Record:
    here, there = (_values(records, row, side) for side in SIDES)
    ratios = [here[k] / there[k] for k in here if k in there]
    figures: Record = {"here": median(here.values()) if here else None}
    figures |= {"there": median(there.values()) if there else None}
    # A row with the name of the stage has errors that occurred before the stage's rows were known.
    of = [r for r in records if "error" in r and r["row"] in (row, *([] if ratios else [stage]))]
    reasons = dict.fromkeys(f"{r['side']}: {r['error']}" for r in of)
    if ratios:
        figures |= {"ratio": median(ratios), "lowest": min(ratios), "highest": max(ratios)}
    slower = ["**slower**"] if ratios and median(ratios) > SLOWER else []
    return {"row": row} | figures | {"note": "; ".join((*slower, *reasons))}


def table(rows: Sequence[Record]) -> str:
    """Return the rows as a Markdown table."""
    lines = []
    for row in rows:
        here, there = ("" if row[side] is None else f"{row[side]:.3g}" for side in SIDES)
        has_ratio = "ratio" in row
        ratio = ["{ratio:.2f}", "{lowest:.2f}..{highest:.2f}"] if has_ratio else ["", ""]
        note = row["note"].replace("|", "\\|")
        lines.append([row["row"], here, there, *(one.format(**row) for one in ratio), note])
    return markdown_table(["Stage", *SIDES, "ratio", "spread", ""], lines)
