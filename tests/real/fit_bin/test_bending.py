"""Bending of a bin's mesh to scans of a bin whose true shape is known."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
import yaml
from drawn import no_pixels
from small_cell import shrunk, write_cell

from graycast.base.errors import GraycastError
from graycast.base.frames import inverse, transform_points
from graycast.camera.rig_file import save_scanner
from graycast.camera.scanner import Scanner
from graycast.cell.config import load_config
from graycast.cell.resolve import resolve_cell
from graycast.cli import main
from graycast.real.fit_bin import fitting
from graycast.real.fit_bin.bending import bend_bin, bent_bin
from graycast.rig.meshdepth import rasterize
from graycast.rig.optics import Optics
from graycast.rig.pair import preset_rig
from graycast.world.parts import Mesh
from graycast.world.scene import Bin, bin_mesh

from . import empty_bins
from .empty_bins import noisy, perfect_depth, pose

CAMERA = Optics(width_px=400, height_px=300, fx_px=330.0, fy_px=330.0, cx_px=199.5, cy_px=149.5)
BOX = Bin(inner_m=(0.40, 0.30, 0.15), wall_m=0.012)
STRAIGHT = Mesh(vertices_m=bin_mesh(BOX).vertices_m, faces=bin_mesh(BOX).faces)
# The camera is above the wall -x, so that it does not see the wall +x at a grazing angle.
T = pose(azimuth_deg=0.0, distance_m=0.6, aside_m=(-0.08, -0.02))
# Low and high corner of blocks above the middle of the floor, much nearer than the floor.
BLOCKS = (((-0.06, -0.05, 0.03), (0.05, 0.04, 0.06)), ((0.06, -0.02, 0.0), (0.10, 0.05, 0.05)))


def solid(mesh):
    return trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)


def cast(mesh, T=T, camera=CAMERA):
    vertices_cam = transform_points(inverse(T), mesh.vertices_m)
    return rasterize(vertices_cam, mesh.faces, camera).over(camera)[1]


@cache
def bulged():
    """Return a finely meshed box whose wall +x bulges by 6 mm and whose floor sags by 3 mm."""
    x, y, z = (size / 2 for size in BOX.inner_m)
    vertices, faces = trimesh.remesh.subdivide_to_size(
        STRAIGHT.vertices_m, STRAIGHT.faces, 5e-3, max_iter=20
    )
    on_wall = vertices[:, 0] > x - 1e-9
    up, along = (
        np.clip(vertices[:, 2] / (2 * z), 0, 1),
        np.clip(vertices[:, 1] / (2 * y), -0.5, 0.5),
    )
    out_m = 6e-3 * np.sin(np.pi * up) * np.cos(np.pi * along)
    inside = (np.abs(vertices[:, 0]) < x - 1e-9) & (np.abs(vertices[:, 1]) < y - 1e-9)
    low = inside & (vertices[:, 2] < 1e-9)
    shape = np.sin(np.pi * (vertices[:, 0] / (2 * x) + 0.5))
    shape = shape * np.sin(np.pi * (vertices[:, 1] / (2 * y) + 0.5))
    moved = vertices + np.column_stack([on_wall * out_m, 0 * out_m, -3e-3 * low * shape])
    return Mesh(vertices_m=moved, faces=faces)


@pytest.fixture(scope="module")
def scanned():
    """Return the true depth, its scan with parts, gaps and noise, and the mesh bent to the scan."""
    true_m = cast(bulged())
    with_blocks = perfect_depth(T, BOX, CAMERA, BLOCKS)
    covered = with_blocks < cast(STRAIGHT) - 0.02
    scan_m = np.where(covered, with_blocks, true_m)
    rng = np.random.default_rng(0)
    scan_m[rng.random(scan_m.shape) < 0.1] = np.nan
    scan_m[200:230, 120:150] = np.nan
    scan_m = noisy(scan_m, 0.1e-3, 1)
    return true_m, scan_m, covered, bend_bin(STRAIGHT, T, CAMERA, scan_m)


def test_the_visible_surface_of_the_bent_mesh_equals_the_measured_surface(scanned):
    """Oracle: the depth of the true shape, which is bent by a formula in the bin's frame."""
    true_m, scan_m, covered, bent = scanned
    straight_m = cast(STRAIGHT)
    point = T[:3, 3] + _rays() @ T[:3, :3].T * straight_m[..., None]
    inner = (np.abs(point[..., :2]) < np.array(BOX.inner_m[:2]) / 2 + 1e-6).all(axis=-1)
    measured = np.isfinite(scan_m) & ~covered & inner & (np.abs(true_m - straight_m) < 15e-3)
    off_m = np.abs(cast(bent) - true_m)
    before_m = np.abs(straight_m - true_m)
    assert np.quantile(before_m[measured], 0.9) > 2e-3
    assert np.median(off_m[measured]) < 0.3e-3
    assert np.quantile(off_m[measured], 0.95) < 1e-3
    wall = measured & (before_m > 8e-3)
    assert wall.sum() > 500
    assert np.median(off_m[wall]) < 0.3e-3
    hidden = covered & (np.abs(point[..., 2]) < 1e-3)
    assert hidden.sum() > 1000
    assert np.median(before_m[hidden]) > 2e-3
    assert np.quantile(off_m[hidden], 0.95) < 1.2e-3


