"""Stacks of every kind are decoded to the true projector positions."""

import io
from dataclasses import replace

import numpy as np
import pytest
import yaml
from backends import slow
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.base.frames import inverse, transform_points
from graycast.camera.decode import CodeMap, Reason, epipolar_residual_px, triangulate
from graycast.camera.stack import (
    decode_stack,
    describe_result,
    meet_rays,
    read_description,
    write_result,
)
from graycast.camera.stack.believed_depth import epipolar_limit_px, less_outliers
from graycast.rig.optics import project
from graycast.rig.pattern import gray, gray_line_shift, gray_phase, micro_phase, xor_gray

from .filtered import PRESET_FILTERS, check_depth_of_no_filters
from .simulated import BALL_M, RADIUS_M, WALL_M, describe, save, shoot, small_rig, view_of

BOTH = ("column", "row")
CODES = {
    "gray": gray(128, 96),
    "gray with inverses": gray(128, 96, inverses=True),
    "gray, rows alone": gray(128, 96, axes=("row",), inverses=True),
    "gray and phase": gray_phase(128, 96, axes=BOTH, period_px=16.0, steps=4),
    "line shift": gray_line_shift(128, 96, axes=BOTH, inverses=True),
    "exclusive-or gray": xor_gray(128, 96),
    "micro phase": micro_phase(128, 96, axes=BOTH),
}


def without(code, keep):
    return replace(code, frames=tuple(f for f in code.frames if keep(f)))


def misses_px(result, scene):
    """Return errors of decoded pixels that no border of a projector pixel divides."""
    for axis, place in (("column", result.codes.column), ("row", result.codes.row)):
        if axis in result.code.axes:
            yield np.abs(place - getattr(scene, axis))[result.codes.reason == Reason.DECODED]


@pytest.mark.slow
@pytest.mark.parametrize("name", CODES)
def test_a_valid_stack_is_decoded_without_a_warning(name, tmp_path):
    """Oracle: the scene's closed form; light comes in whole projector pixels."""
    rig, code = small_rig(), CODES[name]
    path = save(tmp_path, describe(code), shoot(rig, code))
    result = decode_stack(path)
    assert result.warnings == ()
    assert result.figures.decoded_share > 0.97
    for miss in misses_px(result, view_of(rig)):
        assert np.quantile(miss, 0.98) < (0.75 if code.subpixel else 0.51)


def keep_all(frame):
    return True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keep", "cell_px"),
    [
        (lambda f: f.kind == "gray", 1),
        (lambda f: not f.inverse, 1),
        (lambda f: f.kind == "gray" and not f.inverse, 1),
        (lambda f: f.kind != "gray" or f.bit >= 1, 2),
        (lambda f: f.kind != "gray" or f.bit >= 2, 4),
        (lambda f: f.axis != "row", 1),
    ],
    ids="no_white_or_black no_inverses patterns_alone 1_bit_less 2_bits_less columns".split(),
)
def test_a_stack_without_the_finest_bits_has_errors_of_at_most_half_a_cell(keep, cell_px, tmp_path):
    rig, code = small_rig(), without(CODES["gray with inverses"], keep)
    result = decode_stack(save(tmp_path, describe(code), shoot(rig, code)))
    assert result.warnings == ()
    assert result.figures.decoded_share > 0.95
    for miss in misses_px(result, view_of(rig)):
        assert np.quantile(miss, 0.98) < 0.5 * cell_px + 0.01
    known = result.codes.reason == Reason.DECODED
    assert np.isfinite(result.codes.column[known]).all()
    assert np.isfinite(result.codes.row[known]).all() == ("row" in code.axes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "bits", "color"),
    [
        (".png", 8, True),
        slow(".jpg", 8, False),
        (".jpg", 8, True),
        slow(".tif", 8, False),
        (".png", 16, False),
        slow(".tif", 16, False),
        (".png", 12, False),
        slow(".png", 10, False),
    ],
)
def test_every_kind_of_picture_file_is_decoded_correctly(suffix, bits, color, tmp_path):
    rig, code = small_rig(), CODES["gray with inverses"]
    stack = shoot(rig, code, bits=bits)
    result = decode_stack(save(tmp_path, describe(code, suffix), stack, color=color))
    assert result.warnings == ()
    assert result.figures.decoded_share > 0.97
    assert result.levels.levels.saturation_dn == 2**bits - 1
    for miss in misses_px(result, view_of(rig)):
        assert np.quantile(miss, 0.97) < 0.51


