"""Clouds and figures of a stored dataset."""

import json

import numpy as np
import pytest
from several_pictures import NAMES, SIGMA_M, several  # noqa: F401
from simulated_dataset import master, master_and_samples, samples  # noqa: F401

from graycast.base.errors import GraycastError
from graycast.base.ply import read_vertices
from graycast.cli import main
from graycast.score.merge import merge


@pytest.fixture(scope="module")
def merged(master, tmp_path_factory):  # noqa: F811
    out = tmp_path_factory.mktemp("merge") / "clouds"
    merge(master, out)
    return out


@pytest.mark.slow
def test_the_cloud_of_one_view_is_its_depth_in_world_coordinates(merged, samples):  # noqa: F811
    """Oracle: the depth of the sample, back-projected with the camera matrix."""
    sample = samples[3]
    lines, cloud, count = read_vertices(merged / "train-000003.ply")
    K, T = sample.scene.rig.camera.K, sample.scene.T_world_cam
    row, column = np.nonzero(np.isfinite(sample.scanner_depth.depth_m))
    ray = np.linalg.solve(K, np.stack([column, row, np.ones(len(row))]))
    place = T[:3, :3] @ (ray * sample.scanner_depth.depth_m[row, column]) + T[:3, 3:]
    assert count == len(row)
    assert np.stack([cloud[k] for k in "xyz"]) == pytest.approx(place, abs=1e-4)  # step of depth
    assert (cloud["views"] == 1).all() and (cloud["sigma"] > 0).all()
    assert any("world frame" in line for line in lines)
    assert np.stack([cloud[k] for k in ("red", "green", "blue")], axis=-1).tolist() == (
        sample.rgb[row, column].tolist()
    )


def test_the_surface_counts_as_measured_at_pixels_with_depth(merged):
    record = json.loads((merged / "merge.json").read_text())
    (surface,) = record["surfaces"]
    (view,) = surface["views"]
    assert record["scenes"] == [f"train-{i:06d}" for i in (0, 3, 4, 5)]
    assert surface["measured"] == view["measured"] == view["only_this_view"]
    assert view["measured"] + sum(view["missing"].values()) == pytest.approx(1)
    assert view["filled_by_others"] == {}
    assert surface["best_order"] == [
        {"view": "0", "adds": view["measured"], "together": view["measured"]}
    ]
    assert 0.1 < surface["visible"] < 0.6 and view["measured"] > 0.5


def test_a_single_scene_can_be_merged(master, merged, tmp_path, capsys):  # noqa: F811
    assert (
        main(["dataset", "merge", str(master / "train" / "000004"), "--out", str(tmp_path / "one")])
        == 0
    )
    assert "clouds of 1 scene" in capsys.readouterr().out
    for ending in ("ply", "json"):
        name = f"train-000004.{ending}"
        assert (tmp_path / "one" / name).read_bytes() == (merged / name).read_bytes()


def test_invalid_paths_are_refused_in_one_line(master, tmp_path, capsys):  # noqa: F811
    def refused(*arguments):
        assert main(["dataset", "merge", *map(str, arguments)]) == 1
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        return line

    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    out = tmp_path / "out"
    assert "is not empty" in refused(master, "--out", tmp_path / "full")
    assert "lies in the dataset" in refused(master, "--out", master / "clouds")
    assert "no finished scene" in refused(master / "train" / "000077", "--out", out)
    assert "not a Graycast dataset" in refused(tmp_path, "--out", out)
    assert not out.exists() and not (master / "clouds").exists()


def test_real_pictures_are_refused(tmp_path, monkeypatch, master):  # noqa: F811
    from graycast.dataset.read.stored import StoredDataset

    monkeypatch.setattr(StoredDataset, "real", property(lambda self: True))
    with pytest.raises(GraycastError, match="nobody knows where the camera stood"):
        merge(master, tmp_path / "out")


@pytest.mark.slow
def test_several_pictures_of_a_scene_become_one_cloud(several, tmp_path):  # noqa: F811
    """Oracle: the known positions of parts and floor, and their visibility in each picture."""
    out, taken = several
    record = merge(out, tmp_path / "clouds")
    assert record["scenes"] == ["train-000000", "train-000003"]
    figures = json.loads((tmp_path / "clouds/train-000003.json").read_text())
    measured = [int((sample.scanner_depth.reason == 0).sum()) for sample in taken[3]]
    assert [view["view"] for view in figures["cloud"]["views"]] == list(NAMES)
    assert [view["measured_px"] for view in figures["cloud"]["views"]] == measured
    assert max(measured) < figures["cloud"]["points"] < sum(measured)
    for group in figures["cloud"]["by_views"][:2]:
        # Pixels are 3 mm wide, so planes at edges are tilted; sigma does not include this.
        assert abs(group["error_median_m"]) < 0.2 * SIGMA_M
        assert group["error_sigma_m"] == pytest.approx(group["sigma_m"], rel=0.4)
        assert group["within_3_sigma"] > 0.9
    all_four = figures["cloud"]["by_views"][3]
    assert all_four["error_sigma_m"] == pytest.approx(SIGMA_M / 2, rel=0.15)
    assert all_four["within_3_sigma"] > 0.98
    (surface,) = record["surfaces"]
    first = surface["views"][0]
    assert surface["scenes"] == 2
    assert surface["measured"] >= max(view["measured"] for view in surface["views"])
    assert first["filled_by_others"]["saturated"] > 0.01  # the hole in the first view
    assert all("saturated" not in view["filled_by_others"] for view in surface["views"][1:])
    assert figures["cloud"]["first_reason"]["saturated"] > 0
