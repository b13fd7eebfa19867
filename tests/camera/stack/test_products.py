"""The probability that a depth is wrong in the files of a decoded stack."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from graycast.base.ply import read_vertices
from graycast.camera.decode import Reason
from graycast.camera.stack import decode_stack, write_result
from graycast.camera.stack.decoding import _pixel_cloud
from graycast.rig.pattern import gray, gray_phase
from graycast.score.evaluate.shares import roc_auc

from .simulated import describe, save, shoot, small_rig, view_of


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
    result = replace(result, depth=depth, p_wrong=depth.p_wrong, cloud=cloud)
    write_result(result, tmp_path / "out")
    np.testing.assert_array_equal(np.load(tmp_path / "out/p_wrong.npy"), depth.p_wrong)
    table = read_vertices(tmp_path / "out/cloud.ply")[1]
    np.testing.assert_array_equal(table["p_wrong"], p_wrong[known])


def test_the_preview_draws_certain_depth_dark_and_doubtful_depth_bright(rig_and_result, tmp_path):
    _, result = rig_and_result
    pictures = []
    for p in (1e-4, 1.0):
        known = np.isfinite(result.depth.depth_m)
        p_wrong = np.where(known, np.float32(p), np.float32(np.nan))
        write_result(replace(result, p_wrong=p_wrong), tmp_path / "out")
        with Image.open(tmp_path / "out/preview.png") as preview:
            pictures.append(np.asarray(preview.convert("L")).astype(int))
    dark, bright = pictures
    differs = dark != bright
    assert differs.any() and (dark[differs] < 10).all() and (bright[differs] > 200).all()


@pytest.mark.slow
def test_a_stack_without_a_rig_has_the_probability_that_a_position_is_wrong(tmp_path):
    """Oracle: true positions. In the right half, each pixel also sees light from 25 px away."""
    rig, code = small_rig(), gray_phase(128, 96)
    pictures = shoot(rig, code).astype(np.float64)
    pictures[:, :, 80:] = 0.55 * pictures[:, :, 80:] + 0.45 * pictures[:, :, 55:-25]
    settings = {"doubt": 0.0, "max_p_wrong": 0.9999}

    def decoded(**more):
        content = describe(code) | {"decode": settings | more}
        return decode_stack(save(tmp_path, content, np.rint(pictures).astype(np.uint8)))

    everything, sure = decoded(), decoded(max_p_wrong=0.05)
    p_wrong, known = everything.p_wrong, np.isfinite(everything.codes.column)
    assert np.array_equal(np.isfinite(p_wrong), known)
    wrong = np.abs(everything.codes.column - view_of(rig).column) > 1
    assert 0.02 < wrong[known].mean() < 0.5
    assert roc_auc(p_wrong[known], wrong[known]) > 0.9
    left = p_wrong <= np.float32(0.05)
    for values in (sure.codes.column, sure.p_wrong):
        assert np.array_equal(np.isfinite(values), left)
    assert np.array_equal(sure.codes.reason == Reason.DECODED, left)
    assert sure.figures.reasons["decoded"] == pytest.approx(left.mean())
    write_result(sure, tmp_path / "out")
    np.testing.assert_array_equal(np.load(tmp_path / "out/p_wrong.npy"), sure.p_wrong)
