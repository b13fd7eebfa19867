"""Complete scenes of a domain, from the configuration to the files."""

import json

import numpy as np
import pytest
from cells import differences
from small_cell import content, write_cell
from test_vary import NO_TOLERANCE

from graycast.cell.config import load_config
from graycast.cell.domain import vary
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.simulate import make_scene
from graycast.dataset.check.checking import validate
from graycast.dataset.write.picture_bytes import depth_scale_mm
from graycast.dataset.write.store import open_store

pytestmark = pytest.mark.slow

RANDOM = {
    "kind": "randomized",
    "camera": {"azimuth_deg": [-20, 20]},
    "distractors": {"count": [2, 4], "parts": [{"builtin": "metal_workpiece_1"}]},
}


def dataset_of(folder, scenes, **changes):
    """Return the cell, its scenes, and the dataset that they make."""
    folder.mkdir()
    path = write_cell(folder, **changes)
    cell = resolve_cell(load_config(path), folder)
    rig, out = cell.scene.rig, folder / "out"
    scale_mm = depth_scale_mm(rig.far_m)
    config = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    with (
        open_cell_renderer(cell, device="cpu") as renderer,
        open_store(
            out, config=config, seed=4, parts=cell.kinds, rig=rig, depth_scale_mm=scale_mm
        ) as store,
    ):
        shots = [make_scene(cell, k, seed=4, renderer=renderer) for k in range(scenes)]
        for k, shot in enumerate(shots):
            store.write(k, [shot.sample])
        store.finish(range(scenes))
    return cell, shots, out


@pytest.fixture(scope="module")
def random_scenes(tmp_path_factory):
    return dataset_of(tmp_path_factory.mktemp("random") / "cell", 3, domain=RANDOM, count=[4, 8])


def test_a_randomized_dataset_is_valid_and_does_not_label_distractors(random_scenes):
    _, _, out = random_scenes
    assert validate(out) == ()
    claim = json.loads((out / "graycast.json").read_text())
    assert [part["name"] for part in claim["parts"]] == ["box"]
    assert [part["name"] for part in claim["distractors"]] == ["metal_workpiece_1"]
    for scene in sorted(out.glob("train/*")):
        manifest = json.loads((scene / "manifest.json").read_text())
        number = manifest["domain"]["distractors"]["metal_workpiece_1"]
        assert 2 <= number <= 4
        poses = json.loads((scene / "scene_gt.json").read_text())["0"]
        assert manifest["counts"] == {"box": len(poses)}
        assert {pose["obj_id"] for pose in poses} == {1}


def test_distractors_are_rendered_in_front_of_the_parts_that_they_hide(random_scenes):
    """Some pixels of the depth picture are above the bin's floor without a visible mask."""
    _, shots, _ = random_scenes
    for shot in shots:
        truth, layout = shot.sample.truth, shot.sample.layout
        foreign = np.flatnonzero(layout.part_index == 1)
        assert np.isin(truth.instance, foreign).sum() > 20


def test_the_manifest_of_a_random_scene_reproduces_the_scene(random_scenes):
    cell, shots, out = random_scenes
    for k, shot in enumerate(shots):
        manifest = json.loads((out / "train" / f"{k:06d}" / "manifest.json").read_text())
        again = vary(cell.domain, cell.scene, (1,), manifest["domain"]).scene
        assert differences(shot.sample.scene, again) == []
    poses = [shot.sample.scene.T_world_cam for shot in shots]
    assert np.abs(poses[0] - poses[1]).max() > 1e-3


def test_one_seed_gives_the_same_random_scenes_again(random_scenes, tmp_path):
    _, _, out = random_scenes
    _, _, again = dataset_of(tmp_path / "again", 3, domain=RANDOM, count=[4, 8])
    assert content(again) == content(out)


def test_a_domain_without_tolerances_gives_the_same_files_as_no_domain(tmp_path):
    """Only the entries of domain, its seed and configuration differ in claim and manifest."""
    _, _, plain = dataset_of(tmp_path / "plain", 2)
    _, _, exact = dataset_of(tmp_path / "exact", 2, domain=NO_TOLERANCE)
    plain, exact = content(plain), content(exact)
    for name in [name for name in exact if name.endswith("manifest.json")]:
        assert "domain" not in plain[name]["seeds"] and "domain" not in plain[name]
        del exact[name]["domain"], exact[name]["seeds"]["domain"]
        del exact[name]["config"]["domain"], plain[name]["config"]["domain"]
        del exact[name]["manifest_sha256"], plain[name]["manifest_sha256"]
    del exact["graycast.json"], plain["graycast.json"]
    assert exact == plain


def test_tolerances_of_a_domain_change_pictures_and_poses(tmp_path):
    _, _, plain = dataset_of(tmp_path / "plain", 1)
    _, shots, adapted = dataset_of(tmp_path / "adapted", 1, domain="adapted")
    assert validate(adapted) == ()
    plain, adapted = content(plain), content(adapted)
    for name in ("rgb/000000.png", "depth/000000.png", "scene_gt.json", "scene_camera.json"):
        assert plain[f"train/000000/{name}"] != adapted[f"train/000000/{name}"]
    off = np.abs(shots[0].sample.scene.T_world_cam[:3, 3]).max()
    assert off < 2
