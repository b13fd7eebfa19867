"""The benchmark of poses: enlarged boxes, and the files that it writes."""

import numpy as np
import pytest
from simulated_dataset import master, master_and_samples, samples  # noqa: F401

from benchmarks.poses import CASES, measure, scaled
from graycast.dataset.read.pose_results import read_pose_results


def test_a_box_is_enlarged_about_its_middle():
    np.testing.assert_allclose(scaled(np.array([10.0, 20, 40, 10]), 1.2), [6, 19, 48, 12])
    np.testing.assert_allclose(scaled(np.array([10.0, 20, 40, 10]), 0.8), [14, 21, 32, 8])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_poses_are_estimated_for_a_dataset_and_written(master, tmp_path):  # noqa: F811
    """The poses follow from perfect depth and masks of prisms; the files have the BOP format."""
    out = tmp_path / "poses"
    words = {"datasets": [master], "instances": 6, "min_visibility": 0.9, "out": out}
    rows = measure(**words, show=lambda text: None)["rows"]
    assert [(row["depth"], row["region"]) for row in rows] == list(CASES)
    (best,) = [row for row in rows if (row["depth"], row["region"]) == ("perfect", "mask")]
    assert best["share"] >= 0.8
    assert len(list(out.glob("*.csv"))) == len(CASES) and len(list(out.glob("*.png"))) == 1
    assert all(len(read_pose_results(csv)) <= 6 for csv in out.glob("*.csv"))