def test_an_orientation_tag_does_not_rotate_a_picture(tmp_path):
    rig, code = small_rig(), CODES["gray"]
    stack = shoot(rig, code)
    path = save(tmp_path, describe(code, ".jpg"), stack)
    plain = decode_stack(path).codes.column
    tag = Image.Exif()
    tag[0x0112] = 6  # a quarter turn
    for entry, picture in zip(describe(code, ".jpg")["frames"], stack, strict=True):
        Image.fromarray(picture).save(tmp_path / entry["file"], quality=95, exif=tag)
    np.testing.assert_array_equal(decode_stack(path).codes.column, plain)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.0, 0.05, 0.2])
def test_the_noise_is_estimated_from_the_stack_itself(gain, tmp_path):
    """Oracle: the simulated noise, variance 0.25 + gain * light, and 1/12 of rounding."""
    rig, code = small_rig(), CODES["gray with inverses"]
    levels = decode_stack(save(tmp_path, describe(code), shoot(rig, code, gain=gain))).levels.levels
    offset_dn = 0.02 * 255
    for light_dn in (60.0, 120.0):
        true = 0.25 + 1 / 12 + gain * light_dn
        stored = light_dn + offset_dn - levels.offset_dn
        assert levels.floor_dn2 + levels.slope_dn * stored == pytest.approx(true, rel=0.15)


def test_camera_levels_stated_in_the_stack_file_are_used(tmp_path):
    rig, code = small_rig(), CODES["gray"]
    content = describe(code) | {
        "levels": {
            "offset_dn": 5, "saturation_dn": 250, "read_noise_dn": 2.0, "gain_dn_per_e": 0.1
        }
    }  # fmt: skip
    levels = decode_stack(save(tmp_path, content, shoot(rig, code))).levels.levels
    assert (levels.offset_dn, levels.saturation_dn, levels.slope_dn) == (5, 250, 0.1)
    assert levels.floor_dn2 == pytest.approx(4 + 1 / 12)


# --- depth -------------------------------------------------------------------------------------


def off_the_surface_m(point_m):
    """Return the distance to the wall or the ball, whichever is nearer."""
    ball_m = np.abs(np.linalg.norm(point_m - BALL_M, axis=-1) - RADIUS_M)
    return np.minimum(ball_m, np.abs(point_m[:, 2] - WALL_M))


@pytest.mark.slow
@pytest.mark.parametrize("vertical", [False, True])
def test_the_depth_of_wall_and_ball_is_correct_to_half_a_projector_pixel(vertical, tmp_path):
    rig, code = small_rig(vertical=vertical), CODES["gray with inverses"]
    result = decode_stack(save(tmp_path, describe(code), shoot(rig, code)), rig)
    assert result.warnings == ()
    known = np.isfinite(result.depth.depth_m)
    error_m = np.abs(result.depth.depth_m - view_of(rig).depth_m)[known]
    half_pixel_m = 0.5 * WALL_M**2 / (150.0 * 0.2)  # z^2 / (f b) per pixel
    assert known.mean() > 0.9 * result.figures.lit_share
    assert np.quantile(error_m, 0.98) < 1.3 * half_pixel_m  # the toe-in increases it
    assert result.figures.epipolar_median_px < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mentioned"), [("gray with inverses", True), ("gray and phase", False)]
)
def test_pixels_without_doubtful_bits_are_counted_only_without_phases(name, mentioned, tmp_path):
    """With phases, few pixels have the smallest sigma, so their residual has no meaning."""
    rig, code = small_rig(), CODES[name]
    result = decode_stack(save(tmp_path, describe(code), shoot(rig, code)), rig)
    figures = result.figures
    assert np.isfinite(figures.epipolar_sure_px) == mentioned
    assert ("no doubtful bit" in describe_result(result)) == mentioned
    assert not mentioned or figures.epipolar_sure_px <= figures.epipolar_median_px


