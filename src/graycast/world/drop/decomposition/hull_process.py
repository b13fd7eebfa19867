"""Decomposition in child processes, which can be ended at any moment.

The libraries do not react to Ctrl-C while they work, and a part with many faces takes long. The
parent therefore waits, and can kill its children. Files carry the mesh to a child and the hulls
back. A child writes each stage as a line to stdout. A closed stdin means that the parent has ended.
"""

import json
import os
import selectors
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np

from ....base.errors import GraycastError
from ....base.progress import Stages
from ...parts import Mesh, Part
from .cache import read_decomposition, write_decomposition
from .error import Decomposition, measure
from .mesh_hulls import decompose

_LOG_LINES = 5


def decompose_apart(
    jobs: Iterable[tuple[str, Part]],
) -> Generator[tuple[str, str | Decomposition], None, None]:
    """Decompose and measure each mesh in a child process, one child per processor.

    One thread follows all children, so an exception in that thread ends all children. A caller that
    may stop early must close this iterator, which ends the children too.

    Args:
        jobs: pairs of a key and a part; each is read when its child starts.

    Yields:
        The key with each stage of its child, and finally with the result.

    Raises:
        ValueError: a mesh cannot be decomposed.
        GraycastError: a child was killed, by hand or for lack of memory.
    """
    waiting, processors = iter(jobs), len(os.sched_getaffinity(0))
    with ExitStack() as stack:
        running = stack.enter_context(selectors.DefaultSelector())
        while True:
            for key, part in islice(waiting, processors - len(running.get_map())):
                own = stack.enter_context(ExitStack())
                child = own.enter_context(_started(part))
                running.register(child.stdout, selectors.EVENT_READ, (key, child, own))
            if not running.get_map():
                return
            for ready, _ in running.select():
                key, child, own = ready.data
                news = child.news()
                if isinstance(news, Decomposition):
                    running.unregister(child.stdout)
                    own.close()
                yield key, news


@dataclass(frozen=True, slots=True, kw_only=True)
class _Child:
    name: str
    process: subprocess.Popen[bytes]
    stdout: IO[bytes]
    hull_file: Path
    log: IO[str]

    def news(self) -> str | Decomposition:
        """Wait for the child's next stage or its result, and return it."""
        line = self.stdout.readline()
        message = json.loads(line) if line else {}
        if "stage" in message:
            return message["stage"]
        if "refused" in message:
            raise ValueError(message["refused"])
        decomposition = read_decomposition(self.hull_file)
        if decomposition is None:
            raise GraycastError(_obituary(self.name, self.process.wait(), self.log))
        return decomposition


@contextmanager
def _started(part: Part) -> Iterator[_Child]:
    """Yield a child that decomposes the part's mesh; the child ends when this context ends."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="graycast-hulls-")))
        mesh_file, hull_file = folder / "mesh.npz", folder / "hulls.npz"
        np.savez(mesh_file, vertices_m=part.mesh.vertices_m, faces=part.mesh.faces)
        log = stack.enter_context(tempfile.TemporaryFile("w+"))
        process = subprocess.Popen(
            [sys.executable, "-m", __spec__.name, mesh_file, hull_file],
            bufsize=0,  # A selector would not notice buffered lines.
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,  # Only the parent gets Ctrl-C; it then ends the child.
        )
        stack.enter_context(process)  # This closes the child's pipes and waits for the child.
        stack.callback(process.kill)
        assert process.stdout is not None
        yield _Child(
            name=part.name, process=process, stdout=process.stdout, hull_file=hull_file, log=log
        )


def _obituary(name: str, code: int, log: IO[str]) -> str:
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
    log.seek(0)
    words = "; ".join(line.strip() for line in log.read().splitlines()[-_LOG_LINES:])
    why = f" ({words})" if words else ""
    return (
        f"the process that cuts {name} into convex hulls {how}{why}: free memory, or "
        "decimate the part's mesh"
    )


# --- in the child --------------------------------------------------------------------------------


def _main(mesh_file: Path, hull_file: Path) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with np.load(mesh_file) as data:
        mesh = Mesh(vertices_m=data["vertices_m"], faces=data["faces"])
    try:
        hulls = decompose(mesh, progress=Stages(lambda stage: _say(stage=stage)))
        _say(stage=f"measuring {len(hulls)} hulls")
        write_decomposition(hull_file, measure(mesh, hulls))
    except ValueError as error:
        _say(refused=str(error))
    else:
        _say(done=True)


def _say(**message: object) -> None:
    print(json.dumps(message), flush=True)


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    _main(Path(sys.argv[1]), Path(sys.argv[2]))
