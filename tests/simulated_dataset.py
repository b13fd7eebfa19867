"""A small finished dataset in closed form with its samples, for tests outside tests/dataset."""

import sys
from functools import cache
from pathlib import Path

import pytest

from graycast.dataset.export import Options, Split, export
from graycast.dataset.write.store import open_store

sys.path.append(str(Path(__file__).parent / "dataset"))
from prisms import CONFIG, SCALE_MM, SEED, box_part, build_sample, make_rig, wedge_part


@cache
def _sample(scene_id):
    """Return a sample, which is made once per process; a test that changes it must copy it."""
    return build_sample(scene_id, parts=(box_part(), wedge_part()), rig=make_rig())


def write_dataset(out, scene_ids=(0, 3, 4, 5)):
    """Write the dataset and return the samples by scene."""
    parts, rig = (box_part(), wedge_part()), make_rig()
    samples = {i: _sample(i) for i in scene_ids}
    with open_store(
        out, config=CONFIG, seed=SEED, parts=parts, rig=rig, depth_scale_mm=SCALE_MM
    ) as store:
        for scene_id, sample in samples.items():
            store.write(scene_id, [sample])
        store.finish(samples)
    return samples


@pytest.fixture(scope="session")
def master_and_samples(tmp_path_factory):
    """Return one dataset for all formats; a test that changes it must copy it."""
    out = tmp_path_factory.mktemp("master") / "out"
    return out, write_dataset(out)


@pytest.fixture(scope="session")
def master(master_and_samples):
    return master_and_samples[0]


@pytest.fixture(scope="session")
def samples(master_and_samples):
    return master_and_samples[1]


@pytest.fixture
def exported(master, tmp_path):
    """Return a function that exports the dataset; its keyword arguments are export options."""

    def run(form, **options):
        options.setdefault("split", Split())
        out = tmp_path / f"{form}-{len(list(tmp_path.iterdir()))}"
        export(master, out, Options(format=form, **options))
        return out

    return run


def require_library(form):
    """Skip the test if the library that an export format needs is not installed."""
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="pip install 'graycast[parquet]'")
    if form == "rerun":
        pytest.importorskip("rerun", reason="needs rerun: run make extras")


def visible(sample):
    """Return the visible instances, their masks, and their boxes [x, y, columns, rows]."""
    instances = [i for i in range(8) if (sample.truth.instance == i).any()]
    masks = [sample.truth.instance == i for i in instances]
    boxes = []
    for mask in masks:
        y, x = mask.nonzero()
        boxes.append([x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1])
    return instances, masks, boxes