@pytest.mark.slow
@pytest.mark.parametrize("filters", [PRESET_FILTERS[0], *map(slow, PRESET_FILTERS[1:])])
def test_preset_filters_add_no_noise_to_the_depth_of_a_stack(filters, tmp_path):
    """The ball's slopes show if a preset's raster scatters the depth of real pictures."""
    rig, code = small_rig(), CODES["gray and phase"]
    path = save(tmp_path, describe(code), shoot(rig, code))
    plain = decode_stack(path, rig).depth
    check_depth_of_no_filters(path, rig, plain, filters)


def test_the_epipolar_check_removes_a_wrong_row_but_not_a_noisy_point():
    """Oracle: positions with normal noise of the stated deviation, 0.05 to 4 px."""
    rig = small_rig()
    truth, rng = view_of(rig), np.random.default_rng(6)
    sigma_px = np.geomspace(0.05, 4.0, truth.column.size)
    sigma_px = rng.permutation(sigma_px).reshape(truth.column.shape).astype(np.float32)
    column, row = (
        (place + sigma_px * rng.normal(size=place.shape)).astype(np.float32)
        for place in (truth.column, truth.row)
    )
    wrong = rng.random(row.shape) < 0.1
    row[wrong] += 20
    codes = CodeMap(
        column=column, row=row, sigma_column=sigma_px, sigma_row=sigma_px.copy(),
        modulation=np.ones_like(row),
        reason=np.full(row.shape, Reason.DECODED, dtype=np.uint8),
        mark=np.zeros(row.shape, dtype=np.uint8),
    )  # fmt: skip
    depth = triangulate(codes, rig)
    residual_px = epipolar_residual_px(codes, depth, rig)
    limit_px = epipolar_limit_px(None, residual_px)
    assert limit_px < 6
    filtered = less_outliers(codes, depth, residual_px, rig, limit_px)
    known = depth.reason == Reason.DECODED
    gone = (filtered.reason == Reason.OUTLIER)[known]
    assert gone[~wrong[known]].mean() < 2e-3  # beyond the limit and 3 sigma
    sharp = (sigma_px < 1)[known]
    assert gone[wrong[known] & sharp].all()


@pytest.mark.slow
@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.1, 1e-3, -1e-3, 0.0)])
def test_averaging_gives_one_more_accurate_point_per_projector_pixel(distortion, tmp_path):
    rig, code = small_rig(projector=(64, 48), distortion=distortion), gray(64, 48, inverses=True)
    path = save(tmp_path, describe(code), shoot(rig, code))
    single, joined = (decode_stack(path, rig, average=average) for average in (False, True))
    assert np.array_equal(single.depth.depth_m, joined.depth.depth_m, equal_nan=True)
    decoded = single.codes.reason == Reason.DECODED
    cells = np.unique(np.stack([single.codes.column, single.codes.row])[:, decoded], axis=1)
    assert 0.9 * cells.shape[1] < len(joined.cloud.point_m) <= cells.shape[1]
    assert (joined.cloud.sure_pixels > 0).mean() > 0.9
    rough_m, fine_m = (np.median(off_the_surface_m(r.cloud.point_m)) for r in (single, joined))
    assert fine_m < 0.4 * rough_m


def test_the_gap_between_two_rays_is_the_displacement_of_one_of_them():
    rig = small_rig(distortion=(-0.2, 0.1, 1e-3, -1e-3, 0.0))
    rng = np.random.default_rng(5)
    point_m = rng.uniform((-0.15, -0.1, 0.6), (0.15, 0.1, 1.0), (200, 3))
    camera_px = project(rig.camera, point_m)
    projector_px = project(rig.projector, transform_points(inverse(rig.T_cam_proj), point_m))
    met_m, miss_px = meet_rays(camera_px, projector_px, rig)
    np.testing.assert_allclose(met_m, point_m, atol=1e-9)
    assert miss_px.max() < 1e-6
    middle = np.abs(point_m[:, 1]) < 0.02  # epipolar lines are parallel to x there
    _, miss_px = meet_rays(camera_px, projector_px + np.array([0.0, 2.0]), rig)
    np.testing.assert_allclose(miss_px[middle], 2.0, rtol=0.05)


