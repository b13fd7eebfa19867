"""Small scenes, and a dataset of them that was made without interruption."""

import pytest
from small_cell import start, write_cell

from graycast.cell.config import load_config
from graycast.cell.engine import SceneTask
from graycast.cell.resolve import resolve_cell


@pytest.fixture(scope="session")
def config_file(tmp_path_factory):
    return write_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="session")
def task(config_file):
    cell = resolve_cell(load_config(config_file), config_file.parent)
    return SceneTask(cell=cell, seed=0, device="cpu", depth_scale_mm=0.1)


@pytest.fixture(scope="session")
def undisturbed(config_file, tmp_path_factory):
    """Make a dataset of this many scenes with one worker, once for each size."""
    folders = {}

    def of(scenes):
        if scenes not in folders:
            out = tmp_path_factory.mktemp("undisturbed") / "out"
            with start("generate", config_file, "--out", out, "--scenes", scenes) as run:
                _, complaint = run.communicate()
                assert run.returncode == 0, complaint
            folders[scenes] = out
        return folders[scenes]

    return of
