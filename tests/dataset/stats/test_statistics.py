"""Statistics of a dataset, compared with another count of the same files and arrays."""

import json
import shutil

import cv2
import numpy as np
import pytest
from drawn import axes_of, figures_of, heights_of
from pictured import SCALE_MM, forget, write_dataset

from graycast.base.errors import DatasetError
from graycast.camera.decode import Reason
from graycast.dataset.read.scene_content import scene_content
from graycast.dataset.read.stored import open_dataset
from graycast.dataset.stats import (
    dataset_statistics,
    scene_figures,
    statistics_json,
    statistics_table,
    stats_plots,
    write_statistics,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset_and_samples(tmp_path_factory):
    out = tmp_path_factory.mktemp("statistics") / "out"
    return out, write_dataset(out)


@pytest.fixture(scope="module")
def statistics(dataset_and_samples):
    return dataset_statistics(dataset_and_samples[0])


def test_labels_from_run_lengths_equal_the_mask_pictures(dataset_and_samples):
    """Oracle: the PNGs of mask_visib, which other code writes."""
    for scene in open_dataset(dataset_and_samples[0]).scenes:
        label = scene_content(scene).label
        painted = np.full(label.shape, -1)
        for path in (scene.folder / "mask_visib").glob("*.png"):
            painted[cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0] = int(path.stem[-6:])
        np.testing.assert_array_equal(label, painted)


def test_counts_in_the_statistics_equal_those_of_the_samples(dataset_and_samples, statistics):
    _, samples = dataset_and_samples
    visible = np.concatenate(
        [
            np.bincount(s.truth.instance[s.truth.instance >= 0], minlength=8)
            for s in samples.values()
        ]
    )
    parts = np.concatenate([s.layout.part_index for s in samples.values()])
    assert statistics.scenes == {"train": 2}
    assert statistics.instances == {8: 2}
    for one in statistics.classes:
        own = parts == one.obj_id - 1
        assert one.name == ("box", "wedge")[one.obj_id - 1]
        assert (one.instances, one.scenes) == (own.sum(), 2)
        assert one.visib_fract.sum() == own.sum()
        assert one.side_px.sum() == one.box_px.sum() == (visible[own] > 0).sum()
    sizes = np.digitize(visible[visible > 0], (32**2, 96**2 + 1))
    assert list(statistics.areas.values()) == np.bincount(sizes, minlength=3).tolist()


def test_shares_of_reasons_agree_with_the_maps_of_reasons(dataset_and_samples, statistics):
    reason = np.stack([s.scanner_depth.reason for s in dataset_and_samples[1].values()])
    on_part = np.stack([s.truth.instance >= 0 for s in dataset_and_samples[1].values()])
    for one in Reason:
        name = one.name.lower()
        assert statistics.reason[name] == pytest.approx((reason == one).mean(), abs=1e-12)
        assert statistics.part_reason[name] == pytest.approx(
            (reason[on_part] == one).mean(), abs=1e-12
        )


def test_the_noise_of_the_scanner_is_estimated_correctly(statistics):
    """Oracle: Gaussian noise and rounding of both depths: sqrt(0.2^2 + 2 * 0.1^2 / 12) mm."""
    error = statistics.error
    sigma_mm = np.sqrt(0.2**2 + 2 * SCALE_MM**2 / 12)
    standard_error_mm = sigma_mm / np.sqrt(error.pixels)
    assert abs(error.sigma_mm - sigma_mm) < 4 * 1.0 * standard_error_mm
    assert abs(error.rms_mm - sigma_mm) < 4 * 0.71 * standard_error_mm
    assert abs(error.median_mm) < 4 * 1.26 * standard_error_mm
    assert error.beyond_1mm < 1e-4


def test_the_range_of_depth_includes_the_wall(dataset_and_samples, statistics):
    depth_mm = 1e3 * np.concatenate(
        [s.truth.depth_m.ravel() for s in dataset_and_samples[1].values()]
    )
    for name, share in (("p01", 0.01), ("p50", 0.5), ("p99", 0.99)):
        assert abs(statistics.depth_quantiles_mm[name] - np.quantile(depth_mm, share)) <= 5.0 + 1e-6


def test_statistics_are_read_back_from_json(dataset_and_samples):
    figures = scene_figures(scene_content(open_dataset(dataset_and_samples[0]).scene(3)))
    assert type(figures).model_validate_json(figures.model_dump_json()) == figures


def test_statistics_files_and_table_are_written(dataset_and_samples, statistics, tmp_path):
    with figures_of(stats_plots) as figures:
        write_statistics(statistics, tmp_path / "figures")
    record = json.loads((tmp_path / "figures/stats.json").read_text())
    assert record == json.loads(json.dumps(statistics_json(statistics)))
    assert record["pixels"] == 2 * 160 * 120
    assert (tmp_path / "figures/stats.png").is_file()
    axes = axes_of(figures[0])
    instances = sum(one.instances for one in statistics.classes)
    assert sum(heights_of(axes[f"Instances per scene ({instances:,} in all)"])) == 2
    assert sum(heights_of(axes["Visibility"])) == instances
    assert sum(heights_of(axes["Mask size"])) == sum(statistics.areas.values())
    assert sum(heights_of(axes["Perfect depth"])) == pytest.approx(100)
    shares = [bar.get_width() for bar in axes["Why there is no depth"].patches]
    assert sum(shares) == pytest.approx(200)
    assert max(shares) == pytest.approx(
        100 * max(*statistics.reason.values(), *statistics.part_reason.values())
    )
    assert sum(heights_of(axes["Decoded share of parts"])) == 2
    for _, percent in ((line.get_xdata(), line.get_ydata()) for line in axes["Brightness"].lines):
        assert np.sum(percent) == pytest.approx(100)
    assert statistics_table(statistics).row_count > 8


def test_statistics_of_real_pictures_omit_unknown_figures(dataset_and_samples, tmp_path):
    out = tmp_path / "real"
    shutil.copytree(dataset_and_samples[0], out)
    whole = dataset_statistics(out)
    forget(out)
    bare = dataset_statistics(out)
    assert bare.error.pixels == 0 and not bare.depth_bin and not bare.gray
    assert bare.reason["decoded"] == whole.reason["decoded"]
    assert bare.reason["missing"] == pytest.approx(1 - whole.reason["decoded"])
    assert [c.instances for c in bare.classes] == [c.instances for c in whole.classes]
    assert sum(c.visib_fract.sum() for c in bare.classes) == 0


def test_splits_are_counted_separately(dataset_and_samples, tmp_path):
    out = tmp_path / "split"
    shutil.copytree(dataset_and_samples[0], out)
    (out / "val").mkdir()
    (out / "train/000003").rename(out / "val/000003")
    assert [scene.key for scene in open_dataset(out).scenes] == ["train-000000", "val-000003"]
    assert dataset_statistics(out).scenes == {"train": 1, "val": 1}


def test_a_folder_without_a_dataset_or_without_scenes_is_refused(dataset_and_samples, tmp_path):
    with pytest.raises(DatasetError, match="is not a Graycast dataset"):
        dataset_statistics(tmp_path)
    out = shutil.copytree(
        dataset_and_samples[0], tmp_path / "out", ignore=shutil.ignore_patterns("train")
    )
    with pytest.raises(DatasetError, match="has no finished scene"):
        dataset_statistics(out)


def test_a_damaged_picture_is_named(dataset_and_samples, tmp_path):
    out = tmp_path / "damaged"
    shutil.copytree(dataset_and_samples[0], out)
    path = out / "train/000003/depth_sl/000000.png"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(DatasetError, match=r"000003.*depth_sl.*cut off"):
        dataset_statistics(out)


@pytest.mark.slow
def test_the_number_of_processes_does_not_change_the_statistics(dataset_and_samples, statistics):
    again = dataset_statistics(dataset_and_samples[0], workers=2)
    assert statistics_json(again) == statistics_json(statistics)
