"""Reading Gray-code stacks, every reason for no depth, and triangulation three other ways."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stage import (
    centred,
    in_camera,
    lambert,
    leaning_wall,
    make_rig,
    optics,
    turned,
)

from graycast.decode import (
    CodeMap,
    DecodeSpec,
    Reason,
    decode,
    decode_plain,
    triangulate,
    triangulation_axis,
)
from graycast.pattern import GrayCode
from graycast.render import Quality
from graycast.scene import EMPTY_LAYOUT, Sphere
from graycast.sensor import Capture, SensorSpec

SENSOR = SensorSpec(offset_dn=0.0, gain_dn_per_e=0.1, full_well_e=1e6, bit_depth=8)
SENSOR_12 = replace(SENSOR, bit_depth=12)
USUAL = DecodeSpec()


def capture(frames, sensor=SENSOR):
    return Capture(frames=frames, sensor=sensor, exposure_s=0.01)


def seen(code, column, row, *, dark=20, bright=200):
    """A noiseless stack of a camera whose pixels see the given projector pixels."""
    level = dark + (bright - dark) * (code.render()[:, row, column] // 255)
    return np.ascontiguousarray(level, dtype=np.uint8)


CODES = [
    GrayCode(width_px=37, height_px=22),
    GrayCode(width_px=37, height_px=22, inverses=True),
    GrayCode(width_px=64, height_px=8, axes=("column",)),
    GrayCode(width_px=5, height_px=300, axes=("row",), inverses=True),
    GrayCode(width_px=9, height_px=17, axes=("row", "column")),
]


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("sensor", [SENSOR, SENSOR_12])
def test_the_fused_decoder_is_the_plain_one_bit_for_bit(code, sensor):
    """Random stacks reach every branch, but mostly nonsense; half of the pixels are true codes."""
    rng = np.random.default_rng(7)
    h, w, n = 23, 31, len(code.frames)
    top = sensor.max_dn
    dtype = np.uint8 if top < 256 else np.uint16
    stack = rng.integers(0, top + 1, (n, h, w)).astype(dtype)
    true = (
        code.render()[
            :, rng.integers(0, code.height_px, (h, w)), rng.integers(0, code.width_px, (h, w))
        ]
        > 127
    )
    gain = rng.uniform(0, 1, (h, w)) * top
    true = np.clip(0.05 * top + gain * true + rng.normal(0, 0.05 * top, (n, h, w)), 0, top)
    use_true = rng.random((h, w)) < 0.7
    stack[:, use_true] = true[:, use_true].astype(dtype)
    for spec in (DecodeSpec(), DecodeSpec(min_contrast=0.3, doubt=0.5, fine_bits=0)):
        fused, plain = (
            f(capture(stack.copy(), sensor), code, spec) for f in (decode, decode_plain)
        )
        assert len(np.unique(plain.reason)) >= 3
        for name in ("column", "row", "modulation", "reason"):
            a, b = getattr(fused, name), getattr(plain, name)
            assert a.dtype == b.dtype
            assert np.array_equal(a, b, equal_nan=name != "reason")


@pytest.mark.parametrize("inverses", [False, True])
@pytest.mark.parametrize("size", [(64, 48), (37, 22), (2, 3), (100, 1025)])
def test_every_projector_pixel_comes_back(size, inverses):
    """The camera sees each projector pixel once; through `decode_plain` too, which is the same."""
    code = GrayCode(width_px=size[0], height_px=size[1], inverses=inverses)
    row, column = np.mgrid[0 : size[1], 0 : size[0]]
    codes = decode(capture(seen(code, column, row)), code, DecodeSpec())
    assert (codes.reason == Reason.DECODED).all()
    assert np.array_equal(codes.column, column) and np.array_equal(codes.row, row)
    assert np.allclose(codes.modulation, 180 / 255)


def test_one_axis_alone_leaves_the_other_unknown():
    column = np.arange(37)[None].repeat(4, axis=0)
    code = GrayCode(width_px=37, height_px=22, axes=("column",))
    codes = decode(capture(seen(code, column, 0 * column)), code, DecodeSpec())
    assert np.array_equal(codes.column, column) and np.isnan(codes.row).all()
    code = GrayCode(width_px=22, height_px=37, axes=("row",))
    codes = decode(capture(seen(code, 0 * column, column)), code, DecodeSpec())
    assert np.array_equal(codes.row, column) and np.isnan(codes.column).all()


def one_pixel(code, *, change=None, sensor=SENSOR, spec=USUAL, **levels):
    """Reason of a pixel that sees projector pixel (5, 3), its stack changed by a function."""
    stack = seen(code, np.array([[5]]), np.array([[3]]), **levels)
    if change is not None:
        change(stack[:, 0, 0])
    codes = decode(capture(stack, sensor), code, spec)
    plain = decode_plain(
        capture(stack.copy(), sensor), code, DecodeSpec() if spec is None else spec
    )
    assert codes.reason[0, 0] == plain.reason[0, 0]
    reason = Reason(codes.reason[0, 0])
    assert np.isfinite(codes.column[0, 0]) == (reason == Reason.DECODED)
    return reason


def frame_index(code, axis, bit, inverse=False):
    wanted = (axis, bit, inverse)
    return [(f.axis, f.bit, f.inverse) for f in code.frames].index(wanted)


def test_a_pixel_is_too_dark_when_its_contrast_is_under_the_share_of_the_range():
    code = GrayCode(width_px=32, height_px=16)
    spec = DecodeSpec(min_contrast=0.1)  # of 255 DN: 25.5
    assert one_pixel(code, dark=50, bright=75, spec=spec) is Reason.TOO_DARK
    assert one_pixel(code, dark=50, bright=76, spec=spec) is Reason.DECODED
    assert one_pixel(code, dark=0, bright=0) is Reason.TOO_DARK


def test_a_pixel_is_saturated_when_one_frame_reaches_the_top():
    code = GrayCode(width_px=32, height_px=16)
    assert one_pixel(code, bright=255) is Reason.SATURATED
    assert one_pixel(code, bright=254) is Reason.DECODED
    well = SensorSpec(
        offset_dn=10.0, gain_dn_per_e=0.1003, full_well_e=1000.0, bit_depth=8
    )  # full at 110.3 DN, which the sensor stores as 110
    assert one_pixel(code, bright=110, sensor=well) is Reason.SATURATED
    assert one_pixel(code, bright=109, sensor=well) is Reason.DECODED


@pytest.mark.parametrize("inverses", [False, True])
def test_two_doubtful_coarse_bits_contradict_each_other_and_one_does_not(inverses):
    code = GrayCode(width_px=256, height_px=16, inverses=inverses)

    def doubt(*bits):
        def change(stack):
            for bit in bits:
                stack[frame_index(code, "column", bit)] = 110
                if inverses:
                    stack[frame_index(code, "column", bit, True)] = 110

        return change

    assert one_pixel(code) is Reason.DECODED
    assert one_pixel(code, change=doubt(7)) is Reason.DECODED
    assert one_pixel(code, change=doubt(7, 5)) is Reason.CONTRADICTORY
    assert one_pixel(code, change=doubt(3, 7)) is Reason.CONTRADICTORY
    assert one_pixel(code, change=doubt(7, 2, 1, 0)) is Reason.DECODED  # the fine bits do not count

    def one_of_each(stack):
        doubt(7)(stack)
        stack[frame_index(code, "row", 3)] = 110
        if inverses:
            stack[frame_index(code, "row", 3, True)] = 110

    assert one_pixel(code, change=one_of_each) is Reason.DECODED  # each axis may change once
    strict = DecodeSpec(fine_bits=0)
    assert one_pixel(code, change=doubt(1, 0), spec=strict) is Reason.CONTRADICTORY


def test_a_code_that_the_projector_does_not_have_is_outside_of_it():
    """20 columns need 5 bits, so 12 words belong to no column; 27 in Gray code is 10110."""
    code = GrayCode(width_px=20, height_px=16)

    def change(stack):
        for bit, value in zip((4, 3, 2, 1, 0), (1, 0, 1, 1, 0), strict=True):
            stack[frame_index(code, "column", bit)] = 200 if value else 20

    assert one_pixel(code, change=change) is Reason.OUTSIDE_PROJECTOR


def test_too_dark_comes_before_all_and_saturated_before_contradictory():
    code = GrayCode(width_px=256, height_px=16)

    def change(stack):
        stack[:] = 255

    assert one_pixel(code, change=change) is Reason.TOO_DARK

    def glare(stack):
        stack[0] = 255
        stack[2:6] = 137

    assert one_pixel(code, change=glare) is Reason.SATURATED


def test_a_stack_of_another_length_is_refused():
    code = GrayCode(width_px=32, height_px=16, inverses=True)
    plain = GrayCode(width_px=32, height_px=16)
    stack = seen(plain, np.array([[5]]), np.array([[3]]))
    with pytest.raises(ValueError, match="11 frames, the code has 20"):
        decode(capture(stack), code, DecodeSpec())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_contrast", 0.0),
        ("min_contrast", 1.0),
        ("doubt", -0.1),
        ("doubt", 1.0),
        ("fine_bits", -1),
    ],
)
def test_impossible_settings_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        DecodeSpec(**{name: value})


# --- triangulation ---------------------------------------------------------------------------


def code_map(column, row):
    known = np.isfinite(column) | np.isfinite(row)
    return CodeMap(
        column=column.astype(np.float32),
        row=row.astype(np.float32),
        modulation=np.ones(column.shape, dtype=np.float32),
        reason=np.where(known, 0, 1).astype(np.uint8),
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("vertical", [False, True])
def test_depth_solves_the_three_linear_equations_of_the_paper(seed, vertical):
    """Two rows of Mc and one of Mp, solved as a full 3 x 3 system in world coordinates (X, Y, Z)
    of a third frame: (M0 - u M2) . (X, 1) = 0. The code under test reduces them by hand.
    """
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.05, 0.05, 3) + ([0.0, -0.3, 0.0] if vertical else [0.3, 0.0, 0.0])
    toe = (-0.25, 0.0) if vertical else (0.0, -0.25)
    rotation = turned(toe[0], toe[1], 0.0) @ turned(*rng.uniform(-0.08, 0.08, 3))
    if vertical:
        rotation = turned(0.25, 0.0, 0.0).T @ turned(*rng.uniform(-0.08, 0.08, 3))
    rig = make_rig(
        optics(24, 18, 30), optics(64, 48, 60), baseline_m=tuple(place.tolist()), rotation=rotation
    )
    axis = "row" if vertical else "column"
    assert triangulation_axis(rig) == axis
    size = 48 if vertical else 64
    code = rng.integers(0, size, (18, 24)).astype(float)
    nothing = np.full(code.shape, np.nan)
    depth = triangulate(code_map(nothing, code) if vertical else code_map(code, nothing), rig)
    T_cam_world = np.linalg.inv(
        np.vstack([np.column_stack([turned(0.3, -0.5, 1.0), [0.4, -2.0, 1.0]]), [0, 0, 0, 1]])
    )
    Mc = rig.camera.K @ T_cam_world[:3]
    Mp = rig.projector.K @ (np.linalg.inv(rig.T_cam_proj) @ T_cam_world)[:3]
    i = int(vertical)
    found = 0
    for y in range(18):
        for x in range(24):
            rows = np.stack([Mc[0] - x * Mc[2], Mc[1] - y * Mc[2], Mp[i] - code[y, x] * Mp[2]])
            point = np.linalg.solve(rows[:, :3], -rows[:, 3])
            z = T_cam_world[2] @ [*point, 1.0]
            if rig.near_m <= z <= rig.far_m:
                found += 1
                assert abs(depth.depth_m[y, x] / z - 1) < 1e-5
                assert depth.reason[y, x] == Reason.DECODED
            else:
                assert np.isnan(depth.depth_m[y, x])
                assert depth.reason[y, x] == Reason.OUT_OF_RANGE
    assert found > 50


@pytest.mark.parametrize("wall_m", [0.4, 0.9, 2.0])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("vertical", [False, True])
def test_a_parallel_rig_gives_depth_by_similar_triangles(wall_m, side, vertical):
    """x_cam - x_proj = side f b / z, with fractional columns, so nothing is rounded."""
    f_px, b_m = 400.0, 0.1
    baseline = (0.0, side * b_m, 0.0) if vertical else (side * b_m, 0.0, 0.0)
    rig = make_rig(centred(64, 48, f_px), centred(1000, 1000, f_px), baseline_m=baseline)
    place = np.arange(48 if vertical else 64) - (23.5 if vertical else 31.5)
    code = place - side * f_px * b_m / wall_m + 499.5
    code = np.broadcast_to(code[:, None] if vertical else code[None], (48, 64)).astype(float)
    nothing = np.full(code.shape, np.nan)
    depth = triangulate(
        code_map(nothing, code) if vertical else code_map(code, nothing), rig
    ).depth_m
    assert np.abs(depth / wall_m - 1).max() < 1e-5  # columns are float32


LENS = (-0.12, 0.05, 0.002, -0.001, 0.01)
BEAM = (0.15, -0.08, -0.003, 0.004, 0.02)


def opencv_rays(camera):
    """Ray directions (h, w, 3) of pixel centres, unit z, by OpenCV's own inverse."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    pixel = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    enough = (cv2.TERM_CRITERIA_MAX_ITER, 200, 0.0)
    ideal = cv2.undistortPoints(pixel, camera.K, np.array(camera.distortion), criteria=enough)
    return np.concatenate([ideal[:, 0], np.ones((x.size, 1))], axis=1).reshape(*x.shape, 3)


