"""Worker processes of this machine: replaced when they die, stopped with their parent."""

import logging
import multiprocessing
import os
import signal
import tempfile
import threading
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from ...base.errors import WorkerDied
from ...base.spawn import SPAWN, deaf_to_interrupts
from .job import Job, TaskResult, TaskRunner, is_the_scenes_own
from .maker import GPU_DEVICES
from .pool import Failed

_MEMORY_SHARE = 0.8  # The workers together may use this share of the machine's memory.
# These libraries would each use all cores. Open Image Denoise also binds its threads to the first
# cores, which threads of the other workers use already.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OIDN_NUM_THREADS",
)


class LocalPool:
    """Several worker processes that share this machine's threads, memory and GPUs."""

    def __init__(self, task: Job, *, workers: int, threads: int | None) -> None:
        self._task = task
        self._threads = threads or max(1, len(os.sched_getaffinity(0)) // workers)
        self._memory_bytes = _MEMORY_SHARE * _machine_memory_bytes() / workers
        self._has_warned = False
        # This folder and all files that a killed worker leaves in it are deleted after the run.
        self._temporary = tempfile.TemporaryDirectory(
            prefix="graycast-run-", ignore_cleanup_errors=True
        )
        # The library logs the same notes in each worker, so only the first worker prints them.
        self._workers = [
            _Worker(task, self._threads, self._variables(i), quiet=i > 0) for i in range(workers)
        ]

    def _variables(self, index: int) -> dict[str, str]:
        """Return the environment variables of one worker."""
        variables = dict.fromkeys(_THREAD_VARIABLES, str(self._threads))
        variables |= {"OIDN_SET_AFFINITY": "0", "TMPDIR": self._temporary.name}
        gpus = list_gpus()
        if self._task.device in GPU_DEVICES and gpus:
            variables["CUDA_VISIBLE_DEVICES"] = gpus[index % len(gpus)]
        return variables

    @property
    def free(self) -> int:
        return sum(not worker.busy for worker in self._workers)

    def submit(self, scene_id: int) -> None:
        next(worker for worker in self._workers if not worker.busy).submit(scene_id)

    def gather(self) -> TaskResult | Failed:
        busy = [worker for worker in self._workers if worker.busy]
        heard = wait([worker.connection for worker in busy if worker.connection is not None])
        worker = next(worker for worker in busy if worker.connection in heard)
        outcome = worker.result()
        if isinstance(outcome, TaskResult) and outcome.rss_bytes > self._memory_bytes:
            worker.end()  # End the worker between scenes, before the system kills it during one.
            if worker.scenes == 1:  # Another process would need as much memory.
                self._warn(outcome.rss_bytes)
        return outcome

    def _warn(self, scene_bytes: int) -> None:
        """Warn once that a single scene needs more than a worker's share of the memory."""
        if self._has_warned:
            return
        self._has_warned = True
        count = len(self._workers)
        fit = max(1, int(count * self._memory_bytes / scene_bytes))
        logging.getLogger(__name__).warning(
            "a scene takes %.1f GB of memory, and each of %d workers has %.1f GB: give --workers "
            "%d at most, or the operating system may end workers",
            scene_bytes / 1e9,
            count,
            self._memory_bytes / 1e9,
            fit,
        )

    def close(self) -> None:
        for worker in self._workers:
            if worker.busy:
                worker.stop()  # Stopping avoids a wait of minutes.
            else:
                worker.end()
        self._temporary.cleanup()


class _Worker:
    """A process that makes one scene at a time; the first scene starts the process.

    All messages go through one pipe, and only the process holds the other end. So if the process is
    killed while it writes its result, the pipe closes and the parent does not wait for the rest.
    (In a pool of `concurrent.futures`, the parent also holds that end, and waits for ever.)
    """

    def __init__(
        self, task: Job, threads: int, variables: dict[str, str], *, quiet: bool = False
    ) -> None:
        self.busy = False
        self.scenes = 0  # scenes that the process has made
        self.connection: Connection | None = None
        self._task, self._threads, self._variables = task, threads, variables
        self._quiet = quiet
        self._scene_id = -1
        self._process: BaseProcess | None = None

    def submit(self, scene_id: int) -> None:
        # The flag is set before the scene is sent, so that `close` kills the process in any case.
        self._scene_id, self.busy = scene_id, True
        if self.connection is None or not self._send(scene_id):
            self.stop()  # The process was killed while idle.
            self._start()
            self.busy = True
            self._send(scene_id)  # if the new process is dead, too, `result` reports it

    def _start(self) -> None:
        # Python starts the tracker with the first process, and then unblocks Ctrl-C.
        resource_tracker.ensure_running()
        self.scenes = 0
        with deaf_to_interrupts(), _environment(self._variables):
            self.connection, theirs = SPAWN.Pipe()
            process = SPAWN.Process(target=_work, args=(theirs,), daemon=True)
            process.start()
            theirs.close()
            self._process = process
        self._send((self._task, self._threads, self._quiet))

    def _send(self, message: object) -> bool:
        """Send a message; return whether the process received it."""
        if self.connection is None:
            raise RuntimeError("the worker was not started")
        try:
            self.connection.send(message)
        except OSError:
            return False
        return True

    def result(self) -> TaskResult | Failed:
        """Wait for the scene's result and return it; end a process that failed unexpectedly."""
        if self.connection is None or self._process is None or not self.busy:
            raise RuntimeError("nothing was submitted")
        error: Exception
        try:
            outcome: TaskResult | Exception = self.connection.recv()
        except (EOFError, OSError):
            self._process.join()
            error = WorkerDied(_obituary(self._process.exitcode))
            self.stop()
        except Exception as unreadable:  # an error whose class cannot be built from its message
            error = unreadable
            self.end()
        else:
            self.busy = False  # The process becomes idle only here.
            self.scenes += 1
            if isinstance(outcome, TaskResult):
                return outcome
            error = outcome
            if not is_the_scenes_own(error):
                self.end()  # in the same process, a lost driver does not come back
        return Failed(scene_id=self._scene_id, error=error)

    def end(self) -> None:
        """Let the idle process end; the next scene starts a new process."""
        self.busy = False
        if self.connection is not None:
            self.connection.close()  # The process ends when the pipe is closed.
        if self._process is not None:
            self._process.join()
        self.connection = self._process = None

    def stop(self) -> None:
        """End the process at once."""
        if self._process is not None:
            self._process.kill()
        self.end()


def _obituary(code: int | None) -> str:
    if code is None or code >= 0:
        return f"its worker process ended (exit code {code})"
    name = signal.Signals(-code).name
    why = ", by a user or by the operating system for lack of memory" if name == "SIGKILL" else ""
    return f"its worker process was killed ({name}{why})"


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables for processes that start in the block; the user's settings take precedence."""
    shared_out = ("TMPDIR", "CUDA_VISIBLE_DEVICES")
    added = {k: v for k, v in variables.items() if k in shared_out or k not in os.environ}
    before = {name: os.environ.get(name) for name in added}
    os.environ.update(added)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def list_gpus() -> list[str]:
    """Return the NVIDIA GPUs that this process may use, as CUDA_VISIBLE_DEVICES names them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name.strip() for name in visible.split(",") if name.strip()]
    known = Path("/proc/driver/nvidia/gpus")
    return [str(i) for i in range(len(list(known.iterdir())))] if known.is_dir() else []


def _machine_memory_bytes() -> int:
    """Return the memory of this machine, or of the container that this process is in."""
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
    except OSError:
        return memory
    return min(memory, int(limit)) if limit.isdecimal() else memory


# --- in the worker -----------------------------------------------------------------------------


def _work(connection: Connection) -> None:
    """Make the requested scenes until the parent closes its end of the pipe."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, ConnectionError), ExitStack() as opened:
        task, threads, quiet = connection.recv()
        if quiet:
            logging.getLogger("graycast").setLevel(logging.ERROR)
        maker: TaskRunner | None = None
        while True:
            scene_id = connection.recv()
            try:
                if maker is None:
                    maker = opened.enter_context(closing(task.open(threads=threads)))
                outcome = maker.make(scene_id)
            except Exception as error:
                error.add_note(traceback.format_exc())  # pickling loses the traceback of an error
                outcome = error
            _tell(connection, outcome)


def _tell(connection: Connection, outcome: TaskResult | Exception) -> None:
    try:
        connection.send(outcome)
    except OSError:
        os._exit(1)  # the parent has closed the pipe
    except Exception:  # the error contains a value that cannot be pickled
        connection.send(RuntimeError(f"{type(outcome).__name__}: {outcome}"))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        raise RuntimeError("this is not a worker process")
    parent.join()
    os._exit(1)
