"""A small finished dataset of scenes in closed form, and its samples."""

from dataclasses import replace

import pytest
from prisms import CONFIG, SCALE_MM, SEED, box_part, build_sample, make_rig, wedge_part

from graycast.dataset.write.store import open_store


@pytest.fixture(scope="session")
def parts():
    return (box_part(), wedge_part())


@pytest.fixture(scope="session")
def rig():
    return make_rig()


@pytest.fixture(scope="session")
def samples(parts, rig):
    return {scene_id: build_sample(scene_id, parts=parts, rig=rig) for scene_id in (0, 3)}


@pytest.fixture(scope="session")
def another_time():
    """Return the same sample, made by a run that took longer."""
    return lambda sample: replace(
        sample, manifest={**sample.manifest, "timings": {"render_s": 99.0}}
    )


@pytest.fixture(scope="session")
def opened(parts, rig):
    """Open a store in a folder; keywords replace its arguments."""

    def open_folder(out, **changed):
        settings = {
            "config": CONFIG,
            "seed": SEED,
            "parts": parts,
            "rig": rig,
            "depth_scale_mm": SCALE_MM,
        }
        return open_store(out, **{**settings, **changed})

    return open_folder


@pytest.fixture(scope="session")
def dataset(tmp_path_factory, opened, samples):
    """A finished dataset of two scenes, 0 and 3. Tests that change it copy it."""
    out = tmp_path_factory.mktemp("dataset") / "out"
    with opened(out) as store:
        for scene_id, sample in samples.items():
            store.write(scene_id, [sample])
        store.finish(samples)
    return out
