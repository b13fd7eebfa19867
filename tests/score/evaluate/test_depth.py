"""The scanner's depth by angle of incidence, on surfaces whose angle and error are known."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drawn import no_pixels
from metered import Metered

from graycast.base.errors import GraycastError
from graycast.dataset.read.scene_content import SceneContent
from graycast.dataset.read.stored import StoredScene
from graycast.rig.optics import Optics, rays
from graycast.score.evaluate.depth import (
    EDGE,
    depth_markdown,
    depth_rows,
    evaluate_depth,
    incidence_rad,
    write_depth,
)

K = np.array([[300.0, 0, 79.5], [0, 280.0, 59.5], [0, 0, 1]])
LENS = (-0.05, 0.02, 0.001, -0.002, 0.0)
SIZE = (120, 160)
Z_M = 0.8


def ray_of_pixels(distortion):
    optics = Optics(
        width_px=160, height_px=120, fx_px=300.0, fy_px=280.0, cx_px=79.5, cy_px=59.5,
        distortion=distortion,
    )  # fmt: skip
    y, x = np.mgrid[:120, :160].astype(float)
    return rays(optics, np.stack([x, y], axis=-1))


def plane_z(ray, normal):
    """Return the depth of a plane through (0, 0, Z_M): z = n . p0 / n . r."""
    return Z_M * normal[2] / (ray @ normal)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, LENS])
@pytest.mark.parametrize("tilt_deg", [0, 30, 60])
def test_the_angle_of_incidence_is_between_normal_and_ray(tilt_deg, distortion):
    """Oracle: the plane's normal, whereas the code knows only the depths."""
    ray = ray_of_pixels(distortion)
    turn = np.radians(tilt_deg)
    normal = np.array([np.sin(turn) * 0.8, np.sin(turn) * 0.6, -np.cos(turn)])
    angle = incidence_rad(plane_z(ray, normal), K=K, distortion=distortion)
    expected = np.arccos(np.abs(ray @ normal) / np.linalg.norm(ray, axis=-1))
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(angle[inner], expected[inner], atol=1e-6)
    assert np.isnan(angle[0]).all()
    assert np.isnan(angle[:, -1]).all()


def test_pixels_next_to_a_step_or_a_hole_have_no_angle():
    depth_m = np.full(SIZE, Z_M)
    depth_m[:, 80:] = Z_M + 0.05
    depth_m[60, 20] = np.nan
    angle = incidence_rad(depth_m, K=K, distortion=(0.0,) * 5)
    odd = np.isnan(angle[1:-1, 1:-1])
    assert odd[:, 78:80].all()
    assert odd[58:61, 19].all() and odd[59, 18:21].all()
    assert odd.sum() == 2 * 118 + 5


def scene(tilt_deg, *, error_steps, missing, scale_mm=0.1):
    """Return a tilted plane, `error_steps` (h, w) too far, and without depth where `missing`."""
    turn = np.radians(tilt_deg)
    normal = np.array([np.sin(turn), 0.0, -np.cos(turn)])
    steps = np.rint(plane_z(ray_of_pixels((0.0,) * 5), normal) * 1000 / scale_mm)
    depth = steps.astype(np.uint16)
    scanner = np.where(missing, 0, steps + error_steps).astype(np.uint16)
    stored = StoredScene(
        folder=Path(),
        split="train",
        scene_id=0,
        size_px=SIZE,
        categories={},
        real=False,
        holds=frozenset(),
    )
    return SceneContent(
        stored=stored,
        rgb=None,
        gray=None,
        instances=(),
        manifest={},
        depth=depth,
        scanner=scanner,
        reason=np.where(missing, 1, 0).astype(np.uint8),
        reason_name={0: "decoded", 1: "shadow"},
        label=np.where(np.arange(160) < 80, 0, -1) + np.zeros(SIZE, int),
        view={"cam_K": K.ravel().tolist(), "distortion": [0.0] * 5, "depth_scale": scale_mm},
    )


def test_known_bias_noise_spikes_and_holes_are_measured():
    """Errors have a sigma of 0.4 mm and a mean of 0.3 mm, 2 % of the pixels are spikes, and 10 %
    are missing. With this tilt, all angles are between 40 and 70 degrees."""
    rng = np.random.default_rng(3)
    error = np.rint(rng.normal(3, 4, SIZE)).astype(int)
    error[rng.random(SIZE) < 0.02] = 80
    missing = rng.random(SIZE) < 0.1
    tables = depth_rows([scene(55, error_steps=error, missing=missing)])
    rows = tables["all"]
    large = [row for row in rows[:EDGE] if row.pixels > 3000]
    assert {row.name for row in large} <= {"40 to 50 deg", "50 to 60 deg", "60 to 70 deg"}
    for row in large:
        n = row.error.pixels
        assert row.reason["shadow"] == pytest.approx(0.1, abs=4 * (0.09 / row.pixels) ** 0.5)
        assert row.error.beyond_5mm == pytest.approx(0.02, abs=4 * (0.0196 / n) ** 0.5)
        assert row.error.median_mm == pytest.approx(0.31, abs=4 * 1.25 * 0.41 / n**0.5)
        assert row.error.sigma_mm == pytest.approx(0.41, rel=0.06)
    assert sum(row.pixels for row in rows) == 120 * 160
    assert rows[EDGE].pixels == 2 * (120 + 160) - 4
    assert sum(row.pixels for row in tables["parts"]) == 120 * 80


def test_scenes_with_different_depth_steps_are_combined():
    none = np.zeros(SIZE, bool)
    coarse = scene(10, error_steps=np.full(SIZE, 2), missing=none, scale_mm=0.1)
    fine = scene(10, error_steps=np.full(SIZE, 4), missing=none, scale_mm=0.05)
    rows = depth_rows([coarse, fine])["all"]
    known = [row for row in rows if row.pixels]
    assert all(row.error.median_mm == pytest.approx(0.2, abs=1e-9) for row in known)


def test_depth_tables_of_a_dataset_are_written(master, tmp_path):
    meter = Metered()
    tables = evaluate_depth(master, progress=meter)
    assert meter.counts == [("scenes", k, 4) for k in range(1, 5)]
    with no_pixels():
        write_depth(tables, tmp_path, colors={"shadow": "#123456"})
    assert {file.name for file in tmp_path.iterdir()} == {
        "depth.json", "depth.csv", "depth.md", "depth.png"
    }  # fmt: skip
    text = depth_markdown(tables)
    assert "## All pixels" in text
    lines = (tmp_path / "depth.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * (EDGE + 1)


def test_a_dataset_without_perfect_depth_is_refused(master, monkeypatch):
    from graycast.score.evaluate import depth

    bare = SimpleNamespace(holds=frozenset({"rgb", "depth_sl"}), scenes=())
    monkeypatch.setattr(depth, "open_dataset", lambda _: bare)
    with pytest.raises(GraycastError, match="has no depth: "):
        evaluate_depth(master)
