"""Records of the statistics of depth maps: combination, files, table and plots."""

import cv2
import numpy as np
import pytest
from drawn import axes_of, figures_of, heights_of, lines_of

from graycast.base.errors import DatasetError, GraycastError
from graycast.real.realism import depth_curves, draw_realism, pool, read_record, table, write_record
from graycast.real.realism.measure import measure_scan
from graycast.real.realism.realism_record import Jumps

from .synthetic import plates, scan, scattered_plates

SIDES = ("right_farther", "left_farther", "below_farther", "above_farther")


def noisy_scan(seed, sigma_m=1e-4):
    rng = np.random.default_rng(seed)
    depth_m = plates((0.2, 0.0, 0.0), scattered_plates(rng))
    gray = rng.uniform(0.1, 0.9, depth_m.shape)
    return scan(depth_m + sigma_m * rng.standard_normal(depth_m.shape), gray=gray)


@pytest.fixture(scope="module")
def record():
    return pool([measure_scan(noisy_scan(seed)) for seed in range(3)], name="three")


def test_a_set_of_equal_maps_has_the_statistics_of_one_map():
    one = measure_scan(noisy_scan(1))
    single, triple = pool([one], name="x"), pool([one] * 3, name="x")
    counted = {"scans", "pixels", "noise", "fine", "missing", "autocorrelation", "baseline"}
    assert single.model_dump(exclude=counted) == triple.model_dump(exclude=counted)
    assert single.missing.share == triple.missing.share
    assert single.noise.percentiles_m == pytest.approx(triple.noise.percentiles_m, rel=0.05)
    assert single.autocorrelation.along_rows == pytest.approx(triple.autocorrelation.along_rows)


def test_a_record_is_read_back_from_its_file(tmp_path, record):
    write_record(record, tmp_path / "realism.json")
    assert read_record(tmp_path) == record == read_record(tmp_path / "realism.json")


def test_a_record_of_another_version_or_form_is_refused(tmp_path, record):
    path = tmp_path / "realism.json"
    path.write_text(record.model_dump_json().replace('"format_version":4', '"format_version":9'))
    with pytest.raises(DatasetError, match="format_version 9"):
        read_record(path)
    path.write_text('{"format_version": 1}')
    with pytest.raises(DatasetError, match="measure the depth maps again"):
        read_record(path)


def test_an_empty_set_of_depth_maps_is_refused():
    with pytest.raises(GraycastError, match="give at least one"):
        pool([], name="nothing")


def test_the_table_has_the_statistics_in_readable_units(record):
    lines = {line[:45].strip(): line[45:].strip() for line in table(record).splitlines()}
    text = "\n".join(table(record).splitlines())
    assert f"{1e3 * record.noise.percentiles_m[2]:.4f} mm" in text
    assert f"{100 * record.missing.share:.1f} %" in text
    assert f"{1e3 * record.baseline.baseline_m:.1f} +- " in text
    assert all(len(line) <= 100 for line in lines)


def test_two_sets_are_side_by_side_with_a_dash_for_a_missing_figure(record):
    rng = np.random.default_rng(5)
    bare = pool([measure_scan(scan(0.5 + 1e-4 * rng.standard_normal((240, 320))))], name="bare")
    lines = table(record, bare).splitlines()
    assert lines[0].split() == ["three", "bare"]
    widths = {len(line) for line in lines if line.endswith(("-", "%", "mm"))}
    assert len(widths) == 1
    drop_out = next(line for line in lines if "50 to 99 %" in line)
    assert drop_out.split()[-1] == "-"
    names = [line.strip() for line in table(bare, record).splitlines()]
    assert sum("sigma of z, median" in name for name in names) == 2  # about planes, and fine


@pytest.mark.slow
def test_the_plots_show_the_statistics_of_each_record(tmp_path, record):
    """Oracle: the values of the record, in the units of the axes."""
    other = record.model_copy(update={"name": "other", "jumps": Jumps(**dict.fromkeys(SIDES, 7.0))})
    with figures_of(depth_curves) as figures:
        draw_realism([record, other], tmp_path / "two.png")
    axes = axes_of(figures[0])
    for sigma_mm, share in lines_of(axes["noise about planes"]):
        assert sigma_mm == pytest.approx(1e3 * np.array(record.noise.percentiles_m))
        assert share == pytest.approx([5, 25, 50, 75, 95])
    own = [getattr(record.jumps, side) for side in SIDES]
    assert heights_of(axes["jumps between valid neighbours"]) == pytest.approx([*own, *[7.0] * 4])
    along = axes["autocorrelation (dashed: along columns)"]
    (lag, rows), (_, columns) = lines_of(along)[:2]
    assert lag == pytest.approx([0, 1, 2, 3])
    assert rows == pytest.approx([1.0, *record.autocorrelation.along_rows])
    assert columns == pytest.approx([1.0, *record.autocorrelation.along_columns])
    bins = [b for b in record.missing.by_brightness if b.value is not None]
    (at, percent), _ = lines_of(axes["missing pixels (dotted: drop-out step)"])
    assert percent == pytest.approx([100 * b.value for b in bins])
    assert all(b.low < x < b.high for b, x in zip(bins, at, strict=True))
    (at_deg, mm), _ = lines_of(axes["fine noise against incidence"])
    angle_bins = [b for b in record.fine.by_incidence if b.count >= 5]
    assert mm == pytest.approx([1e3 * b.value for b in angle_bins])
    assert at_deg == pytest.approx([(b.low + b.high) / 2 for b in angle_bins])


@pytest.mark.slow
def test_the_plots_show_each_record_in_its_colour(tmp_path, record):
    draw_realism([record], tmp_path / "one.png")
    draw_realism([record, record.model_copy(update={"name": "other"})], tmp_path / "two.png")
    one, two = (cv2.imread(str(tmp_path / f"{n}.png")) for n in ("one", "two"))
    orange = np.array([14, 127, 255])  # colour of the second record, as blue, green, red
    assert not (one == orange).all(axis=-1).any()
    assert (two == orange).all(axis=-1).sum() > 1000


def test_a_plot_that_cannot_be_written_is_named(tmp_path, record):
    with pytest.raises(GraycastError, match="cannot be written"):
        draw_realism([record], tmp_path / "missing" / "a.png")
