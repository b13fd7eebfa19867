"""A worker keeps its renderer between scenes, but not after an unforeseen error."""

from contextlib import closing
from dataclasses import replace

import pytest

from graycast.base.errors import DecodeError, DeviceError, DropError
from graycast.cell.engine import SceneMaker, SceneTask, job, maker
from graycast.rendering import Renderer


class Opened(Renderer):
    """A renderer that records whether it is open."""

    name, versions, device, denoiser = "open", {}, "cpu", "oidn"

    def __init__(self):
        self.closed = False

    def close(self):
        self.closed = True


def opened_for(task, monkeypatch, *errors):
    """Return the renderers that a worker opens for scenes with these errors, in order."""
    renderers, used, left = [], [], list(errors)

    def open_one(cell, **words):
        renderers.append(Opened())
        return renderers[-1]

    def make(cell, scene_id, *, renderer, **words):
        used.append(renderer)
        assert not renderer.closed
        raise left.pop(0)

    monkeypatch.setattr(job, "open_configured", open_one)
    monkeypatch.setattr(maker, "make_images", make)
    with closing(SceneMaker(task)) as worker:
        for scene_id, error in enumerate(errors):
            with pytest.raises(type(error)):
                worker.make(scene_id)
    assert all(renderer.closed for renderer in renderers)
    return [renderers.index(renderer) for renderer in used]


@pytest.mark.parametrize("error", [DropError("no rest"), DecodeError("dark"), ValueError("black")])
def test_an_expected_error_of_a_scene_leaves_the_renderer_open(task, monkeypatch, error):
    assert opened_for(task, monkeypatch, error, error, error) == [0, 0, 0]


@pytest.mark.parametrize(
    "error", [RuntimeError("driver lost"), MemoryError(), DeviceError("gone"), KeyboardInterrupt()]
)
def test_the_renderer_is_opened_again_after_an_unforeseen_error(task, monkeypatch, error):
    """The old one may have a lost device, or half of a scene."""
    assert opened_for(task, monkeypatch, error, DropError("no rest"), error) == [0, 1, 1]


def test_a_task_moved_to_another_device_keeps_all_other_values(task):
    """Workers of a cluster receive such a job; another seed or cell would give other scenes."""
    there = replace(task, device="cuda")
    assert isinstance(there, SceneTask) and (there.device, task.device) == ("cuda", "cpu")
    assert there.cell is task.cell and (there.seed, there.graycast) == (task.seed, task.graycast)