def _rays():
    y, x = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px].astype(float)
    ray = [(x - CAMERA.cx_px) / CAMERA.fx_px, (y - CAMERA.cy_px) / CAMERA.fy_px, np.ones_like(x)]
    return np.stack(ray, axis=-1)


@pytest.mark.slow
def test_a_bin_that_equals_its_drawing_is_unchanged():
    bent = bend_bin(STRAIGHT, T, CAMERA, perfect_depth(T, BOX, CAMERA, BLOCKS))
    (x, y, height), wall = BOX.inner_m, BOX.wall_m
    sides = ([x / 2, x / 2 + wall], [y / 2, y / 2 + wall])
    off = [np.abs(np.abs(bent.vertices_m[:, [k]]) - sides[k]) for k in (0, 1)]
    off.append(np.abs(bent.vertices_m[:, [2]] - [0.0, height, -wall]))
    assert np.concatenate(off, axis=1).min(axis=1).max() < 0.05e-3  # on one of the box's planes
    vertices_m = bent.vertices_m[: len(STRAIGHT.vertices_m)]
    assert np.abs(vertices_m - STRAIGHT.vertices_m).max() < 0.05e-3


def test_a_bent_bin_is_still_a_solid(scanned):
    bent = solid(scanned[3])
    assert bent.is_watertight
    assert bent.is_winding_consistent
    assert bent.volume == pytest.approx(solid(STRAIGHT).volume, rel=0.05)
    # The outside of a wall moves with its inside, so it bulges, too.
    _, y, z = bent.vertices.T
    middle = (np.abs(y) < 0.02) & (np.abs(z - 0.075) < 0.02)
    assert bent.vertices[middle, 0].max() > BOX.inner_m[0] / 2 + BOX.wall_m + 3e-3


def test_a_bin_at_another_place_is_refused():
    far_m = perfect_depth(T, BOX, CAMERA) + 0.05
    with pytest.raises(GraycastError, match="check the pose and the mesh"):
        bend_bin(STRAIGHT, T, CAMERA, far_m)
    with pytest.raises(ValueError, match="the depth is 399 x 300 pixels"):
        bend_bin(STRAIGHT, T, CAMERA, far_m[:, 1:])


