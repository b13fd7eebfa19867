"""Killing, stopping or starving worker processes of this machine does not change the result."""

import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np
import pytest
from heavy_job import HeavyJob
from small_cell import content, finished, start

from graycast.base.errors import WorkerDied
from graycast.base.spawn import deaf_to_interrupts
from graycast.cell.engine import Failed, SceneTask, TaskResult, make_all
from graycast.cell.engine import local as local_module
from graycast.cell.engine.local import LocalPool, list_gpus
from graycast.dataset.check.checking import validate


def workers_of(pid):
    """Return the processes that a run has started to make scenes."""
    pids = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in file.read_text().split():
            try:
                command = Path(f"/proc/{child}/cmdline").read_bytes()
            except OSError:
                continue
            if b"spawn_main" in command:
                pids.append(int(child))
    return pids


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class WorkerOf:
    """A substitute for a worker whose process has made some scenes and uses this much memory."""

    def __init__(self, rss_bytes, scenes):
        self.connection, theirs = multiprocessing.Pipe()
        theirs.send("done")
        self.busy, self.ended, self.scenes, self._rss_bytes = True, False, scenes, rss_bytes

    def result(self):
        self.busy = False
        return TaskResult(scene_id=0, files=(), seconds=1.0, reasons={}, rss_bytes=self._rss_bytes)

    def end(self):
        self.ended = True


def test_a_scene_beyond_a_worker_s_memory_causes_one_warning_with_a_remedy(monkeypatch):
    """Four workers share 0.8 of 20 GB; a process that used 5 GB for one scene would do so again."""
    monkeypatch.setattr(local_module, "_machine_memory_bytes", lambda: 20e9)
    messages = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    logger = logging.getLogger("graycast.cell.engine.local")
    logger.addHandler(handler)
    pool = LocalPool(HeavyJob(seed=0, device="cpu"), workers=4, threads=1)
    try:
        # Memory that a process gathers over many scenes ends with it; a process of 3 GB fits.
        gigabyte = 10**9
        cases = [(3, 1, False), (5, 9, True), (5, 1, True), (5, 1, True)]
        for gigabytes, scenes, ends in cases:
            worker = WorkerOf(gigabytes * gigabyte, scenes)
            pool._workers[0] = worker
            assert isinstance(pool.gather(), TaskResult)
            assert worker.ended == ends
    finally:
        logger.removeHandler(handler)
        pool.close()
    assert messages == [
        "a scene takes 5.0 GB of memory, and each of 4 workers has 4.0 GB: give --workers 3 "
        "at most, or the operating system may end workers"
    ]


