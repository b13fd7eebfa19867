"""Decomposition in a process of its own, which can be ended at any moment.

The libraries do not react to Ctrl-C while they work, and a part with many faces takes long. The
parent therefore waits, and can kill the child. Files carry the mesh to the child and the hulls
back. The child writes each stage as a line to stdout. A closed stdin tells the child that the
parent has ended.
"""

import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from ...errors import GraycastError
from ...parts import Mesh
from .cache import read_decomposition, write_decomposition
from .error import Decomposition, measured
from .making import OnStage, decompose

_LOG_LINES = 5


def decompose_apart(mesh: Mesh, *, on_stage: OnStage) -> Decomposition:
    """`decompose` and `measured` in a child process, which ends with this call however it ends.

    Raises:
        ValueError: the mesh cannot be decomposed.
        GraycastError: the child was killed, by hand or for lack of memory.
    """
    with tempfile.TemporaryDirectory(prefix="graycast-hulls-") as folder:
        mesh_file, hull_file = Path(folder) / "mesh.npz", Path(folder) / "hulls.npz"
        np.savez(mesh_file, vertices_m=mesh.vertices_m, faces=mesh.faces)
        with tempfile.TemporaryFile("w+") as log:
            child = subprocess.Popen(
                [sys.executable, "-m", __spec__.name, mesh_file, hull_file],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                start_new_session=True,  # Ctrl-C is for the parent, which then ends it
            )
            try:
                refusal = _follow(child, on_stage)
            finally:
                child.kill()
                child.wait()
                for pipe in (child.stdin, child.stdout):
                    if pipe is not None:
                        pipe.close()
            if refusal is not None:
                raise ValueError(refusal)
            made = read_decomposition(hull_file)
            if made is None:
                raise GraycastError(_obituary(child.returncode, log))
            return made


def _follow(child: subprocess.Popen[str], on_stage: OnStage) -> str | None:
    """Report the child's stages until it ends; return why it refused the mesh, if it did."""
    for line in child.stdout or ():
        message = json.loads(line)
        if "stage" in message:
            on_stage(message["stage"])
        else:
            return message.get("refused")
    child.wait()
    return None


def _obituary(code: int, log) -> str:
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
    log.seek(0)
    words = "; ".join(line.strip() for line in log.read().splitlines()[-_LOG_LINES:])
    told = f" ({words})" if words else ""
    return (
        f"the process that cuts a part into convex hulls {how}{told}: free memory, or decimate "
        "the part's mesh"
    )


# --- in the child --------------------------------------------------------------------------------


def _main(mesh_file: Path, hull_file: Path) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with np.load(mesh_file) as data:
        mesh = Mesh(vertices_m=data["vertices_m"], faces=data["faces"])
    try:
        hulls = decompose(mesh, on_stage=lambda stage: _say(stage=stage))
        _say(stage=f"measuring {len(hulls)} hulls")
        write_decomposition(hull_file, measured(mesh, hulls))
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
