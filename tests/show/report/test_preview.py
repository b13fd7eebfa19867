"""The contact sheet of a small scene whose pixels are defined in this file."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from backends import slow
from drawn import no_pixels
from matplotlib.colors import to_rgb
from PIL import Image

from graycast.base.errors import GraycastError
from graycast.base.frames import axis_rotation, random_quaternions, rigid, rotation_from_quaternion
from graycast.camera.decode import CodeMap, DepthMap, Reason
from graycast.camera.sensor import Capture, SensorSpec, merge_exposures
from graycast.cell.framing import framing_line
from graycast.cell.simulate import Shot
from graycast.dataset.files.sample import Sample
from graycast.rendering import GroundTruth, Radiance, Rendering, Silhouette
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig
from graycast.rig.pattern import gray
from graycast.show.report import preview
from graycast.show.report.bin_view import bin_crop
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import EMPTY_LAYOUT, Bin, Layout, Scene

WIDTH, HEIGHT = 80, 60
F_PX, BASELINE_M, WALL_M = 100.0, 0.1, 0.5
CODE = gray(64, 48)
SENSOR = SensorSpec()
SIDE = slice(20, 40), slice(30, 50)  # rows and columns of the only instance
# The camera is tilted, so that no two frames coincide by chance.
T_WORLD_CAM = rigid(axis_rotation("x", 2.5) @ axis_rotation("z", 0.4), np.array([0.3, -0.2, 0.9]))


def cube(size_m=0.1, middle_m=(0.0, 0.0, 0.0)):
    corner = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)]) - 0.5
    faces = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
             [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]  # fmt: skip
    return Part(
        name="cube",
        mesh=Mesh(vertices_m=corner * size_m + middle_m, faces=np.array(faces)),
        material=Material(),
        density_kg_m3=1000.0,
        friction=0.5,
    )


def rig():
    camera = Optics(
        width_px=WIDTH, height_px=HEIGHT, fx_px=F_PX, fy_px=F_PX, cx_px=39.5, cy_px=29.5
    )
    projector = Optics(width_px=64, height_px=48, fx_px=F_PX, fy_px=F_PX, cx_px=51.5, cy_px=23.5)
    T_cam_proj = rigid(np.eye(3), np.array([BASELINE_M, 0.0, 0.0]))
    return Rig(name="desk", camera=camera, projector=projector, T_cam_proj=T_cam_proj,
               near_m=0.2, far_m=1.0)  # fmt: skip


def quarters():
    """Return red, green over blue, white; all its rotations and mirror images are different."""
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[:30, :40], image[:30, 40:] = (255, 0, 0), (0, 255, 0)
    image[30:, :40], image[30:, 40:] = (0, 0, 255), (255, 255, 255)
    return image


def make_shot(*, error_m=None, reason=None, layout=None, frames=None, scanned=None):
    """Return a wall at WALL_M with an instance in its plane; `reason` marks missing depth."""
    truth_m = np.full((HEIGHT, WIDTH), WALL_M, dtype=np.float32)
    reason = np.zeros((HEIGHT, WIDTH), dtype=np.uint8) if reason is None else reason
    if scanned is None:
        scanned = truth_m + (0 if error_m is None else error_m)
        scanned = np.where(reason == 0, scanned, np.nan).astype(np.float32)
    instance = np.full((HEIGHT, WIDTH), -1, dtype=np.int32)
    amodal = ()
    if layout is None:
        T_cam_part = rigid(np.eye(3), np.array([0.0, 0.0, WALL_M + 0.05]))
        layout = Layout(T_world_part=(T_WORLD_CAM @ T_cam_part)[None], part_index=np.array([0]))
        instance[SIDE] = 0
        amodal = (Silhouette(left_px=30, top_px=20, mask=np.ones((20, 20), dtype=bool)),)
    normal = np.broadcast_to(np.array([0, 0, -1], dtype=np.float32), (HEIGHT, WIDTH, 3)).copy()
    truth = GroundTruth(depth_m=truth_m, normal=normal, instance=instance, amodal=amodal)
    if frames is None:
        frames = np.full((len(CODE.frames), HEIGHT, WIDTH), 2000, dtype=np.uint16)
    colour = np.zeros((HEIGHT, WIDTH, 3), dtype=np.float32)
    column = np.where(reason == 0, np.arange(WIDTH) * 63 / 79, np.nan).astype(np.float32)
    sample = Sample(
        scene=Scene(rig=rig(), T_world_cam=T_WORLD_CAM.copy(), parts=(cube(),)),
        layout=layout,
        truth=truth,
        rgb=quarters(),
        gray=np.zeros((HEIGHT, WIDTH), dtype=np.uint8),
        scanner_depth=DepthMap(
            depth_m=scanned,
            sigma_m=np.where(reason == 0, 1e-4, np.nan),
            reason=reason,
            camera=rig().camera,
        ),
        modulation=np.ones((HEIGHT, WIDTH), dtype=np.float32),
        manifest={
            "scene_id": 7,
            "dataset_seed": 11,
            "backend": "mitsuba",
            "device": "llvm",
            "config": {"render": {"samples": 16, "depth": 4}},
        },
    )
    radiance = Radiance(
        pattern=np.zeros((len(CODE.frames), HEIGHT, WIDTH), dtype=np.float32),
        white=colour[..., 0].copy(), ambient=colour[..., 0].copy(),
        white_rgb=colour, ambient_rgb=colour.copy(), albedo=colour.copy(),
    )  # fmt: skip
    return Shot(
        sample=sample,
        rendering=Rendering(radiance=radiance, truth=truth),
        capture=Capture(frames=frames, sensor=SENSOR, exposure_s=0.02),
        codes=CodeMap(
            column=column,
            row=column.copy(),
            sigma_column=column * 0,
            sigma_row=column * 0,
            modulation=sample.modulation,
            reason=reason,
        ),
    )


@pytest.fixture
def tiles(monkeypatch, tmp_path):
    """Return a function that draws a shot and returns the figure and its tiles by title."""

    def tiles_of(shot):
        figures = []
        monkeypatch.setattr(
            preview, "save_png", lambda figure, path, *, dpi: figures.append(figure)
        )
        preview.draw_preview(shot, CODE, tmp_path / "unused.png")
        return figures[0], {ax.get_title(loc="left"): ax for ax in figures[0].axes if ax.images}

    return tiles_of


def image(ax):
    return np.asarray(ax.images[0].get_array())


# --- the file ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_pictures_are_upright_and_not_mirrored_on_the_sheet(tmp_path):
    """Oracle: the order of four pure colours, which are located on the sheet only by colour."""
    preview.draw_preview(make_shot(), CODE, tmp_path / "sheet.png")
    sheet = np.array(Image.open(tmp_path / "sheet.png").convert("RGB")).astype(int)
    assert sheet.shape[1] == 2400
    first = sheet[:600, :610]  # The colour picture is the first of four tiles in a row.
    middle = {}
    for name, color in (("red", (255, 0, 0)), ("green", (0, 255, 0)), ("blue", (0, 0, 255))):
        rows, columns = np.nonzero(np.abs(first - color).sum(axis=-1) < 8)
        middle[name] = rows.mean(), columns.mean()
        # A tile of 571 x 428 has four quarters; blending may blur a border of a few pixels.
        assert rows.size == pytest.approx(571 * 428 / 4, rel=0.04)
    assert middle["red"][0] == pytest.approx(middle["green"][0], abs=2)
    assert middle["red"][1] == pytest.approx(middle["blue"][1], abs=2)
    assert middle["green"][1] > middle["red"][1] + 200
    assert middle["blue"][0] > middle["red"][0] + 150


@pytest.mark.slow
def test_preview_writes_one_file_with_the_same_bytes_for_the_same_scene(tmp_path):
    (tmp_path / "b.png").write_text("an older sheet")
    for name in ("a.png", "b.png"):
        preview.draw_preview(make_shot(), CODE, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


@pytest.mark.slow
def test_a_sheet_that_cannot_be_written_is_named_and_leaves_no_file(tmp_path):
    (tmp_path / "taken.png").mkdir()
    for path in (tmp_path / "missing" / "sheet.png", tmp_path / "taken.png"):
        with no_pixels(), pytest.raises(GraycastError, match=path.name):
            preview.draw_preview(make_shot(), CODE, path)
    assert [path.name for path in tmp_path.iterdir()] == ["taken.png"]


def test_a_code_other_than_the_captured_one_is_refused(tmp_path):
    with pytest.raises(ValueError, match="14 frames, and the code has 26"):
        preview.draw_preview(make_shot(), gray(64, 48, inverses=True), tmp_path / "sheet.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_heading_of_a_sheet_lists_all_exposures_of_the_scan(tiles):
    shot = make_shot()
    exposure_s = np.full((HEIGHT, WIDTH), 0.02, dtype=np.float32)
    exposure_s[:10] = 0.005
    capture = replace(shot.capture, exposure_s=exposure_s, times_s=(0.005, 0.02))
    merged = replace(shot, capture=capture)
    words = " ".join(text.get_text() for text in tiles(merged)[0].texts)
    assert "exposure 5, 20 ms" in words


@pytest.mark.slow
def test_the_heading_lists_an_exposure_that_no_pixel_uses(tiles):
    """All pixels use the longest of four exposures; the heading lists the other three, too."""
    shot = make_shot()
    times_s = (0.001, 0.01, 0.1, 0.4)
    single = [replace(shot.capture, exposure_s=time_s) for time_s in times_s]
    dim = [replace(one, frames=np.minimum(one.frames, 100)) for one in single]
    merged = merge_exposures(dim)
    assert np.unique(merged.exposure_s).size == 1
    words = " ".join(text.get_text() for text in tiles(replace(shot, capture=merged))[0].texts)
    assert "exposure 1, 10, 100, 400 ms" in words


@pytest.mark.slow
def test_the_number_of_surfaces_on_a_light_path_is_not_called_depth(tiles):
    words = " ".join(text.get_text() for text in tiles(make_shot())[0].texts)
    assert "up to 4 surfaces" in words and "depth 4" not in words


@pytest.mark.slow
def test_a_scene_without_parts_and_without_depth_gives_a_sheet(tiles):
    nowhere = np.full((HEIGHT, WIDTH), Reason.SHADOW, dtype=np.uint8)
    figure, by_title = tiles(make_shot(reason=nowhere, layout=EMPTY_LAYOUT))
    assert len(by_title) == 12
    assert "no parts" in figure.texts[0].get_text()


# --- content of the tiles -----------------------------------------------------------------------


@pytest.mark.slow
def test_the_heading_states_the_number_of_parts_and_the_physics_engine(tiles):
    many = Layout(
        T_world_part=np.tile(np.eye(4), (3, 1, 1)),
        part_index=np.zeros(3, dtype=np.int64),
        at_rest=False,
        deepest_penetration_m=0.00025,
        outside=2,
        attempt=1,
    )
    figure, _ = tiles(make_shot(layout=many))
    title, words = (text.get_text() for text in figure.texts[:2])
    assert title == "scene 7:  3 cube"
    for fact in ("desk", "100 mm", "16 samples", "20 ms", "NOT at rest", "try 2", "0.25 mm",
                 "2 outside", "seed 11", "llvm"):  # fmt: skip
        assert fact in words


@pytest.mark.slow
def test_every_tile_except_the_close_up_shows_the_bin_whose_size_is_stated(tiles):
    shot = make_shot()
    T_world_cam = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, WALL_M], [0, 0, 0, 1]])
    box = Bin(inner_m=(0.12, 0.1, 0.1), wall_m=0.01)
    scene = replace(shot.sample.scene, T_world_cam=T_world_cam, bin=box)
    shot = replace(shot, sample=replace(shot.sample, scene=scene))
    figure, by_title = tiles(shot)
    left, top, width, height = bin_crop(scene, shot.sample.truth)
    assert width < WIDTH and height < HEIGHT
    for title, ax in by_title.items():
        assert ax.get_xlim() == (left - 0.5, left + width - 0.5), title
        assert ax.get_ylim() == (top + height - 0.5, top - 0.5), title
    assert framing_line(scene, shot.sample.layout) in figure.texts[0].get_text()
    # The parts and the bin are between 0.4 and 0.5 m from the camera.
    bar = [ax for ax in figure.axes if ax.texts and "both depths" in ax.texts[0].get_text()]
    assert bar[0].get_xlim() == pytest.approx((398.0, 502.0), abs=1e-3)


@pytest.mark.slow
def test_frames_range_from_the_dark_level_to_saturation(tiles):
    frames = np.full((len(CODE.frames), HEIGHT, WIDTH), 2000, dtype=np.uint16)
    frames[0, :, :20], frames[0, :, 20:40] = 64, 4095
    half_dn = SENSOR.offset_dn + (SENSOR.saturation_dn - SENSOR.offset_dn) / 2
    frames[0, :, 40:] = round(half_dn)
    white = image(tiles(make_shot(frames=frames))[1]["white frame"])
    # In sRGB (IEC 61966-2-1), 188 is half of white.
    assert np.unique(white[:, :20]).tolist() == [0]
    assert np.unique(white[:, 20:40]).tolist() == [255]
    assert np.unique(white[:, 40:]).tolist() == [188]


def test_the_sheet_shows_the_third_coarsest_bit_and_the_finest_bit(tiles):
    """Each frame has its own level. After white and black, 64 columns have the bits 5 to 0."""
    level = np.arange(len(CODE.frames), dtype=np.uint16)[:, None, None] * 200 + 100
    frames = np.broadcast_to(level, (len(CODE.frames), HEIGHT, WIDTH)).copy()
    _, by_title = tiles(make_shot(frames=frames))
    values = {title: int(image(ax)[0, 0, 0]) for title, ax in by_title.items() if " bit " in title}
    assert list(values) == ["column bit 3, stripes of 16 codes", "column bit 0, stripes of 2 codes"]
    linear = {t: (((v / 255) + 0.055) / 1.055) ** 2.4 for t, v in values.items()}
    got_dn = [64 + share * (SENSOR.saturation_dn - 64) for share in linear.values()]
    assert got_dn == pytest.approx([4 * 200 + 100, 7 * 200 + 100], abs=12)  # rounding to 8 bits


@pytest.mark.slow
def test_depth_errors_are_red_for_too_far_blue_for_too_near_and_grey_for_unknown(tiles):
    error_m = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
    error_m[:, :20], error_m[:, 20:40] = 0.05, -0.05
    reason = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    reason[:, 60:] = Reason.SATURATED
    picture = image(tiles(make_shot(error_m=error_m, reason=reason))[1]["scanner minus perfect"])
    far, near, right, unknown = (picture[30, x].astype(int) for x in (10, 30, 50, 70))
    assert far[0] > far[2] + 50 and near[2] > near[0] + 50
    assert right.min() > 240 and np.ptp(unknown) == 0 and unknown.max() < 200


def test_perfect_and_measured_depth_have_the_same_colour_scale(tiles):
    _, by_title = tiles(make_shot())
    np.testing.assert_array_equal(
        image(by_title["perfect depth"]), image(by_title["scanner's depth"])
    )


@pytest.mark.slow
def test_reasons_are_listed_with_their_shares(tiles):
    reason = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    reason[:, :20], reason[:6, 20:] = Reason.SHADOW, Reason.CONTRADICTORY
    ax = tiles(make_shot(reason=reason))[1]["reasons"]
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    part = reason[SIDE]
    first = [100 * (part == r).mean() for r in (Reason.DECODED, Reason.SHADOW)]
    assert words[:5] == [f"decoded {first[0]:.1f} | 67.5 %", f"shadow {first[1]:.1f} | 25.0 %",
                         "low modulation 0.0 | 0.0 %", "saturated 0.0 | 0.0 %",
                         "contradictory 0.0 | 7.5 %"]  # fmt: skip
    assert len(words) == len(Reason)
    handles = ax.get_legend().legend_handles
    for at, index in (((30, 30), 0), ((30, 5), 1), ((2, 30), 4)):
        color = np.round(255 * np.array(to_rgb(handles[index].get_markerfacecolor())))
        np.testing.assert_array_equal(image(ax)[at], color)


@pytest.mark.slow
def test_each_box_is_drawn_around_its_instance(tiles):
    """Oracle: similar triangles; the front of a 0.1 m cube, in the wall, is 20 px wide."""
    _, by_title = tiles(make_shot())
    flat = by_title["boxes of the visible masks"].patches[0]
    assert (flat.get_x(), flat.get_y()) == (29.5, 19.5)
    assert (flat.get_width(), flat.get_height()) == (20, 20)
    segments = np.array(by_title["oriented boxes"].collections[0].get_segments())
    assert segments.min(axis=(0, 1)) == pytest.approx([29.5, 19.5])
    assert segments.max(axis=(0, 1)) == pytest.approx([49.5, 39.5])
    back_px = F_PX * 0.1 / (WALL_M + 0.1)
    back = segments[(np.abs(segments - [39.5, 29.5]) < back_px / 2 + 1e-6).all(axis=(1, 2))]
    assert len(back) == 4


def test_masks_tint_only_their_own_pixels(tiles):
    _, by_title = tiles(make_shot())
    tinted, plain = image(by_title["visible masks"]), image(by_title["white frame"])
    changed = (tinted != plain).any(axis=-1)
    expected = np.zeros((HEIGHT, WIDTH), dtype=bool)
    expected[SIDE] = True
    np.testing.assert_array_equal(changed, expected)


# --- pieces ------------------------------------------------------------------------------------


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.21, 0.08, 0.003, -0.002, 0.01)])
def test_box_edges_agree_with_the_projection_of_opencv(distortion):
    """Oracle: cv2.projectPoints for points on the straight edges, with distortion."""
    rng = np.random.default_rng(3)
    optics = replace(rig().camera, fx_px=900.0, fy_px=870.0, distortion=distortion)
    rotation = rotation_from_quaternion(random_quaternions(1, rng))[0]
    T_cam_part = rigid(rotation, np.array([0.03, -0.05, 0.6]))
    part = cube(middle_m=(0.02, -0.01, 0.04))
    edges = preview.box_edges_px(part, T_cam_part, optics)
    low, high = np.array([-0.03, -0.06, -0.01]), np.array([0.07, 0.04, 0.09])
    expected = set()
    for axis in range(3):
        for corner in range(4):
            first = low.copy()
            others = [a for a in range(3) if a != axis]
            for k, a in enumerate(others):
                first[a] = high[a] if corner >> k & 1 else low[a]
            point = np.repeat(first[None], 3, axis=0)
            point[:, axis] = low[axis], (low[axis] + high[axis]) / 2, high[axis]
            pixel, _ = cv2.projectPoints(
                point, cv2.Rodrigues(rotation)[0], T_cam_part[:3, 3], optics.K, np.array(distortion)
            )
            expected.add(tuple(np.round(pixel.ravel(), 5)))
    middle = edges.shape[1] // 2
    got = {tuple(np.round(edge[[0, middle, -1]].ravel(), 5)) for edge in edges}
    assert got == expected


def test_colour_maps_have_the_published_colours():
    """Oracle: the end colours of viridis, published by S. van der Walt and N. Smith in 2015."""
    value = np.array([[-5.0, 0.0, 10.0, 99.0, np.nan]], dtype=np.float32)
    color = preview.painted(value, "viridis", (0.0, 10.0), unknown=(1.0, 0.0, 0.0))[0]
    assert color.tolist() == [[68, 1, 84]] * 2 + [[253, 231, 37]] * 2 + [[255, 0, 0]]


@pytest.mark.parametrize("sigma_mm", [slow(0.08), 0.3, slow(2.0)])
@pytest.mark.parametrize("spikes", [0, 0.05])
def test_the_scale_of_errors_covers_the_noise_and_not_outliers(tiles, sigma_mm, spikes):
    """Oracle: 99 % of a normal law are within 2.576 sigma; the median error must have a colour."""
    rng = np.random.default_rng(3)
    error_m = rng.normal(0.0, 1e-3 * sigma_mm, (HEIGHT, WIDTH)).astype(np.float32)
    error_m[rng.random(error_m.shape) < spikes] = 0.04
    ax = tiles(make_shot(error_m=error_m))[1]["scanner minus perfect"]
    limit_mm = preview.error_limit_mm(1e3 * error_m)
    assert 2.5 * sigma_mm <= limit_mm < 10 * sigma_mm
    strength = np.ptp(image(ax)[error_m < 0.03].astype(int), axis=-1)  # 0 means grey or white.
    assert (
        np.median(strength) > 10
    )  # The median is 0.67 sigma, which is 7 % of 10 sigma, or 10 of 255 steps.


def test_the_scale_of_errors_is_a_round_number_even_without_errors():
    nothing = np.full((4, 5), np.nan)
    assert preview.error_limit_mm(nothing) == preview.error_limit_mm(0 * np.ones((4, 5))) == 0.01
    few = np.zeros((20, 20))
    few[:3, 0] = 0.013
    few[3:9, 0] = -0.0133
    assert preview.error_limit_mm(few) == pytest.approx(0.015)  # Most errors are 0.


def test_255_instances_have_different_colours():
    color = preview.instance_colors(255)
    distance = np.linalg.norm(color[:, None] - color[None], axis=-1) + 9 * np.eye(255)
    assert distance.min() > 0.01
    following = np.linalg.norm(color[1:] - color[:-1], axis=-1)
    assert following.min() > 0.3
