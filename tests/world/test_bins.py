"""Bins from mesh files are placed and measured as their configuration states."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from graycast.base.errors import MeshError
from graycast.cell.config import Config
from graycast.cell.resolve import file_digests, resolve_cell
from graycast.world.bins import load_bin
from graycast.world.parts import Material
from graycast.world.scene import Bin, bin_mesh, bin_surfaces, table_quad
from studies.crates import Crate

CRATE = Crate()
# Directions of a file's axes in the world if `up` points up; columns are the file's x, y, z.
TURNS = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "-x": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
}


@pytest.mark.parametrize("up", TURNS)
@pytest.mark.parametrize(("unit", "unit_m"), [("mm", 1e-3), ("inch", 0.0254)])
def test_a_crate_in_any_frame_is_moved_to_the_origin_and_measured(tmp_path, up, unit, unit_m):
    """Oracle: the crate as it was made, and its walls at half height in closed form."""
    path = CRATE.write(tmp_path / "crate.stl", unit_m=unit_m, turn=TURNS[up].T)
    loaded = load_bin(path, unit=unit, up=up)
    assert loaded.inner_m == pytest.approx(CRATE.middle_m, abs=2e-6)  # STL has single precision
    solid = CRATE.solid()
    placed = trimesh.Trimesh(loaded.mesh.vertices_m, loaded.mesh.faces)
    assert loaded.mesh.bounds_m == pytest.approx(solid.bounds, abs=2e-6)
    assert placed.volume == pytest.approx(solid.volume, rel=1e-4)  # not inverted
    across = np.einsum("fi,fci->fc", placed.face_normals, loaded.mesh.corner_normals)
    assert across.min() > 0.99  # a crate's faces are flat
    assert cKDTree(solid.vertices).query(placed.vertices)[0].max() < 2e-6
    assert "its floor is 10.0 mm above the table" in loaded.notes[-1]


def test_the_crate_of_these_tests_equals_the_crate_of_the_examples(tmp_path):
    ours = Path(__file__).resolve().parents[2] / "examples" / "data" / "crate.stl"
    assert CRATE.write(tmp_path / "crate.stl").read_bytes() == ours.read_bytes()


def test_a_bin_read_from_a_mesh_of_a_box_equals_the_box(tmp_path):
    box = Bin(inner_m=(0.40, 0.30, 0.15), wall_m=0.012)
    own = bin_mesh(box)
    trimesh.Trimesh(own.vertices_m, own.faces, process=False).export(tmp_path / "box.ply")
    loaded = load_bin(tmp_path / "box.ply", unit="m", up="z")
    assert loaded.inner_m == pytest.approx(box.inner_m, abs=1e-7)
    as_mesh = Bin(inner_m=loaded.inner_m, mesh=loaded.mesh)
    assert as_mesh.bounds_m == pytest.approx(box.bounds_m, abs=1e-7)
    assert as_mesh.floor_m == pytest.approx(box.floor_m, abs=1e-7)


def test_the_table_is_below_the_bars_of_a_crate_and_its_inner_floor_is_separate(tmp_path):
    cell = resolve_cell(config(CRATE.write(tmp_path / "crate.stl")), tmp_path)
    assert table_quad(cell.scene).center_m == pytest.approx((0, 0, -0.010), abs=1e-6)
    (name, walls, _), (floor_name, floor, material) = bin_surfaces(cell.scene.bin)
    assert (name, floor_name, material.base_color) == ("bin", "floor", (0.1, 0.2, 0.3))
    corner = floor.vertices_m[floor.faces]
    area_m2 = (
        np.linalg.norm(
            np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
        ).sum()
        / 2
    )
    assert area_m2 == pytest.approx(np.prod(CRATE.inner_m[:2]), rel=1e-4)
    assert np.abs(corner[..., 2]).max() < 1e-6
    assert len(walls.faces) + len(floor.faces) == len(cell.scene.bin.mesh.faces)
    assert floor.corner_normals[..., 2] == pytest.approx(np.ones((len(floor.faces), 3)), abs=1e-6)


def test_a_foot_level_with_the_inner_floor_is_not_taken_for_the_floor(tmp_path):
    crate = Crate(floor_m=0.01, bar_m=0.0)
    foot = trimesh.creation.box((0.5, 0.4, 0.01))
    foot.apply_translation((0.0, 0.0, -0.005))
    body = trimesh.boolean.union([crate.solid(), foot], engine="manifold")
    body.export(tmp_path / "crate.stl")
    loaded = load_bin(tmp_path / "crate.stl", unit="m", up="z")
    material = Material()
    box = Bin(inner_m=loaded.inner_m, mesh=loaded.mesh, floor=material)
    _, (_, floor, _) = bin_surfaces(box)
    reach_m = np.abs(floor.vertices_m[floor.faces][..., :2]).max(axis=(0, 1))
    assert reach_m == pytest.approx(np.array(crate.inner_m[:2]) / 2, abs=1e-4)


def test_textures_of_a_mesh_bin_repeat_as_on_a_box(tmp_path):
    """One metre of wall is 1 / texture_size_m pictures, along each face's own axes."""
    box = Bin(inner_m=CRATE.middle_m, mesh=CRATE.load(tmp_path).mesh, texture_size_m=0.25)
    mesh = bin_mesh(box)
    corner, uv = mesh.vertices_m[mesh.faces], mesh.corner_uv
    level = np.abs(corner[..., 2]).max(axis=1) < 1e-6
    assert level.any()
    assert uv[level] == pytest.approx(corner[level][..., :2] / 0.25)


