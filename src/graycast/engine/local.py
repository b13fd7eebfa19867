"""Worker processes of this machine: replaced when they die, stopped with their parent."""

import atexit
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path

from ..errors import WorkerDied
from .job import Job, Made, Maker, is_the_scenes_own
from .maker import GPU_DEVICES
from .pool import Failed

_MEMORY_SHARE = 0.8  # as a share of the machine's memory, for all workers together
# Libraries that would each take all cores. Open Image Denoise also binds its threads to the first
# cores, where those of the other workers sit already.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OIDN_NUM_THREADS",
)


class LocalPool:
    """Several worker processes that share this machine's threads, memory and GPUs.

    `concurrent.futures` gives up a whole pool when one of its processes dies. So each worker is
    the only process of a pool of its own.
    """

    def __init__(self, task: Job, *, workers: int, threads: int | None) -> None:
        self._task = task
        self._threads = threads or max(1, len(os.sched_getaffinity(0)) // workers)
        self._memory_bytes = _MEMORY_SHARE * _machine_memory_bytes() / workers
        # What a killed worker leaves in its temporary folder goes when the run ends.
        self._temporary = tempfile.TemporaryDirectory(
            prefix="graycast-run-", ignore_cleanup_errors=True
        )
        self._workers = [_Worker(task, self._threads, self._variables(i)) for i in range(workers)]

    def _variables(self, index: int) -> dict[str, str]:
        """Environment variables of one worker."""
        variables = dict.fromkeys(_THREAD_VARIABLES, str(self._threads))
        variables |= {"OIDN_SET_AFFINITY": "0", "TMPDIR": self._temporary.name}
        gpus = list_gpus()
        if self._task.device in GPU_DEVICES and gpus:
            variables["CUDA_VISIBLE_DEVICES"] = gpus[index % len(gpus)]
        return variables

    @property
    def free(self) -> int:
        return sum(worker.future is None for worker in self._workers)

    def submit(self, scene_id: int) -> None:
        next(worker for worker in self._workers if worker.future is None).submit(scene_id)

    def gather(self) -> Made | Failed:
        busy = {worker.future: worker for worker in self._workers if worker.future is not None}
        ended, _ = wait(busy, return_when=FIRST_COMPLETED)
        worker = busy[ended.pop()]
        outcome = worker.result()
        if isinstance(outcome, Made) and outcome.rss_bytes > self._memory_bytes:
            worker.end()  # between two scenes, before the system kills it in the middle of one
        return outcome

    def close(self) -> None:
        for worker in self._workers:
            if worker.future is not None:
                worker.stop()  # rather than wait for minutes
            else:
                worker.end()
        self._temporary.cleanup()


class _Worker:
    """One process that makes a scene at a time; it is started when it gets its first one."""

    def __init__(self, task: Job, threads: int, variables: dict[str, str]) -> None:
        self.future: Future[Made] | None = None
        self._task, self._threads, self._variables = task, threads, variables
        self._scene_id = -1
        self._pool: ProcessPoolExecutor | None = None
        self._process: BaseProcess | None = None

    def submit(self, scene_id: int) -> None:
        self._scene_id = scene_id
        try:
            self.future = self._start(scene_id)
        except BrokenProcessPool:  # it was killed while it waited
            self.stop()
            self.future = self._start(scene_id)

    def _start(self, scene_id: int) -> "Future[Made]":
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                1,
                mp_context=multiprocessing.get_context("spawn"),  # a JIT's threads do not fork
                initializer=_begin,
                initargs=(self._task, self._threads),
            )
        others = set(multiprocessing.active_children())
        with _deaf_to_interrupts(), _environment(self._variables):
            future = self._pool.submit(_make, scene_id)
        started = set(multiprocessing.active_children()) - others
        self._process = next(iter(started), self._process)
        return future

    def result(self) -> Made | Failed:
        """The result of the finished scene; a worker that failed unexpectedly is replaced."""
        future, self.future = self.future, None
        if future is None:
            raise RuntimeError("nothing was submitted")
        try:
            return future.result()
        except BrokenProcessPool:
            if self._pool is not None:
                self._pool.shutdown(wait=True)  # then its exit code is known
            error: Exception = WorkerDied(_obituary(self._process))
            self.stop()
        except Exception as raised:
            error = raised
            if not is_the_scenes_own(error):
                self.end()  # a lost driver does not come back in the same process
        return Failed(scene_id=self._scene_id, error=error)

    def end(self) -> None:
        """End the idle process; the next scene starts another."""
        if self._pool is not None:
            self._pool.shutdown(wait=True)
        self._pool = self._process = None

    def stop(self) -> None:
        """End the process at once."""
        pool, process = self._pool, self._process
        self.future = self._pool = self._process = None
        if process is not None and pool is not None:
            process.kill()
        if pool is not None:
            pool.shutdown(wait=True, cancel_futures=True)


def _obituary(process: BaseProcess | None) -> str:
    code = None if process is None else process.exitcode
    if code is None or code >= 0:
        return f"its worker process ended (exit code {code})"
    name = signal.Signals(-code).name
    why = ", by a user or by the operating system for lack of memory" if name == "SIGKILL" else ""
    return f"its worker process was killed ({name}{why})"


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, because their parent ends them.

    Blocked, not ignored: a process hands its mask on, and what comes meanwhile is heard afterwards.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Processes started inside have these variables; the user's own settings of them go first."""
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
    """The NVIDIA GPUs that this process may use, as CUDA_VISIBLE_DEVICES names them."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    if given is not None:
        return [name.strip() for name in given.split(",") if name.strip()]
    known = Path("/proc/driver/nvidia/gpus")
    return [str(i) for i in range(len(list(known.iterdir())))] if known.is_dir() else []


def _machine_memory_bytes() -> int:
    """Memory of this machine, or of the container that this process is in."""
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
    except OSError:
        return memory
    return min(memory, int(limit)) if limit.isdecimal() else memory


# --- in the worker -----------------------------------------------------------------------------

_maker: Maker | None = None  # a pool gives its process no other place for it


def _begin(task: Job, threads: int) -> None:
    global _maker
    _maker = task.open(threads=threads)
    atexit.register(_maker.close)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _make(scene_id: int) -> Made:
    if _maker is None:
        raise RuntimeError("the worker has not begun")
    return _maker.make(scene_id)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        raise RuntimeError("this is not a worker process")
    parent.join()
    os._exit(1)