# --- files -------------------------------------------------------------------------------------


def read_ply(path):
    head, body = path.read_bytes().split(b"end_header\n", 1)
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    lines = [line.split() for line in head.decode().splitlines()]
    fields = [(words[2], kinds[words[1]]) for words in lines if words[0] == "property"]
    table = np.frombuffer(body, dtype=fields)
    assert ["element", "vertex", str(len(table))] in lines
    return table


@pytest.mark.slow
def test_the_written_files_contain_the_decoded_result(tmp_path):
    rig, code = small_rig(), CODES["gray with inverses"]
    result = decode_stack(save(tmp_path, describe(code), shoot(rig, code)), rig)
    out = tmp_path / "new" / "out"
    files = write_result(result, out)
    assert sorted(p.name for p in files) == sorted(p.name for p in out.iterdir())
    with np.load(out / "code.npz", allow_pickle=False) as arrays:
        for name in ("column", "row", "sigma_column", "sigma_row", "modulation"):
            assert arrays[name].dtype == np.float32
            np.testing.assert_array_equal(arrays[name], getattr(result.codes, name))
        assert arrays["reason"].dtype == np.uint8
        assert list(arrays["reasons"]) == [reason.name.lower() for reason in Reason]
        assert (np.isnan(arrays["column"]) == (arrays["reason"] != 0)).all()
    depth_m = np.load(out / "depth.npy")
    assert depth_m.dtype == np.float32
    assert np.load(out / "sigma_depth.npy").shape == depth_m.shape == (120, 160)
    cloud = read_ply(out / "cloud.ply")
    np.testing.assert_array_equal(cloud["z"], depth_m[np.isfinite(depth_m)])
    assert off_the_surface_m(np.stack([cloud[c] for c in "xyz"], axis=-1)).max() < 0.05
    with Image.open(out / "preview.png") as preview:
        assert min(preview.size) > 800
    words = describe_result(result)
    assert "epipolar residual: median 0." in words and "column_bit06" in words


@pytest.mark.slow
def test_results_of_an_earlier_run_are_removed_when_a_new_result_is_written(tmp_path):
    rig, code = small_rig(), CODES["gray"]
    path = save(tmp_path, describe(code), shoot(rig, code))
    write_result(decode_stack(path, rig), tmp_path / "out")
    write_result(decode_stack(path), tmp_path / "out")
    left = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert left == ["code.npz", "light.npz", "preview.png"]


def test_the_error_for_an_unwritable_folder_names_the_folder(tmp_path):
    rig, code = small_rig(), CODES["gray"]
    result = decode_stack(save(tmp_path, describe(code), shoot(rig, code)))
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(GraycastError, match=r"file.*cannot be written"):
        write_result(result, tmp_path / "file" / "out")


@pytest.mark.slow
def test_a_phase_code_with_a_complementary_bit_needs_no_stated_stride(tmp_path):
    """A complementary bit gives the width of the Gray values."""
    content = describe(CODES["gray and phase"])
    del content["stride_px"]
    rig, code = small_rig(), CODES["gray and phase"]
    assert decode_stack(save(tmp_path, content, shoot(rig, code))).code.stride_px == (16.0, 16.0)
    read = read_description(tmp_path / "STACK.yaml")
    assert yaml.safe_load(io.StringIO((tmp_path / "STACK.yaml").read_text()))["frames"]
    assert len(read.frames) == len(code.frames)


def test_an_averaged_cloud_has_no_doubtful_pixels(tmp_path):
    code = gray_phase(128, 96, axes=("column", "row"))
    rig = small_rig()
    pictures = shoot(rig, code)

    def points(max_p_wrong):
        decode = {"max_p_wrong": max_p_wrong, "doubt": 0.0}
        stack = save(tmp_path, describe(code) | {"decode": decode}, pictures)
        result = decode_stack(stack, rig, average=True)
        return len(result.cloud.point_m), int(np.isfinite(result.depth.depth_m).sum())

    everything, some, nothing = points(1.0), points(0.05), points(1e-9)
    assert everything[0] > some[0] > 0.5 * everything[0]
    assert everything[1] > some[1]
    assert nothing == (0, 0)
