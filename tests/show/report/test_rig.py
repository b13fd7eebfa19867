"""The picture and the figures of a rig, compared with similar triangles."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from backends import slow

from graycast.base.frames import axis_rotation, rigid
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig, preset_rig
from graycast.show.report import rig_picture
from graycast.show.report.rig_picture import common_field, describe_rig, draw_rig, footprint_m

PURPLE = (148, 103, 189)  # colour of the common volume without transparency


def parallel_rig(rotation=None):
    """Return a camera with a field of 1.0 z by 0.8 z, and a projector with 0.6 z by 0.4 z."""
    rotation = np.eye(3) if rotation is None else rotation
    return Rig(
        name="parallel",
        camera=Optics(
            width_px=500, height_px=400, fx_px=500.0, fy_px=500.0, cx_px=249.5, cy_px=199.5
        ),
        projector=Optics(
            width_px=300, height_px=200, fx_px=500.0, fy_px=500.0, cx_px=149.5, cy_px=99.5
        ),
        T_cam_proj=rigid(rotation, np.array([0.3, 0.0, 0.0])),
        near_m=0.5,
        far_m=1.5,
    )


@pytest.mark.parametrize("z_m", [0.4, 1.0, 3.0])
def test_fields_of_view_of_a_parallel_rig_follow_similar_triangles(z_m):
    rig = parallel_rig()
    camera = footprint_m(rig.camera, np.eye(4), z_m)
    assert np.allclose(np.abs(camera).max(axis=0), [0.5 * z_m, 0.4 * z_m])
    projector = footprint_m(rig.projector, rig.T_cam_proj, z_m)
    assert np.allclose(projector.min(axis=0), [0.3 - 0.3 * z_m, -0.2 * z_m])
    assert np.allclose(projector.max(axis=0), [0.3 + 0.3 * z_m, 0.2 * z_m])
    (left, top), (right, bottom) = (f(common_field(rig, z_m), axis=0) for f in (np.min, np.max))
    expected = [max(0.3 - 0.3 * z_m, -0.5 * z_m), min(0.3 + 0.3 * z_m, 0.5 * z_m)]
    assert np.allclose([left, right], expected)
    assert np.allclose([top, bottom], [-0.2 * z_m, 0.2 * z_m])


@pytest.mark.parametrize("z_m", [0.384, 0.45, 0.52])
def test_the_common_field_of_view_of_a_toed_in_rig_agrees_with_random_points(z_m):
    """Oracle: random points of the plane that are inside both pinhole projections."""
    rig = preset_rig("like-phoxi-s")
    rng = np.random.default_rng(0)
    half = np.array([0.6, 0.4])
    point = np.hstack([rng.uniform(-half, half, size=(200_000, 2)), np.full((200_000, 1), z_m)])
    visible = np.ones(len(point), dtype=bool)
    R, t = rig.T_cam_proj[:3, :3], rig.T_cam_proj[:3, 3]
    for optics, local in ((rig.camera, point), (rig.projector, (point - t) @ R)):
        x, y = (local[:, :2] / local[:, 2:] * optics.fx_px).T
        visible &= (np.abs(x) < optics.width_px / 2) & (np.abs(y) < optics.height_px / 2)
    share, error = visible.mean(), np.sqrt(visible.var() / len(visible))
    field = common_field(rig, z_m)
    area_m2 = cv2.contourArea(field.astype(np.float32))
    assert abs(area_m2 / np.prod(2 * half) - share) < 4 * error
    assert np.allclose(field.min(axis=0), point[visible, :2].min(axis=0), rtol=0, atol=3e-3)
    assert np.allclose(field.max(axis=0), point[visible, :2].max(axis=0), rtol=0, atol=3e-3)


def test_a_projector_that_looks_sideways_has_no_footprint():
    rig = parallel_rig(axis_rotation("y", np.pi / 2))
    assert footprint_m(rig.projector, rig.T_cam_proj, 1.0).shape == (0, 2)
    assert common_field(rig, 1.0).shape == (0, 2)


def test_the_description_of_a_rig_has_the_figures_of_similar_triangles():
    """Oracle: z^2 / (f b) per column is 1.0 / 150 m at 1 m; nearer points are outside the field."""
    text = describe_rig(parallel_rig())
    assert "baseline          300.0 mm" in text
    assert "toe-in            0.00 deg" in text
    assert "500 x 400 px, field 53.13 x 43.60 deg" in text  # 2 atan 0.5, 2 atan 0.4
    assert "300 x 200 px, field 33.40 x 22.62 deg" in text  # 2 atan 0.3, 2 atan 0.2
    near, _, far = text.splitlines()[-3:]
    assert near.split()[:3] == ["near", "500", "mm"]
    assert "not lit on axis" in near
    assert near.endswith("100 x 200 mm")  # The field is from x = 0.15 to 0.25 m.
    assert far.split()[:5] == ["far", "1500", "mm", "15.000", "mm"]  # 1.5^2 / 150
    assert far.endswith("900 x 600 mm")


def test_rows_are_described_if_the_projector_is_above_the_camera():
    """The same rig is rotated by 90 degrees: 1.5^2 / 150 m per row, and no depth per column."""
    rig = parallel_rig()
    above = replace(
        rig,
        T_cam_proj=rigid(np.eye(3), np.array([0.0, 0.3, 0.0])),
        projector=replace(rig.projector, height_px=300, cy_px=149.5),
    )
    text = describe_rig(above)
    assert "one row" in text
    assert "column" not in text
    assert text.splitlines()[-1].split()[:5] == ["far", "1500", "mm", "15.000", "mm"]
    assert "one column" in describe_rig(rig)


def purple_share(rig, path):
    draw_rig(rig, path)
    picture = cv2.imread(str(path))[..., ::-1].astype(float)
    # Transparent purple over white or over a pale field has less green than red or blue.
    red, green, blue = np.moveaxis(picture, -1, 0)
    return ((green < blue - 20) & (green < red - 10) & (blue > red)).mean()


@pytest.mark.slow
def test_the_picture_shows_a_common_volume_only_if_the_fields_of_view_overlap(tmp_path):
    assert purple_share(preset_rig("like-phoxi-s"), tmp_path / "s.png") > 0.05
    aside = parallel_rig(axis_rotation("y", np.pi / 2))
    assert purple_share(aside, tmp_path / "aside.png") < 0.002  # only the legend's patch
    assert "none" in describe_rig(aside)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [slow("like-phoxi-m"), slow("like-zivid-2-m70"), "office-projector"]
)
def test_the_two_views_of_a_rig_have_one_scale_and_fill_their_areas(name, monkeypatch, tmp_path):
    """A millimetre has the same length in both views, and little space is empty."""
    figures = []
    monkeypatch.setattr(rig_picture, "save_png", lambda figure, path, dpi: figures.append(figure))
    draw_rig(preset_rig(name), tmp_path / "rig.png")
    figures[0].draw_without_rendering()
    above, side, depth = figures[0].axes[:3]
    boxes = [ax.get_window_extent() for ax in (above, side)]
    scales = [ax.get_window_extent().height / np.ptp(ax.get_ylim()) for ax in (above, side)]
    assert scales[0] == pytest.approx(scales[1], rel=1e-6)
    assert [box.height for box in boxes] == pytest.approx([depth.bbox.height] * 2, rel=0.1)
