"""A real scan (J. DeWitt's sea shell), compared with its author's own point cloud."""

import re

import numpy as np
import pytest
import yaml
from scipy.ndimage import uniform_filter
from scipy.spatial import cKDTree

from graycast.camera.rig_file import import_opencv
from graycast.camera.stack import decode_stack

from .filtered import PRESET_FILTERS, check_depth_of_no_filters

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scan(shared):
    folder = shared / "data" / "scans" / "sea_shell"
    if not folder.is_dir():
        pytest.skip("needs ../shared/data/scans/sea_shell, which is not here")
    return folder


@pytest.fixture(scope="module")
def stack_file(scan, tmp_path_factory):
    """Write the stack file of pictures TIME_[AXIS-BIT-INVERSE_NUMBER], without white and black."""
    frames = []
    for file in sorted((scan / "stack").glob("*.jpg")):
        axis, bit, inverse = map(int, re.search(r"\[(\d+)-(\d+)-(\d+)_", file.name).groups())
        frames.append(
            {
                "file": str(file),
                "kind": "gray",
                "axis": ("column", "row")[axis],
                "bit": bit,
                "inverse": bool(inverse),
            }
        )
    path = tmp_path_factory.mktemp("sea_shell") / "STACK.yaml"
    content = {"projector": {"width_px": 1280, "height_px": 720}, "frames": frames}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def rig(scan):
    return import_opencv(
        scan / "calibration.yaml",
        unit=None,
        near_m=0.2,
        far_m=1.5,
        camera_size_px=None,
        projector_size_px=(1280, 720),
    )


@pytest.fixture(scope="module")
def result(stack_file, rig):
    return decode_stack(stack_file, rig, average=True)


@pytest.fixture(scope="module")
def author_m(scan):
    """Return the author's points [m] in the camera frame; the file has mm, y and z negated."""
    content = (scan / "reference_cloud.ply").read_bytes().split(b"end_header\n", 1)[1]
    table = np.frombuffer(content, dtype=[("xyz", "<f4", 3), ("color", "u1", 3)])
    return table["xyz"] * np.array([1e-3, -1e-3, -1e-3])


def test_the_sea_shell_stack_causes_no_warning(result):
    assert result.warnings == ()


def test_three_quarters_of_the_lit_pixels_are_decoded_along_both_axes(result):
    """A pixel is lit if its frames differ by more than six standard deviations of the noise."""
    assert result.figures.decoded_share >= 0.75
    known = result.codes.reason == 0
    assert np.isfinite(result.codes.column[known]).all()
    assert np.isfinite(result.codes.row[known]).all()


def test_the_modulation_of_each_gray_bit_agrees_with_known_values(result):
    """Oracle: values of the project's design, computed independently, from coarse to fine."""
    known = [0.97, 0.96, 0.96, 0.94, 0.93, 0.90, 0.87, 0.80, 0.61, 0.30, 0.06]
    for axis in ("column", "row"):
        estimate = [result.figures.modulation[f"{axis}_bit{bit:02d}"] for bit in range(10, -1, -1)]
        np.testing.assert_allclose(estimate, known, atol=0.06)


def test_the_epipolar_residual_of_the_sea_shell_agrees_with_its_known_value(result):
    """It is 0.34 px for pixels without a doubtful bit; the calibration ends at the shell."""
    assert result.figures.epipolar_sure_px == pytest.approx(0.34, abs=0.04)


@pytest.mark.parametrize("filters", PRESET_FILTERS)
def test_preset_filters_add_no_noise_to_the_sea_shell_s_depth(result, stack_file, rig, filters):
    check_depth_of_no_filters(stack_file, rig, result.depth, filters)


def off_the_plane_around_px(place, known, *, window_px=25):
    """Return each pixel's position minus a plane through its neighbours, and where it is valid.

    Four rounds of least squares by sums over windows, without pixels that are off by 4 px.
    """
    y, x = (axis / 100 for axis in np.mgrid[0 : place.shape[0], 0 : place.shape[1]].astype(float))
    place = np.where(known, place, 0).astype(float)
    weight = known.astype(float)
    for _ in range(4):
        share = uniform_filter(weight, window_px) + 1e-12

        def mean(value, weight=weight, share=share):
            return uniform_filter(weight * value, window_px) / share

        mx, my, mu = mean(x), mean(y), mean(place)
        xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
        xu, yu = mean(x * place) - mx * mu, mean(y * place) - my * mu
        across = xx * yy - xy * xy + 1e-12
        slope_x, slope_y = (yy * xu - xy * yu) / across, (xx * yu - xy * xu) / across
        off = place - (mu + slope_x * (x - mx) + slope_y * (y - my))
        scatter2 = mean(np.minimum(np.abs(off), 50.0) ** 2)
        weight = (known & (np.abs(off) < 4)).astype(float)
    smooth = known & (uniform_filter(known.astype(float), window_px) > 0.8) & (scatter2 < 1.44)
    return off, smooth & (np.abs(off) < 8)


@pytest.mark.parametrize("axis", ["column", "row"])
def test_errors_of_decoded_bits_agree_with_sigma(result, axis):
    """Errors are relative to the plane around each pixel of the shell. With noise as the only error
    of the finest bits, of modulation 0.06 and 0.30, the ratio was 1.71 in columns and 1.39 in rows.
    """
    codes = result.codes
    off_px, smooth = off_the_plane_around_px(getattr(codes, axis), codes.reason == 0)
    smooth &= codes.modulation > 0.15
    assert smooth.sum() > 400_000
    ratio = (off_px / getattr(codes, "sigma_" + axis))[smooth]
    assert 0.8 < np.sqrt(np.mean(np.square(ratio))) < 1.3


def test_the_published_points_are_reproduced_to_hundredths_of_a_millimetre(result, author_m):
    ours_m = result.cloud.point_m
    away_m, _ = cKDTree(ours_m).query(author_m)
    assert len(ours_m) >= len(author_m) == 104_809
    assert np.median(away_m) <= 0.02e-3
    assert (away_m < 0.5e-3).mean() >= 0.99


def test_half_of_the_certain_points_are_within_0_02_mm_of_the_author_s(result, author_m):
    """Only points near the author's are compared, since he left out the dim background."""
    sure_m = result.cloud.point_m[result.cloud.sure_pixels > 0]
    away_m, _ = cKDTree(author_m).query(sure_m)
    assert len(sure_m) >= len(author_m)
    assert np.median(away_m) <= 0.02e-3
