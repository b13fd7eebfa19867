"""The worker process of Blender Cycles: it reads jobs from stdin and writes pictures to files.

It runs in a separate environment (bpy needs an older NumPy, and is GPL), so nothing of Graycast is
imported here: the two exchange only files. `../process.py` explains the protocol.
"""

import ctypes
import json
import os
import signal
import sys
import traceback
from pathlib import Path

PR_SET_PDEATHSIG = 1


def main() -> None:
    answers = _keep_stdout_clean()
    _die_with_parent()
    import frames  # Import late, because bpy writes to stdout.

    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        try:
            for done in frames.render_job(Path(line.strip())):
                print(json.dumps({"frame": done}), file=answers, flush=True)
            answer = {"done": True}
        except Exception as error:
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def _keep_stdout_clean():
    """Keep stdout for answers, and redirect the output of libraries to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return answers


def _die_with_parent() -> None:
    """Let the kernel end this process with its parent, because a frame may take minutes."""
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit("the parent ended before Cycles began")


main()
