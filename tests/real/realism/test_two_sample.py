"""The two-sample test distinguishes sets of depth maps only if their sensors differ."""

import numpy as np
import pytest
from backends import slow
from scipy.stats import mannwhitneyu

from graycast.base.errors import GraycastError
from graycast.real.realism import patches, two_sample, two_sample_test
from graycast.real.realism.patches import FEATURES, cut_squares, find_floor
from graycast.real.realism.two_sample import depth_step_m, sensor_auc
from graycast.real.realism.two_sample_files import two_sample_table, write_two_sample

from .synthetic import K, plane, scan

pytest.importorskip("sklearn", reason="needs scikit-learn: pip install 'graycast[twin]'")

SIZE = {"height_px": 160, "width_px": 192}


@pytest.fixture(autouse=True)
def few_trees(monkeypatch):
    """Use a tenth of the trees, because the differences between these sets are clear."""
    monkeypatch.setattr(two_sample, "_TREES", 20)


def maps(count, seed, *, sigma_m=2e-4, smoothed=False, drop=0.0, step_m=0.0):
    rng, scans = np.random.default_rng(seed), []
    for _ in range(count):
        noise = rng.standard_normal((SIZE["height_px"], SIZE["width_px"] + 1))
        noise = (noise[:, 1:] + noise[:, :-1]) / np.sqrt(2) if smoothed else noise[:, 1:]
        depth_m = plane(0.3, **SIZE) + sigma_m * noise
        depth_m[rng.random(depth_m.shape) < drop] = np.nan
        scans.append(scan(np.round(depth_m / step_m) * step_m if step_m else depth_m))
    return scans


@pytest.mark.slow
def test_sets_from_the_same_distribution_cannot_be_distinguished():
    """The AUC is near 0.5 for smooth squares and for the floor."""
    a, b = (cut_squares(maps(4, seed)) for seed in (1, 2))
    for place in ("smooth", "floor"):
        assert sensor_auc(a, b, place, seed=0) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("change", "feature"),
    [
        slow({"sigma_m": 2.6e-4}, "noise_log_mm"),
        slow({"smoothed": True}, "along_x"),
        slow({"drop": 0.01}, "holes_1"),
    ],
)
def test_sets_that_differ_in_the_sensor_are_distinguished(change, feature):
    """Oracle: SciPy's Mann-Whitney U gives the AUC of the changed feature alone."""
    first, second = maps(3, 1), maps(3, 2, **change)
    test = two_sample_test(first, second, names=("a", "b"), seed=0)
    assert test.auc["floor"].mean > 0.95
    values = [squares.at("floor").feature[:, FEATURES.index(feature)] for squares in test.squares]
    share = mannwhitneyu(*values).statistic / (len(values[0]) * len(values[1]))
    assert max(share, 1 - share) > 0.95


@pytest.mark.slow
def test_sets_cannot_be_distinguished_by_the_direction_of_a_slope():
    """Features do not depend on shape: the noise is the same on planes with opposite slopes."""
    first, second = maps(3, 1), [scan(one.depth_m[:, ::-1].copy()) for one in maps(3, 2)]
    test = two_sample_test(first, second, names=("a", "b"), seed=0)
    assert test.auc["floor"].mean == pytest.approx(0.5, abs=0.12)


@pytest.mark.slow
def test_the_table_and_the_picture_are_written(tmp_path):
    first, second = maps(4, 1), maps(2, 2)
    test = two_sample_test(first, second, names=("real", "b"), seed=0)
    write_two_sample(test, first, second, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"classifier.md", "classifier.png"}
    text = (tmp_path / "classifier.md").read_text()
    assert text == two_sample_table(test)
    assert text.count("| real against b |") == text.count("| real against itself |") == 2
    assert f"{test.itself['floor'].mean:.2f} ± " in text


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table():
    first, second = maps(2, 1), maps(2, 2)
    tests = [two_sample_test(first, second, names=("a", "b"), seed=3) for _ in range(2)]
    assert tests[0].auc == tests[1].auc and tests[0].itself == tests[1].itself


@pytest.mark.slow
def test_coarse_steps_of_files_do_not_distinguish_two_sets(monkeypatch):
    """Both sets are rounded to the coarser step first."""
    monkeypatch.setattr(patches, "_DRAWS", 200)  # The floor is the only plane.
    step_m = 1e-4
    first, second = maps(3, 1, step_m=step_m), maps(3, 2)
    assert depth_step_m(first) == pytest.approx(step_m)
    assert depth_step_m(second) == 0
    a, b = (cut_squares(one, step_m=step_m) for one in (first, second))
    assert sensor_auc(a, b, "smooth", seed=0) == pytest.approx(0.5, abs=0.12)


@pytest.mark.slow
def test_the_estimated_floor_agrees_with_the_true_floor():
    tilt_rad, distance_m = 0.3, 0.5
    depth_m = [one.depth_m.copy() for one in maps(2, 1)]
    for one in depth_m:
        one[20:80, 30:100] -= 0.05
    g = find_floor(depth_m)
    normal = np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)]) / (distance_m * np.cos(tilt_rad))
    # n . p = 1 with p = z K^-1 (x, y, 1), so g = K^-T n.
    assert g == pytest.approx(np.linalg.solve(K.T, normal), rel=1e-3, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *map(slow, range(1, 6))])
def test_a_floor_that_covers_an_eighth_of_the_depth_is_found(seed):
    """The rest are randomly tilted planes, each smaller than the visible floor.

    Three random pixels are all on the floor once in 512 samples.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:240, :300]
    ray_x, ray_y = (x - 150) / 300, (y - 120) / 300
    depth_m = np.full((240, 300), 0.8)
    for top in range(0, 240, 40):
        for left in range(0, 300, 50):
            if (top // 40 + 2 * (left // 50)) % 8:
                box = np.s_[top : top + 40, left : left + 50]
                lean_x, lean_y = rng.uniform(-0.6, 0.6, 2)
                plane_m = rng.uniform(0.6, 0.78) / (1 - lean_x * ray_x - lean_y * ray_y)
                depth_m[box] = plane_m[box]
    noisy = depth_m + 1e-4 * rng.standard_normal(depth_m.shape)
    g = find_floor([noisy])
    assert g @ [150, 120, 1] == pytest.approx(1 / 0.8, rel=1e-3)
    assert g[:2] == pytest.approx([0, 0], abs=1e-5)


def test_second_differences_do_not_depend_on_curvature():
    y, x = np.mgrid[:32, :32] / 32.0
    bent = 0.5 + 0.01 * x**2 - 0.02 * y**2 + 0.01 * x * y + 0.003 * x**3
    assert np.abs(patches.second_difference(bent)).max() < 1e-15
    white = np.random.default_rng(1).standard_normal((400, 400))
    assert patches.second_difference(white).std() == pytest.approx(1.0, rel=0.02)
    assert patches.third_difference(white).std() == pytest.approx(1.0, rel=0.02)


def test_single_maps_and_a_missing_package_are_refused(monkeypatch):
    with pytest.raises(
        GraycastError, match="depth map: give at least two, because the test leaves out each map"
    ):
        two_sample_test(maps(1, 1), maps(2, 2), names=("a", "b"), seed=0)
    monkeypatch.setattr(two_sample.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(GraycastError, match=r"pip install 'graycast\[twin\]'"):
        two_sample_test(maps(2, 1), maps(2, 2), names=("a", "b"), seed=0)