@pytest.mark.parametrize("known", ["both", "across"])
@pytest.mark.parametrize("vertical", [False, True])
def test_points_projected_by_opencv_through_two_distorted_lenses_come_back(known, vertical):
    """Oracle: cv2.projectPoints. Each camera pixel gets a point somewhere on its ray, and the
    projector pixel in which OpenCV sees it; back must come its depth, to a micrometre.
    """
    camera, projector = (
        optics(40, 30, 44, distortion=LENS),
        optics(64, 48, 46, distortion=BEAM),
    )
    rotation = turned(0.2, 0.02, 0.03) if vertical else turned(0.03, -0.2, 0.02)
    baseline = (0.02, 0.25, 0.01) if vertical else (0.25, 0.02, 0.01)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    ray = opencv_rays(camera).reshape(-1, 3)
    z = np.random.default_rng(2).uniform(0.9, 1.4, 1200)
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)
    uv = cv2.projectPoints(
        ray * z[:, None],
        cv2.Rodrigues(T_proj_cam[:3, :3])[0],
        T_proj_cam[:3, 3],
        projector.K,
        np.array(BEAM),
    )[0][:, 0]
    inside = ((uv > -0.5) & (uv < [63.5, 47.5])).all(axis=1)
    assert inside.sum() > 600
    uv[~inside] = np.nan
    column, row = uv[:, 0].reshape(30, 40), uv[:, 1].reshape(30, 40)
    nothing = np.full((30, 40), np.nan)
    if known == "across":
        column, row = (nothing, row) if vertical else (column, nothing)
    exact = CodeMap(
        column=column,
        row=row,
        modulation=np.ones((30, 40)),
        reason=np.where(inside.reshape(30, 40), 0, 1).astype(np.uint8),
    )
    depth = triangulate(exact, rig)
    error = np.abs(depth.depth_m.ravel() - z)[inside]
    assert error.max() < 1e-6


