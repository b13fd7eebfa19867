"""The child process in which Cycles runs.

The protocol: each line on the child's stdin is the path of a job's folder. Each answer is a line of
JSON: `{"ready": true}` at the start, `{"frame": name}` when a frame's file is written, and
`{"done": true}` or `{"error": text}` at the end of a job. Pictures are passed as files.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from ...base.errors import GraycastError

WORKER = Path(__file__).with_name("worker")
PYTHON_VARIABLE = "GRAYCAST_CYCLES_PYTHON"
_OWN_PLACE = Path(".venv-cycles") / "bin" / "python"
_ASK_LIMIT_S = 60.0
_LOG_LINES = 5
_REMEDY = f"run make cycles, or set {PYTHON_VARIABLE} to a Python that has it"


class CyclesDied(Exception):
    """The child process ended during a job; the text has its exit code or signal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CyclesState:
    """The result of the search for Cycles; `problem` is the reason why it cannot be used."""

    python: Path | None = None
    version: str | None = None
    problem: str | None = None

    @property
    def usable(self) -> bool:
        return self.problem is None


def find_cycles() -> Path | None:
    """Return the Python with Blender: GRAYCAST_CYCLES_PYTHON, or else what `make cycles` made."""
    named = os.environ.get(PYTHON_VARIABLE)
    if named:
        return Path(named)
    # Search next to Graycast's own environment, then in the current folder.
    for folder in (Path(sys.prefix).parent, Path.cwd()):
        if (folder / _OWN_PLACE).exists():
            return folder / _OWN_PLACE
    return None


def examine_cycles() -> CyclesState:
    """Ask Cycles' Python for Blender's version, without loading Blender."""
    python = find_cycles()
    if python is None:
        return CyclesState(problem="Blender Cycles is not installed; run: make cycles")
    ask = "from importlib.metadata import version; print(version('bpy'))"
    try:
        answer = subprocess.run(
            [python, "-I", "-c", ask], capture_output=True, text=True, timeout=_ASK_LIMIT_S
        )
    except (OSError, subprocess.SubprocessError) as error:
        return CyclesState(python=python, problem=f"{python} does not run ({error}): {_REMEDY}")
    if answer.returncode != 0:
        why = f"{python} has no Blender (package bpy): {_REMEDY}"
        return CyclesState(python=python, problem=why)
    return CyclesState(python=python, version=answer.stdout.strip())


@final
class CyclesProcess:
    """A running child process; it must not be used by several threads."""

    def __init__(self, python: Path):
        self._log = tempfile.TemporaryFile("w+", prefix="graycast-cycles-")
        self._child = subprocess.Popen(
            [python, "-I", "-W", "ignore", WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            start_new_session=True,  # Ctrl-C reaches only the parent, which ends the child.
        )
        if self._child.stdin is None or self._child.stdout is None:
            raise ValueError("a child without pipes takes no jobs")
        self._jobs, self._answers = self._child.stdin, self._child.stdout
        try:
            self._answer()  # Wait until the child is ready.
        except CyclesDied as error:
            self.close()
            raise GraycastError(f"Blender Cycles does not start: {error}") from error

    def run(self, folder: Path) -> Iterator[str]:
        """Render a job; yield the name of each frame when its file is written.

        Raises:
            CyclesDied: the process ended; the files of finished frames remain.
            GraycastError: Cycles refused the job.
        """
        with suppress(OSError):  # If the child has ended, `_answer` raises the error.
            self._jobs.write(f"{folder}\n")
            self._jobs.flush()
        while "done" not in (answer := self._answer()):
            if "error" in answer:
                raise GraycastError(f"Blender Cycles: {answer['error']}")
            yield answer["frame"]

    def close(self) -> None:
        """End the child at once, which is safe because it has no state between jobs."""
        self._child.kill()
        self._child.wait()
        for stream in (self._jobs, self._answers, self._log):
            with suppress(OSError):  # Unsent data is no longer needed.
                stream.close()

    def _answer(self) -> dict[str, Any]:
        line = self._answers.readline()
        if line.endswith("\n"):
            return json.loads(line)
        code = self._child.wait()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().splitlines() if line.strip()]
        last = "".join(f"\n  {line}" for line in lines[-_LOG_LINES:])
        raise CyclesDied(f"its process ended ({how}){last}")
