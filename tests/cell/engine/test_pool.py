"""Every scene comes out or is given up, however its workers fare."""

from collections import Counter

import pytest
from metered import Metered

from graycast.base.errors import ConfigError, DeviceError, DropError, GraycastError, WorkerDied
from graycast.cell.engine import (
    TRIES,
    Failed,
    Job,
    TaskResult,
    Workers,
    make_all,
    make_missing,
    open_pool,
    workers,
)

IDS = range(20)


class Scripted:
    """Three workers; tries fail as the script says, and the last scene in comes out first."""

    def __init__(self, script=()):
        self.script = {scene_id: list(errors) for scene_id, errors in dict(script).items()}
        self.running, self.submitted = [], Counter()
        self.closed = False

    @property
    def free(self):
        return 3 - len(self.running)

    def submit(self, scene_id):
        assert self.free
        self.running.append(scene_id)
        self.submitted[scene_id] += 1

    def gather(self):
        scene_id = self.running.pop()
        if self.script.get(scene_id):
            return Failed(scene_id=scene_id, error=self.script[scene_id].pop(0))
        return TaskResult(scene_id=scene_id, files=(), seconds=1.0, reasons={}, rss_bytes=0)

    def close(self):
        self.closed = True


def outcomes(script=()):
    pool = Scripted(script)
    all_of_them = list(make_all(pool, IDS))
    assert not pool.running
    done = sorted(o.scene_id for o in all_of_them if isinstance(o, TaskResult))
    return done, [o for o in all_of_them if isinstance(o, Failed)], pool.submitted


def test_each_scene_is_made_once():
    done, failed, submitted = outcomes()
    assert (done, failed) == (list(IDS), [])
    assert set(submitted.values()) == {1}


@pytest.mark.parametrize("error", [WorkerDied("killed"), DeviceError("lost"), MemoryError()])
def test_what_may_be_the_machines_fault_is_tried_again(error):
    done, failed, submitted = outcomes({4: [error] * 2, 19: [error]})
    assert done == list(IDS)
    assert [(f.scene_id, f.tries, f.final) for f in failed] == [
        (4, 1, False),
        (19, 1, False),
        (4, 2, False),
    ]
    assert (submitted[4], submitted[19], submitted[5]) == (3, 2, 1)


def test_three_failures_end_a_scene_and_no_other():
    done, failed, submitted = outcomes({4: [WorkerDied("killed")] * 9})
    assert done == [scene_id for scene_id in IDS if scene_id != 4]
    assert [f.final for f in failed] == [False, False, True]
    assert submitted[4] == TRIES == 3


@pytest.mark.parametrize("error", [DropError("no rest"), ValueError("dark")])
def test_what_would_fail_again_is_given_up_at_once(error):
    _, failed, submitted = outcomes({4: [error]})
    assert [(f.scene_id, f.tries, f.final) for f in failed] == [(4, 1, True)]
    assert submitted[4] == 1


def test_a_machine_that_loses_scene_after_scene_ends_the_run():
    """Its driver is lost after six scenes; with three at work 13 in a row come to nothing."""
    results = []
    lost = {scene_id: [DeviceError("no driver")] * 9 for scene_id in range(6, 40)}
    with pytest.raises(GraycastError, match=r"13 scenes in a row.*no driver: repair the machine"):
        for outcome in make_all(Scripted(lost), range(40)):
            results.append(outcome)
    assert all(isinstance(o, TaskResult) for o in results[:-13])
    assert all(isinstance(o, Failed) and not o.final for o in results[-13:])


def test_scenes_that_are_lost_now_and_then_do_not_end_a_run():
    script = {scene_id: [WorkerDied("killed")] for scene_id in range(0, 80, 2)}
    script |= {
        scene_id: [DropError("no rest")] for scene_id in range(80, 100)
    }  # by their own fault
    outcomes = list(make_all(Scripted(script), range(100)))
    assert sum(isinstance(o, TaskResult) for o in outcomes) == 80


def test_an_unknown_engine_is_refused(task):
    with pytest.raises(ValueError, match="no engine 'slurm': choose 'local' or 'ray'"):
        open_pool(task, Workers(engine="slurm", count=2), scenes=2)


def handed(monkeypatch, script, ids=IDS):
    """What `make_missing` hands over of a pool that fails so, what it gives up, and the pool."""
    pool, results, failed, meter = Scripted(script), [], [], Metered()
    monkeypatch.setattr(workers, "open_pool", lambda *_, **words: pool)
    try:
        lost = make_missing(
            Job(seed=0, device="cpu"),
            ids,
            what="scenes",
            total=1 + len(ids),
            progress=meter,
            on_result=results.append,
            on_failed=failed.append,
        )
    except Exception as raised:
        lost = raised
    whole = 1 + len(ids)  # one was there before
    assert meter.counts == [("scenes", 1 + k, whole) for k in range(1 + len(results))]
    return [one.scene_id for one in results], [one.scene_id for one in failed], lost, pool


def test_scenes_that_are_given_up_are_told_once_the_others_are_made(monkeypatch):
    done, failed, lost, pool = handed(monkeypatch, {4: [DropError("no rest")], 7: [MemoryError()]})
    assert sorted(done) == [scene_id for scene_id in IDS if scene_id != 4]
    assert (sorted(failed), lost, pool.closed) == ([4, 7], (4,), True)


def test_a_cell_that_serves_no_scene_stops_the_run(monkeypatch):
    error = ConfigError("the tool fits round no part")
    done, failed, lost, pool = handed(monkeypatch, {0: [error], 1: [error], 2: [error]})
    assert (done, failed, lost, pool.closed) == ([], [], error, True)


def test_where_all_are_given_up_the_last_error_is_raised(monkeypatch):
    errors = [DropError("no rest"), DropError("none either")]
    _, failed, lost, pool = handed(monkeypatch, {0: [errors[0]], 1: [errors[1]]}, ids=(0, 1))
    assert len(failed) == 2 and lost in errors and pool.closed