def test_wrong_columns_of_a_distorted_projector_are_out_of_range_at_worst():
    """Wrong codes lead the search for the row far out of the picture, where the lens folds over;
    one such pixel must not end the decoding of all. 29 of 200 such rigs once did.
    """
    for seed in range(3, 30):
        rng = np.random.default_rng(seed)
        k1 = rng.uniform(-0.16, -0.05)
        projector = optics(64, 48, 46, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
        camera = optics(48, 36, rng.uniform(15, 60))
        rotation = turned(rng.uniform(-0.1, 0.1), -0.3, rng.uniform(-0.2, 0.2))
        baseline = (0.3, rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
        rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
        column = rng.integers(0, 64, (36, 48)).astype(float)
        depth = triangulate(code_map(column, np.full(column.shape, np.nan)), rig)
        assert set(np.unique(depth.reason)) == {Reason.DECODED, Reason.OUT_OF_RANGE}


def test_depth_beyond_the_working_range_is_out_of_range():
    rig = make_rig(centred(64, 48, 400), centred(1000, 1000, 400))
    rig = replace(rig, near_m=0.5, far_m=1.0)
    x = np.arange(64) - 31.5
    wall_m = np.array([0.49, 0.51, 0.99, 1.01, -0.8])
    code = x[None] - 400 * 0.1 / wall_m[:, None] + 499.5
    column = np.full((48, 64), np.nan)
    column[:5] = code
    depth = triangulate(code_map(column, np.full((48, 64), np.nan)), rig)
    assert (depth.reason[[0, 3, 4]] == Reason.OUT_OF_RANGE).all()
    assert np.isnan(depth.depth_m[[0, 3, 4]]).all()
    assert np.abs(depth.depth_m[1:3] - wall_m[1:3, None]).max() < 1e-4
    assert (depth.reason[5:] == 1).all()  # an earlier reason stays


def test_a_code_along_the_wrong_axis_or_of_another_size_is_refused():
    rig = make_rig(centred(64, 48, 400), centred(100, 100, 400))
    row = np.full((48, 64), 3.0)
    with pytest.raises(ValueError, match="needs the column code"):
        triangulate(code_map(np.full((48, 64), np.nan), row), rig)
    with pytest.raises(ValueError, match="64 x 47 px, the rig's camera 64 x 48"):
        triangulate(code_map(row[1:], row[1:]), rig)


# --- the whole way ---------------------------------------------------------------------------


def noiseless(radiance, sensor):
    """A perfect converter: the brightest value at 90 % of the range."""
    scale = 0.9 * sensor.max_dn / radiance.max()
    return Capture(
        frames=np.rint(radiance * scale).astype(np.uint16), sensor=sensor, exposure_s=1.0
    )


@pytest.mark.parametrize("vertical", [False, True])
@pytest.mark.parametrize("inverses", [False, True])
def test_a_rendered_plane_and_sphere_decode_to_half_a_projector_column(
    mitsuba_renderer, vertical, inverses
):
    """Everywhere lit, with both lenses distorted: the true point, projected by OpenCV, lies within
    half a column of the decoded one, and the depth within what half a column is worth there.
    """
    camera = optics(120, 90, 130, distortion=LENS)
    projector = optics(48, 40, 50, distortion=BEAM)
    rotation = turned(-0.2, 0.0, 0.02) if vertical else turned(0.0, -0.2, 0.02)
    baseline = (0.01, -0.2, 0.0) if vertical else (0.2, 0.01, 0.0)
    rig = make_rig(camera, projector, baseline_m=baseline, rotation=rotation)
    code = GrayCode(width_px=48, height_px=40, inverses=inverses)
    scene = in_camera(
        rig,
        leaning_wall([0.2, -0.1, 1.0], 1.0, lambert(0.6)),
        Sphere(center_m=(0.02, 0.03, 0.85), radius_m=0.12, material=lambert(0.8)),
    )
    rendering = mitsuba_renderer.render(
        scene, EMPTY_LAYOUT, code.render(), quality=Quality(samples=16, depth=1), seed=0
    )
    codes = decode(noiseless(rendering.radiance.pattern, SENSOR_12), code, DecodeSpec())
    depth = triangulate(codes, rig)

    z = rendering.truth.depth_m.astype(float)
    ray = opencv_rays(camera)
    T_proj_cam = np.linalg.inv(rig.T_cam_proj)

    def across(depth_m):
        uv = cv2.projectPoints(
            (ray * depth_m[..., None]).reshape(-1, 3),
            cv2.Rodrigues(T_proj_cam[:3, :3])[0],
            T_proj_cam[:3, 3],
            projector.K,
            np.array(BEAM),
        )[0].reshape(90, 120, 2)
        return uv[..., int(vertical)]

    where = across(z)
    columns_per_m = (across(z + 1e-4) - across(z - 1e-4)) / 2e-4
    white = rendering.radiance.pattern[0]
    flat = np.abs(np.gradient(z)).sum(axis=0) < 0.02
    lit = cv2.erode((flat & (white > 0)).astype(np.uint8), np.ones((3, 3))) > 0
    footprint = np.abs(np.gradient(where)).sum(axis=0)
    assert lit.mean() > 0.5
    decoded = codes.reason == Reason.DECODED
    assert decoded[lit].mean() > 0.995
    use = lit & (depth.reason == Reason.DECODED)
    read = codes.row if vertical else codes.column
    bound = 0.5 + 0.5 * footprint
    assert (np.abs(read - where) <= bound)[use].all()
    assert (np.abs(read - where) <= 0.5)[use].mean() > 0.93
    error_m = np.abs(depth.depth_m - z)
    assert (error_m <= 1.1 * bound / np.abs(columns_per_m))[use].all()
    assert (error_m <= 0.5 / np.abs(columns_per_m) * 1.02)[use].mean() > 0.93
    sphere = use & (z < 0.86)
    assert sphere.sum() > 200
