"""Every scene is made or given up, whatever happens to its workers."""

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
    """A pool of three workers whose tries fail by a script; the last submitted scene ends first."""

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


def test_each_scene_is_made_exactly_once():
    done, failed, submitted = outcomes()
    assert (done, failed) == (list(IDS), [])
    assert set(submitted.values()) == {1}


@pytest.mark.parametrize("error", [WorkerDied("killed"), DeviceError("lost"), MemoryError()])
def test_a_scene_whose_error_may_be_the_machine_s_fault_is_tried_again(error):
    done, failed, submitted = outcomes({4: [error] * 2, 19: [error]})
    assert done == list(IDS)
    assert [(f.scene_id, f.tries, f.final) for f in failed] == [
        (4, 1, False),
        (19, 1, False),
        (4, 2, False),
    ]
    assert (submitted[4], submitted[19], submitted[5]) == (3, 2, 1)


def test_three_failures_of_a_scene_give_up_only_this_scene():
    done, failed, submitted = outcomes({4: [WorkerDied("killed")] * 9})
    assert done == [scene_id for scene_id in IDS if scene_id != 4]
    assert [f.final for f in failed] == [False, False, True]
    assert submitted[4] == TRIES == 3


@pytest.mark.parametrize("error", [DropError("no rest"), ValueError("dark")])
def test_a_scene_whose_error_would_recur_is_given_up_at_once(error):
    _, failed, submitted = outcomes({4: [error]})
    assert [(f.scene_id, f.tries, f.final) for f in failed] == [(4, 1, True)]
    assert submitted[4] == 1


def test_losing_scene_after_scene_ends_the_run():
    """Its driver is lost after six scenes; with three workers, 13 scenes in a row fail."""
    results = []
    lost = {scene_id: [DeviceError("no driver")] * 9 for scene_id in range(6, 40)}
    with pytest.raises(GraycastError, match=r"13 scenes in a row.*no driver: repair the machine"):
        for outcome in make_all(Scripted(lost), range(40)):
            results.append(outcome)
    assert all(isinstance(o, TaskResult) for o in results[:-13])
    assert all(isinstance(o, Failed) and not o.final for o in results[-13:])


def test_occasionally_failing_scenes_do_not_end_a_run():
    script = {scene_id: [WorkerDied("killed")] for scene_id in range(0, 80, 2)}
    script |= {
        scene_id: [DropError("no rest")] for scene_id in range(80, 100)
    }  # by their own fault
    outcomes = list(make_all(Scripted(script), range(100)))
    assert sum(isinstance(o, TaskResult) for o in outcomes) == 80


def test_an_unknown_engine_for_workers_is_refused(task):
    with pytest.raises(ValueError, match="no engine 'slurm': choose 'local' or 'ray'"):
        open_pool(task, Workers(engine="slurm", count=2), scenes=2)


def handed(monkeypatch, script, ids=IDS, before=1):
    """Return the results and failures that `make_missing` reports, and the scenes it gives up."""
    pool, results, failed, meter = Scripted(script), [], [], Metered()
    monkeypatch.setattr(workers, "open_pool", lambda *_, **words: pool)
    whole = before + len(ids)
    try:
        lost = make_missing(
            Job(seed=0, device="cpu"),
            ids,
            what="scenes",
            total=whole,
            progress=meter,
            on_result=results.append,
            on_failed=failed.append,
        )
    except Exception as raised:
        lost = raised
    assert meter.counts == [("scenes", before + k, whole) for k in range(1 + len(results))]
    return [one.scene_id for one in results], [one.scene_id for one in failed], lost, pool


def test_abandoned_scenes_are_reported_after_all_other_scenes_are_made(monkeypatch):
    script = {9: [KeyError("a bug")] * 3, 4: [DropError("no\nrest")], 7: [MemoryError()]}
    done, failed, lost, pool = handed(monkeypatch, script)
    assert sorted(done) == [scene_id for scene_id in IDS if scene_id not in (4, 9)]
    assert (sorted(failed), pool.closed) == ([4, 7, 9, 9, 9], True)
    first, second = (one.set_aside() for one in lost)
    assert (first.scene_id, first.tries, first.reason) == (4, 1, "no rest")
    assert (second.scene_id, second.tries, second.reason) == (9, 3, "KeyError 'a bug'")
    assert first.traceback == "" and "KeyError: 'a bug'" in second.traceback


def test_a_device_that_fails_only_briefly_costs_no_scene(monkeypatch):
    """A rescan used to end at the first such error, while `generate` tried three times."""
    script = {19: [DeviceError("lost")] * 2, 4: [DeviceError("lost")]}
    done, failed, lost, _ = handed(monkeypatch, script, before=0)
    assert (sorted(done), sorted(failed), lost) == (list(IDS), [4, 19, 19], ())


@pytest.mark.parametrize(
    "error", [ConfigError("the tool fits round no part"), DropError("no rest")]
)
def test_the_third_abandoned_scene_ends_a_run_in_which_no_scene_succeeded(monkeypatch, error):
    script = {scene_id: [error] for scene_id in IDS}
    done, failed, lost, pool = handed(monkeypatch, script, before=0)
    assert (done, len(failed), lost, pool.closed) == ([], 2, error, True)


def test_an_unforeseen_error_is_raised_with_its_type(monkeypatch):
    script = {0: [KeyError("a bug")] * 3}
    _, _, lost, _ = handed(monkeypatch, script, ids=(0,), before=0)
    assert isinstance(lost, GraycastError) and isinstance(lost.__cause__, KeyError)
    assert str(lost) == "KeyError 'a bug': this is an error in Graycast or in the machine"


def test_failing_scenes_are_set_aside_if_other_scenes_succeeded(monkeypatch):
    errors = [DropError("no rest"), DropError("none either")]
    script = {0: [errors[0]], 1: [errors[1]]}
    _, failed, lost, pool = handed(monkeypatch, script, ids=(0, 1))
    assert (sorted(failed), [one.error for one in lost]) == ([0, 1], errors)
    assert pool.closed
    _, failed, lost, _ = handed(monkeypatch, {0: [errors[0]], 1: [errors[1]]}, (0, 1), before=0)
    assert len(failed) == 1 and lost in errors


class Compiled(Job):
    compiled = False

    def compile_kernels(self):
        type(self).compiled = True


@pytest.mark.parametrize(("count", "compiles"), [(1, False), (2, True)])
def test_kernels_are_compiled_once_before_several_workers_need_them(monkeypatch, count, compiles):
    monkeypatch.setattr(workers, "open_pool", lambda *_, **words: Scripted())
    monkeypatch.setattr(Compiled, "compiled", False)
    make_missing(
        Compiled(seed=0, device="cpu"),
        IDS,
        what="scenes",
        total=20,
        workers=Workers(count=count),
        progress=Metered(),
        on_result=lambda _: None,
        on_failed=lambda _: None,
    )
    assert Compiled.compiled == compiles
