"""The probability that a depth is wrong in the files of a decoded stack."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from graycast.base.ply import read_vertices
from graycast.camera.stack import decode_stack, write_result
from graycast.camera.stack.decoding import _pixel_cloud
from graycast.rig.pattern import gray

from .simulated import describe, save, shoot, small_rig


@pytest.fixture(scope="module")
def rig_and_result(tmp_path_factory):
    rig, code = small_rig(), gray(128, 96)
    folder = tmp_path_factory.mktemp("stack")
    return rig, decode_stack(save(folder, describe(code), shoot(rig, code)), rig)


def test_depth_without_probabilities_writes_none(rig_and_result, tmp_path):
    _, result = rig_and_result
    write_result(result, tmp_path / "out")
    assert not (tmp_path / "out/p_wrong.npy").exists()
    assert "p_wrong" not in read_vertices(tmp_path / "out/cloud.ply")[1]


def test_map_and_cloud_have_the_probability_of_each_depth(rig_and_result, tmp_path):
    rig, result = rig_and_result
    known = np.isfinite(result.depth.depth_m)
    p_wrong = np.random.default_rng(1).uniform(0, 1, known.shape).astype(np.float32)
    depth = replace(result.depth, p_wrong=np.where(known, p_wrong, np.float32(np.nan)))
    cloud = _pixel_cloud(depth, rig, result.picture)
    write_result(replace(result, depth=depth, cloud=cloud), tmp_path / "out")
    np.testing.assert_array_equal(np.load(tmp_path / "out/p_wrong.npy"), depth.p_wrong)
    table = read_vertices(tmp_path / "out/cloud.ply")[1]
    np.testing.assert_array_equal(table["p_wrong"], p_wrong[known])


def test_the_preview_draws_certain_depth_dark_and_doubtful_depth_bright(rig_and_result, tmp_path):
    _, result = rig_and_result
    pictures = []
    for p in (1e-4, 1.0):
        known = np.isfinite(result.depth.depth_m)
        p_wrong = np.where(known, np.float32(p), np.float32(np.nan))
        write_result(
            replace(result, depth=replace(result.depth, p_wrong=p_wrong)), tmp_path / "out"
        )
        with Image.open(tmp_path / "out/preview.png") as preview:
            pictures.append(np.asarray(preview.convert("L")).astype(int))
    dark, bright = pictures
    differs = dark != bright
    assert differs.any() and (dark[differs] < 10).all() and (bright[differs] > 200).all()
