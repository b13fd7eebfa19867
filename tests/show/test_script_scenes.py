"""Scenes for a script equal those of `generate`, in order, for any number of workers."""

import subprocess
import sys
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import ImageShow
from small_cell import content, write_cell

import graycast
from graycast.base.errors import DropError, GraycastError
from graycast.cell.engine import SceneMaker
from graycast.rig.optics import project
from graycast.show.scenes import _in_order


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return graycast.load_cell(write_cell(tmp_path_factory.mktemp("cell")))


@pytest.fixture(scope="module")
def scenes(cell):
    return list(graycast.scenes(cell, 2, seed=5, device="cpu"))


@pytest.mark.slow
def test_scenes_saved_by_a_script_equal_the_dataset_of_generate(cell, scenes, tmp_path):
    for scene in scenes:
        scene.save(tmp_path / "saved")
    graycast.generate(cell, tmp_path / "generated", scenes=2, seed=5, device="cpu")
    assert content(tmp_path / "saved") == content(tmp_path / "generated")


def test_the_cloud_has_the_points_of_the_pixels_with_depth(scenes):
    """Each point projects to the centre of its pixel, and its z is the depth of this pixel."""
    depth = scenes[0].depth
    row, column = np.nonzero(np.isfinite(depth.depth_m))
    cloud = depth.points()
    assert cloud.shape == (len(row), 3)
    assert len(row) > 1000
    np.testing.assert_allclose(cloud[:, 2], depth.depth_m[row, column])
    pixel = project(scenes[0].shots[0].sample.scene.rig.camera, cloud)
    np.testing.assert_allclose(pixel, np.stack([column, row], axis=-1), atol=1e-4)


@pytest.mark.slow
def test_a_loop_that_ends_early_closes_the_renderer(cell, monkeypatch):
    closed = []
    close = SceneMaker.close
    monkeypatch.setattr(SceneMaker, "close", lambda maker: (closed.append(1), close(maker)))
    loop = graycast.scenes(cell, 3, device="cpu")
    assert [scene.scene_id for scene in islice(loop, 1)] == [0]
    assert not closed
    loop.close()
    assert closed


@pytest.mark.slow
def test_the_seed_of_the_configuration_is_used_unless_a_seed_is_given(cell, scenes):
    first = next(graycast.scenes(cell, 1, device="cpu"))
    assert first.shots[0].sample.manifest["dataset_seed"] == cell.config.seed == 0
    assert not np.array_equal(first.layout.T_world_part, scenes[0].layout.T_world_part)


def test_a_scene_that_cannot_be_made_raises_its_own_error(tmp_path):
    cell = graycast.load_cell(write_cell(tmp_path, drop={"simulated_s": 0.1, "attempts": 1}))
    with pytest.raises(DropError):
        next(graycast.scenes(cell, 1, device="cpu"))


@pytest.mark.slow
def test_a_sheet_is_saved_without_a_viewer(scenes, monkeypatch):
    monkeypatch.setattr(ImageShow, "_viewers", [])
    sheet = scenes[0].sheet()
    assert np.asarray(sheet).std() > 20  # not a uniform colour
    monkeypatch.setattr(type(scenes[0]), "sheet", lambda scene: sheet)  # The sheet is drawn once.
    with pytest.raises(GraycastError, match=r"sheet\.png"):
        scenes[0].show()


@pytest.mark.slow
def test_workers_serve_a_script_without_a_main_guard_and_keep_the_order(cell, scenes, tmp_path):
    """`spawn` would run a script without this guard again in each worker."""
    script = tmp_path / "script.py"
    script.write_text(
        "import graycast as gc\n"
        f"cell = gc.load_cell({str(write_cell(tmp_path))!r})\n"
        "for scene in gc.scenes(cell, 2, seed=5, device='cpu', workers=gc.Workers(count=2)):\n"
        "    print(scene.scene_id, scene.save('out').name)\n"
    )
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.stdout == "0 000000\n1 000001\n", done.stderr
    for scene in scenes:
        scene.save(tmp_path / "here")
    assert content(tmp_path / "out") == content(tmp_path / "here")


def test_a_cell_is_read_from_a_file_or_from_values(tmp_path):
    path = write_cell(tmp_path)
    of_file = graycast.load_cell(str(path))
    of_values = graycast.load_cell(graycast.load_config(path), folder=tmp_path)
    assert of_file.config == of_values.config
    assert of_file.file_digests == of_values.file_digests
    with pytest.raises(GraycastError, match=r"box\.stl"):
        graycast.load_cell(graycast.load_config(path), folder=Path("elsewhere"))


class PoolWithASlowScene:
    """A pool that finishes scene 0 only after all other submitted scenes."""

    def __init__(self, workers):
        self.workers, self.at_work, self.submitted = workers, [], 0

    @property
    def free(self):
        return self.workers - len(self.at_work)

    def submit(self, scene_id):
        self.at_work.append(scene_id)
        self.submitted += 1

    def gather(self):
        scene_id = max(self.at_work)
        self.at_work.remove(scene_id)
        return SimpleNamespace(scene_id=scene_id, shots=(scene_id,))

    def close(self):
        self.at_work.clear()


@pytest.mark.parametrize("workers", [1, 3])
def test_scenes_behind_a_slow_one_do_not_accumulate_in_memory(workers):
    """Symptom: all later scenes, hundreds of MB each, wait for the first scene."""
    pool = PoolWithASlowScene(workers)
    order = []
    for (scene_id,) in _in_order(pool, 40):
        order.append(scene_id)
        assert pool.submitted - scene_id <= 2 * workers
    assert order == list(range(40))
