"""The bin in the 3D view of a dataset's page: its mesh, and its pixels in a browser."""

import base64
import json
import zlib

import cv2
import numpy as np
import pytest
import trimesh
from pictured import write_dataset

from graycast.cell.config import BinSection, resolve_bin
from graycast.cell.domain.vary import _changed_bin
from graycast.dataset.files.seal import sha256
from graycast.dataset.read.stored import StoredDataset
from graycast.show.report.page import write_report
from graycast.show.report.page.walls import dataset_walls, packed_walls
from graycast.world.scene import Bin, bin_mesh

from .browsing import opened, watched_page

INNER_M, WALL_M = (0.4, 0.3, 0.15), 0.012


def unpacked(text, dtype="<f4"):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype).reshape(-1, 3)


def dataset(folder, section, **claim):
    digests = {path.name: sha256(path.read_bytes()) for path in folder.glob("*.stl")}
    return StoredDataset(
        folder=folder / "out",
        claim={"config": {"bin": section.model_dump(mode="json"), "files": digests}, **claim},
        categories={},
        scene_ids={"train": ()},
        sizes_px={"": (48, 64)},
        images=(("", 0),),
        holds=frozenset(),
    )


@pytest.fixture
def crate(tmp_path):
    """Return a configuration with a mesh file of a bin, which is a box with walls of 10 mm."""
    block = trimesh.creation.box((300, 200, 100))
    hole = trimesh.creation.box(
        (280, 180, 100), trimesh.transformations.translation_matrix((0, 0, 10))
    )
    trimesh.boolean.difference([block, hole]).export(tmp_path / "crate.stl")
    return BinSection(mesh="crate.stl", unit="mm")


def test_the_walls_of_a_box_bin_are_its_inside_and_its_rim(tmp_path):
    """Oracle: the areas of floor, four walls and rim in closed form; no face points outwards."""
    walls = dataset_walls(dataset(tmp_path, BinSection(inner_m=INNER_M, wall_m=WALL_M)), tmp_path)
    corner = unpacked(walls["vertices"])[unpacked(walls["faces"], "<u4")]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).astype(float)
    area_mm2 = np.linalg.norm(cross, axis=1) / 2
    up = cross[:, 2] > 0
    assert area_mm2[up].sum() == pytest.approx(424 * 324, rel=1e-5)
    assert area_mm2[~up].sum() == pytest.approx(2 * 150 * (400 + 300), rel=1e-5)
    inwards = np.einsum("fi,fi->f", cross, corner.mean(axis=1))[~up] < 0
    assert inwards.all()


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_walls_are_scaled_like_the_bin_of_a_randomised_scene(crate, tmp_path, factor):
    """Oracle: the bin that a domain makes with the same size factor."""
    values = {
        "size_factor": factor,
        "color": {"hue_deg": 30.0, "saturation": 0.5, "value": 0.5},
        "texture": None,
    }
    values |= {"roughness": 0.5, "metallic": 0.0, "specular": 0.5, "texture_size_m": 0.5}
    for box in (Bin(inner_m=INNER_M, wall_m=WALL_M), resolve_bin(crate, tmp_path)[0]):
        walls = packed_walls(box)
        vertices = unpacked(walls["vertices"]) + (factor - 1) * unpacked(walls["growth"])
        expected = bin_mesh(_changed_bin(box, values, None)).vertices_m
        np.testing.assert_allclose(vertices, 1e3 * expected, atol=1e-3)


def test_a_mesh_bin_is_drawn_from_its_file_and_a_missing_file_is_reported(crate, tmp_path):
    stored = dataset(tmp_path, crate)
    walls = dataset_walls(stored, tmp_path)
    expected = bin_mesh(resolve_bin(crate, tmp_path)[0]).vertices_m
    np.testing.assert_allclose(unpacked(walls["vertices"]), 1e3 * expected, atol=1e-3)
    missing = dataset_walls(stored, tmp_path / "elsewhere")["missing"]
    assert "crate.stl" in missing and missing.endswith("with --files.")
    trimesh.load(tmp_path / "crate.stl").apply_scale(1.01).export(tmp_path / "crate.stl")
    assert "has changed since" in dataset_walls(stored, tmp_path)["missing"]


def test_real_pictures_have_no_bin(tmp_path):
    assert dataset_walls(dataset(tmp_path, BinSection(), kind="real"), tmp_path) is None


@pytest.mark.slow
def test_the_3d_view_draws_the_bin_at_its_true_position(browser, rig, tmp_path):
    """Law: in a view from above, floor and rim have colours, and the table around them has none."""
    write_dataset(tmp_path / "bins", scene_ids=(0,), rig=rig)
    path = tmp_path / "bins/graycast.json"
    claim = json.loads(path.read_bytes())
    claim["config"]["bin"] = {"inner_m": INNER_M, "wall_m": WALL_M}
    path.write_text(json.dumps(claim))
    report = (tmp_path / "bins", {}, write_report(tmp_path / "bins", tmp_path / "page").page)
    with watched_page(browser, report[2].as_uri()) as page:
        opened(page, report, 0, "cloud")
        for key in "sp":
            page.keyboard.press(key)
        page.click("text=top")
        page.mouse.move(300, 300)
        page.mouse.wheel(0, 1155)  # The view becomes wider, because the parts are not in the bin.
        place = """([x, y, z]) => {
            const { scene, cloud } = Graycast.opened(), { middle } = Graycast.shapes.space(scene);
            return cloud.onScreen([x - middle[0], y - middle[1], z - middle[2]]);
        }"""
        spots = {"floor": (0, 0, 0), "rim": (206, 0, 150), "table": (230, 0, -12)}
        page.wait_for_timeout(100)
        at = {name: np.rint(page.evaluate(place, spot)).astype(int) for name, spot in spots.items()}

        def colors():
            page.wait_for_timeout(400)
            data = np.frombuffer(page.locator("#cloud").screenshot(), np.uint8)
            picture = cv2.imdecode(data, cv2.IMREAD_COLOR).astype(int)
            return {name: picture[v, u] for name, (u, v) in at.items()}

        before = colors()
        page.keyboard.press("w")
        without = colors()
        changed = {name: np.abs(before[name] - without[name]).max() > 10 for name in spots}
        assert changed == {"floor": True, "rim": True, "table": False}