def config(path, **words):
    box = {"mesh": path.name, "unit": "mm", "floor": {"base_color": [0.1, 0.2, 0.3]}} | words
    return Config.model_validate({"parts": [{"builtin": "toothpaste"}], "bin": box})


def test_a_bin_with_a_mesh_and_a_size_is_refused(tmp_path):
    path = tmp_path / "crate.stl"
    with pytest.raises(ValueError, match="a mesh has its own size: remove inner_m, or mesh"):
        config(path, inner_m=[0.3, 0.2, 0.1])
    with pytest.raises(
        ValueError, match="unit and up_axis of a bin belong to a mesh: name its file"
    ):
        Config.model_validate(
            {"parts": [{"builtin": "toothpaste"}], "bin": {"unit": "mm", "up_axis": "y"}}
        )
    again = Config.model_validate(config(path).model_dump(mode="json"))
    assert again == config(path)


def test_a_changed_bin_mesh_gives_another_dataset(tmp_path):
    path = CRATE.write(tmp_path / "crate.stl")
    before = file_digests(config(path), tmp_path)
    Crate(wall_m=0.004).write(path)
    after = file_digests(config(path), tmp_path)
    assert set(before) == set(after) == {"crate.stl"}
    assert before != after


@pytest.mark.parametrize("up", ["-z", "x", "y"])
def test_a_crate_that_is_not_upright_is_refused_as_a_bin(tmp_path, up):
    path = CRATE.write(tmp_path / "crate.stl")
    with pytest.raises(
        MeshError, match=f"not an open bin whose opening faces {up}.*state with up_axis which"
    ):
        load_bin(path, unit="mm", up=up)


def test_a_block_or_a_plate_is_refused_as_a_bin(tmp_path):
    for size in ((0.4, 0.3, 0.2), (0.4, 0.3, 0.005)):
        trimesh.creation.box(size).export(tmp_path / "block.stl")
        with pytest.raises(MeshError, match="the middle is not lower than the top"):
            load_bin(tmp_path / "block.stl", unit="m", up="z")


def test_real_bins_have_the_sizes_in_their_drawings(shared):
    """Oracle: the liner that NIST publishes with its parts bin; a drawing of cuts, read by eye."""
    nist = shared / "data" / "meshes" / "nist"
    liner = trimesh.load_mesh(nist / "parts_bin" / "bin_interior.stl")
    outer = trimesh.load_mesh(nist / "parts_bin" / "bin_exterior.stl")
    loaded = load_bin(nist / "parts_bin" / "bin_exterior.stl", unit="m", up="z")
    assert -loaded.mesh.bounds_m[0, 2] == pytest.approx(liner.bounds[0, 2], abs=1e-3)
    for axis in (0, 1):
        assert liner.extents[axis] < loaded.inner_m[axis]
        assert loaded.inner_m[axis] == pytest.approx(outer.extents[axis] - 0.033, abs=2e-3)
    disposal = load_bin(nist / "disposal_bin" / "disposal_bin.stl", unit="m", up="z")
    assert disposal.inner_m == pytest.approx((0.530, 0.530, 0.475), abs=1e-3)