def test_only_gpus_that_the_user_allows_are_used(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2, GPU-5a,7")
    assert list_gpus() == ["2", "GPU-5a", "7"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert list_gpus() == []


def test_threads_and_gpus_are_divided_among_the_workers(task, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: range(9))
    pool = LocalPool(
        SceneTask(cell=task.cell, seed=0, device="cuda", depth_scale_mm=0.1),
        workers=3,
        threads=None,
    )
    try:
        environments = [pool._variables(i) for i in range(3)]
    finally:
        pool.close()
    assert [variables["CUDA_VISIBLE_DEVICES"] for variables in environments] == ["4", "6", "4"]
    assert {variables["OIDN_NUM_THREADS"] for variables in environments} == {"3"}
    assert {variables["OIDN_SET_AFFINITY"] for variables in environments} == {"0"}


def test_ctrl_c_during_the_start_of_a_worker_takes_effect_after_the_start():
    with pytest.raises(KeyboardInterrupt):
        with deaf_to_interrupts():
            signal.raise_signal(signal.SIGINT)
            begun = subprocess.run(["grep", "SigBlk", "/proc/self/status"], capture_output=True)
    assert int(begun.stdout.split()[1], 16) & 1 << (signal.SIGINT - 1)


@pytest.mark.slow
def test_ctrl_c_does_not_reach_the_first_worker_of_a_program():
    """Python first starts a process of its own, and unblocks Ctrl-C."""
    program = (
        "from graycast.cell.engine.local import _Worker\n"
        "worker = _Worker(None, 1, {})\n"
        "worker._start()\n"
        "print(open(f'/proc/{worker._process.pid}/status').read())\n"
        "worker._process.kill()"  # The process would import everything before it stops.
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    (blocked,) = [line for line in run.stdout.splitlines() if line.startswith("SigBlk")]
    assert int(blocked.split()[1], 16) & 1 << (signal.SIGINT - 1), run.stderr


@pytest.mark.slow
def test_killing_a_worker_that_is_sending_its_scene_does_not_block_the_run():
    pool, outcomes = LocalPool(HeavyJob(seed=0, device="cpu"), workers=1, threads=1), []
    try:
        pool.submit(0)
        assert wait([pool._workers[0].connection], timeout=60)  # The worker is writing and waits.
        os.kill(pool._workers[0]._process.pid, signal.SIGKILL)
        listener = threading.Thread(target=lambda: outcomes.append(pool.gather()), daemon=True)
        listener.start()
        listener.join(timeout=60)
        assert not listener.is_alive(), "it waits for the rest of what a dead process wrote"
        assert pool.free == 1
        pool.submit(1)
        result = pool.gather()
    finally:
        pool.close()
    assert isinstance(outcomes[0].error, WorkerDied)
    assert (result.scene_id, result.files) == (1, (("large.bin", bytes(16_000_000)),))


@pytest.mark.slow
def test_the_scene_of_a_killed_worker_is_made_again_by_a_new_worker(task):
    pool = LocalPool(task, workers=1, threads=1)
    try:
        outcomes = []
        for outcome in make_all(pool, range(3)):
            outcomes.append(outcome)
            if len(outcomes) == 1:
                os.kill(workers_of(os.getpid())[0], signal.SIGKILL)  # The worker is making scene 1.
    finally:
        pool.close()
    (failed,) = [outcome for outcome in outcomes if isinstance(outcome, Failed)]
    assert isinstance(failed.error, WorkerDied)
    assert str(failed.error) == (
        "its worker process was killed (SIGKILL, by a user or "
        "by the operating system for lack of memory)"
    )
    scene_ids = [outcome.scene_id for outcome in outcomes if isinstance(outcome, TaskResult)]
    assert sorted(scene_ids) == [0, 1, 2]
    assert workers_of(os.getpid()) == []


@pytest.mark.slow
def test_a_worker_that_exceeds_its_share_of_memory_is_replaced_between_scenes(task, monkeypatch):
    def pids(share):
        monkeypatch.setattr(local_module, "_MEMORY_SHARE", share)
        pool, child_pids = LocalPool(task, workers=1, threads=1), []
        try:
            for scene_id in range(3):
                pool.submit(scene_id)
                # Record ids, because a process that was just forked does not have its name yet.
                child_pids += [child.pid for child in multiprocessing.active_children()]
                assert isinstance(pool.gather(), TaskResult)
        finally:
            pool.close()
        return child_pids

    assert len(set(pids(0.8))) == 1
    assert len(set(pids(1e-6))) == 3


@pytest.mark.slow
def test_workers_end_with_the_run_that_started_them(config_file, tmp_path):
    command = ("generate", config_file, "--out", tmp_path / "out", "--scenes", 500)
    with start(*command, "--workers", 2) as run:
        while finished(tmp_path / "out") < 2 and run.poll() is None:
            time.sleep(0.05)
        workers = workers_of(run.pid)
        assert len(workers) == 2
        os.kill(run.pid, signal.SIGKILL)  # the parent only
    deadline = time.monotonic() + 10
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(alive, workers))


@pytest.mark.slow
@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_leaves_no_process_and_no_file(config_file, tmp_path, monkeypatch, word):
    out, temporary = tmp_path / "out", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    command = ("generate", config_file, "--out", out, "--scenes", 500, "--workers", 2)
    with start(*command) as run:
        while finished(out) < 2 and run.poll() is None:
            time.sleep(0.05)
        workers = workers_of(run.pid)
        run.send_signal(word)
        begun = time.monotonic()
        _, complaint = run.communicate()
    assert (run.returncode, complaint) == (
        130,
        "graycast: the command was stopped; the finished scenes are kept; "
        "run the same command again to continue\n",
    )
    assert time.monotonic() - begun < 10
    assert not any(map(alive, workers))
    assert not list(out.rglob(".tmp-*"))
    assert list(temporary.iterdir()) == []


SCENES, WORKER_KILLS, RUN_KILLS = 40, 8, 3


@pytest.mark.slow
def test_killing_workers_or_runs_does_not_change_the_dataset(config_file, undisturbed, tmp_path):
    """`kill -9` hits a random worker 8 times and the whole run 3 times during its work."""
    rng, out = np.random.default_rng(5), tmp_path / "out"
    command = ("generate", config_file, "--out", out, "--scenes", SCENES, "--workers", 2)
    kills = ["run"] * RUN_KILLS + ["worker"] * WORKER_KILLS
    kills = [str(kind) for kind in rng.permutation(kills)]
    run, before = start(*command), 0
    try:
        for number, kind in enumerate(kills):
            # The kills are spread over the whole run. A scene is finished between two kills, so
            # there are workers to kill, and no scene loses three of them.
            goal = max((number + 1) * (SCENES - 10) // len(kills), before + 1)
            while (finished(out) < goal or not workers_of(run.pid)) and run.poll() is None:
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.3))
            assert run.poll() is None, "it was done before all kills"
            if kind == "run":
                os.killpg(run.pid, signal.SIGKILL)
                run.communicate()
                run = start(*command)
            else:
                os.kill(int(rng.choice(workers_of(run.pid))), signal.SIGKILL)
            before = finished(out)
        _, complaint = run.communicate()
    finally:
        if run.poll() is None:  # The run would continue, and its open pipes would fail a test.
            os.killpg(run.pid, signal.SIGKILL)
            run.communicate()
    assert (run.returncode, complaint) == (0, "")
    assert content(out) == content(undisturbed(SCENES))
    assert validate(out) == ()


@pytest.mark.slow
def test_a_scene_is_given_up_if_its_worker_is_killed_each_time(task):
    pool, stop = LocalPool(task, workers=1, threads=1), threading.Event()

    def killer():
        while not stop.wait(0.01):
            for worker in workers_of(os.getpid()):
                os.kill(worker, signal.SIGKILL)

    thread = threading.Thread(target=killer)
    thread.start()
    try:
        outcomes = list(make_all(pool, [0]))
    finally:
        stop.set()
        thread.join()
        pool.close()
    assert [(o.scene_id, o.tries, o.final) for o in outcomes] == [
        (0, 1, False),
        (0, 2, False),
        (0, 3, True),
    ]
