"""The stored probability that a depth is wrong: its steps, its file, and its check."""

from dataclasses import replace

import numpy as np
import pytest

from graycast.base.ply import read_vertices
from graycast.dataset.check.checking import validate
from graycast.dataset.export import Options, Split, export
from graycast.dataset.read.example import probabilities
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.write.picture_bytes import probability_steps

# pycocotools 2.0.11 has an array type from before NumPy 2, which warns about it.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def test_steps_are_logarithmic_from_one_to_a_ten_thousandth():
    p_wrong = np.array([[1, 0.01, 1e-4], [1e-6, 0, np.nan]], dtype=np.float32)
    assert probability_steps(p_wrong).tolist() == [[255, 128, 1], [1, 1, 0]]


def test_a_probability_comes_back_within_half_a_step():
    p_wrong = np.geomspace(1e-4, 1, 1001, dtype=np.float32)[None]
    back = probabilities(probability_steps(p_wrong))
    half_step = 10 ** (2 / 254)
    assert (np.abs(np.log(back / p_wrong)) <= np.log(half_step) + 1e-5).all()
    assert np.isnan(probabilities(np.zeros((1, 1), np.uint8))).all()


def random_probabilities(scene_id, depth_m):
    p_wrong = np.random.default_rng(scene_id).uniform(1e-4, 1, depth_m.shape)
    return np.where(np.isfinite(depth_m), p_wrong, np.nan).astype(np.float32)


def write(out, opened, samples, p_wrong):
    """Write a dataset with the given maps of probabilities, by scene."""
    with opened(out) as store:
        for scene_id, sample in samples.items():
            scanner_depth = replace(sample.scanner_depth, p_wrong=p_wrong[scene_id])
            store.write(scene_id, [replace(sample, scanner_depth=scanner_depth)])
        store.finish(samples)


def test_a_dataset_stores_the_probability_of_each_depth(tmp_path, opened, samples):
    p_wrong = {i: random_probabilities(i, s.scanner_depth.depth_m) for i, s in samples.items()}
    out = tmp_path / "out"
    write(out, opened, samples, p_wrong)
    assert validate(out) == ()
    for scene in open_dataset(out).scenes:
        expected = p_wrong[scene.scene_id]
        stored = scene.p_wrong()
        assert np.array_equal(np.isnan(stored), np.isnan(expected))
        known = np.isfinite(expected)
        assert np.abs(np.log(stored[known] / expected[known])).max() < 0.0182
        np.testing.assert_array_equal(scene.example().p_wrong, stored)


def test_a_dataset_without_probabilities_is_valid_and_has_none(dataset):
    assert validate(dataset) == ()
    assert not (dataset / "train/000000/pwrong_sl").exists()
    assert open_dataset(dataset).scenes[0].p_wrong() is None


def test_a_probability_without_depth_is_a_problem(tmp_path, opened, samples):
    p_wrong = {i: random_probabilities(i, s.scanner_depth.depth_m) for i, s in samples.items()}
    hole = np.argwhere(np.isnan(p_wrong[0]))[0]
    p_wrong[0][tuple(hole)] = 0.5
    write(tmp_path / "out", opened, samples, p_wrong)
    problems = [str(problem) for problem in validate(tmp_path / "out")]
    assert len(problems) == 1
    assert "depth_sl and pwrong_sl disagree in 1 pixels" in problems[0]


@pytest.mark.parametrize("cloud", ["ply", "pcd"])
def test_exported_points_of_the_scanner_have_the_probability(cloud, tmp_path, opened, samples):
    p_wrong = {i: random_probabilities(i, s.scanner_depth.depth_m) for i, s in samples.items()}
    write(tmp_path / "out", opened, samples, p_wrong)
    export(tmp_path / "out", tmp_path / "to", Options(format="clouds", split=Split(), cloud=cloud))
    stored = open_dataset(tmp_path / "out").scenes[0].p_wrong()
    expected = stored[np.isfinite(stored)]
    files = [tmp_path / "to" / "train" / f"000000_{n}.{cloud}" for n in ("scanner", "perfect")]
    if cloud == "ply":
        tables = [read_vertices(file)[1] for file in files]
        np.testing.assert_array_equal(tables[0]["p_wrong"], expected)
        assert "p_wrong" not in tables[1]
        return
    head, body = files[0].read_bytes().split(b"DATA binary\n", 1)
    assert b"FIELDS x y z rgb p_wrong\n" in head
    points = np.frombuffer(body, "<f4").reshape(-1, 5)
    np.testing.assert_array_equal(points[:, 4], expected)
    assert b"p_wrong" not in files[1].read_bytes()