@pytest.mark.slow
def test_a_flat_part_in_one_of_two_views_does_not_bend_the_bin():
    """The median of two depths is their mean, here halfway between the part and the floor.

    Oracle: the depth of the same bin without the part.
    """
    plate = ((-0.04, -0.04, 0.0), (0.04, 0.04, 0.01))
    T_high = empty_bins.pose(tilt_deg=0.0, azimuth_deg=0.0)
    empty_m, filled_m = (empty_bins.perfect_depth(T_high, blocks=b) for b in ((), (plate,)))
    views = [empty_bins.view(noisy(z_m, 0.1e-3, k)) for k, z_m in enumerate((empty_m, filled_m))]
    bent = bent_bin(BOX, T_high, views)
    off_m = np.abs(cast(bent.mesh, bent.T_world_cam, empty_bins.CAMERA) - empty_m)
    covered = filled_m < empty_m - 9e-3
    assert covered.sum() > 200
    assert off_m[covered].max() < 0.5e-3


# --- the command -------------------------------------------------------------------------------


def run(*arguments):
    return main(["real", "fit-bin", *map(str, arguments), "--debug"])


SMALL = shrunk(CAMERA, 200, 150)


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Write a configuration whose bin is a mesh, and a scan of the bulged bin.

    The fit starts at the true pose; tests/real/fit_bin/test_pose.py tests other start poses.
    """
    search = fitting.find_pose
    monkeypatch.setattr(fitting, "find_pose", lambda *a, **k: search(*a, **k | {"stated": T}))
    solid(STRAIGHT).apply_scale(1e3).export(tmp_path / "bin.stl")
    words = {"bin": {"mesh": "bin.stl", "unit": "mm", "material": {"base_color": [0.4] * 3}}}
    path = write_cell(tmp_path, **words, view={"T_world_cam": T.ravel().tolist()})
    rig = preset_rig("paper")
    projector = shrunk(rig.projector, 128, 96)
    rig = replace(rig, name="small", camera=SMALL, projector=projector)
    (tmp_path / "rig.yaml").unlink()
    save_scanner(Scanner(rig=rig), tmp_path / "rig.yaml")
    np.save(tmp_path / "scan.npy", cast(bulged(), camera=SMALL))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("box", [False, True])
def test_the_new_configuration_names_the_bent_mesh_and_gives_the_scanned_depth(cell, box, capsys):
    folder = cell.parent
    if box:
        words = yaml.safe_load(cell.read_text())
        words["bin"] = {"inner_m": list(BOX.inner_m), "wall_m": BOX.wall_m}
        cell.write_text(yaml.safe_dump(words))
    out, mesh = folder / "fitted.yaml", folder / "bent.ply"
    scan = folder / "scan.npy"
    arguments = (scan, "--config", cell, "--out", out, "--pose-only", "--bend", mesh)
    with no_pixels():
        assert run(*arguments) == 0
    assert "from the bent mesh" in capsys.readouterr().out
    section = yaml.safe_load(out.read_text())["bin"]
    assert section["mesh"] == "bent.ply"
    assert section["unit"] == "m"
    assert section["material"]["base_color"] != [0.5, 0.5, 0.5]
    scene = resolve_cell(load_config(out), folder).scene
    # The origin is moved to the middle of the bent floor, and the camera's pose accordingly.
    off_m = np.abs(cast(scene.bin.mesh, scene.T_world_cam, SMALL) - np.load(scan))
    assert np.nanmedian(off_m) < 0.3e-3
    report = json.loads((folder / "fitted.fit.json").read_text())["bent"]
    assert report["after_m"]["p90"] < 0.5 * report["before_m"]["p90"]


def test_an_existing_mesh_is_not_overwritten(cell):
    mesh = cell.with_name("bent.ply")
    mesh.write_text("of another run")
    arguments = (cell.with_name("scan.npy"), "--config", cell, "--out", cell.with_name("new.yaml"))
    with pytest.raises(GraycastError, match=r"bent\.ply: exists already"):
        run(*arguments, "--bend", mesh)
    with pytest.raises(GraycastError, match=r"ends with \.ply"):
        run(*arguments, "--bend", cell.with_name("bent.stl"))
    assert mesh.read_text() == "of another run"
    assert not cell.with_name("new.yaml").exists()
