"""The table and the pictures of the parts."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from graycast.base.frames import inverse, transform_points
from graycast.rendering import open_renderer
from graycast.rig.optics import project
from graycast.show.report.parts import describe_parts, draw_parts, portrait_scene
from graycast.world.parts import Material, Mesh, Part, Symmetry, builtin_part, mass_kg, size_notes


def block(size_m, *, name="block", density_kg_m3=2000.0, material=None, symmetry=None, at=0.0):
    """Return a cuboid whose lowest corner is at (at, at, at)."""
    corner = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)]) * np.array(size_m) + at
    faces = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
             [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]  # fmt: skip
    return Part(
        name=name,
        mesh=Mesh(vertices_m=corner, faces=np.array(faces)),
        material=material or Material(),
        density_kg_m3=density_kg_m3,
        friction=0.5,
        symmetry=symmetry or Symmetry(),
    )


def cut_corner(part):
    """Return the tetrahedron at a block's lowest corner, whose asymmetry reveals sign errors."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return replace(part, mesh=Mesh(vertices_m=part.mesh.vertices_m[[0, 1, 2, 4]], faces=faces))


# --- text ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0.0, 7.0])
def test_the_mass_of_a_part_is_volume_times_density_for_any_frame(at):
    assert mass_kg(block((0.01, 0.02, 0.03), at=at)) == pytest.approx(0.012, rel=1e-9)


def test_the_mass_of_a_ring_follows_the_theorem_of_pappus():
    """Oracle: V = 2 pi * (radius of the profile's centroid) * (its area); steel has 7800 kg/m3."""
    from graycast.world.parts.builtin import RING_PROFILE_MM

    r, z = np.array(RING_PROFILE_MM).T
    cross = r * np.roll(z, -1) - np.roll(r, -1) * z
    moment_mm3 = ((r + np.roll(r, -1)) * cross).sum() / 6  # area times radius of the centroid
    # 128 straight facets enclose the share sin(x) / x of a circle's area, with x = 2 pi / 128.
    facets = np.sinc(2 / 128)
    expected_kg = 7800 * 2 * np.pi * abs(moment_mm3) * 1e-9 * facets
    assert mass_kg(builtin_part("metal_workpiece_2")) == pytest.approx(expected_kg, rel=1e-6)


@pytest.mark.parametrize(
    ("size_m", "note"),
    [
        ((0.04, 0.04, 0.09), None),
        ((0.4, 0.3, 0.1), "the part block is 400 mm long and weighs 94 kg: check its unit"),
        ((0.01, 0.01, 0.53), "the part block is 530 mm long, and the diagonal of the bin is 520"),
    ],
)
def test_a_part_in_a_wrong_unit_causes_a_note(size_m, note):
    notes = size_notes([block(size_m, density_kg_m3=7850.0)], (0.4, 0.3, 0.1428))
    assert [one[: len(note or "")] for one in notes] == ([note] if note else [])


def test_the_table_has_sizes_masses_materials_and_symmetries():
    about_y = Symmetry(continuous=(((0.0, -1.0, 0.0), (0.0, 0.0, 0.0)),))
    turns = Symmetry(discrete=tuple(np.eye(4) for _ in range(3)))
    print_ = np.zeros((20, 30, 3), dtype=np.uint8)
    parts = (
        block((0.01, 0.02, 0.03), name="small", symmetry=about_y,
              material=Material(metallic=1.0, roughness=0.3)),
        block((0.1, 0.2, 0.3), name="a_long_name", symmetry=turns,
              material=Material(texture=print_, roughness=0.7, roughness_map=print_[:9, :, 0])),
        block((0.1, 0.1, 0.1), name="matt", material=Material(specular=0.0)),
    )  # fmt: skip
    head, *rows = describe_parts(parts).splitlines()
    cells = [re.split(r"  +", row) for row in rows]
    assert re.split(r"  +", head)[:3] == ["part", "size [mm]", "mass"]
    assert cells[0][:4] == ["small", "10.0 x 20.0 x 30.0", "12 g", "12"]
    assert cells[0][4:6] == ["metal, colour 0.5 0.5 0.5, roughness 0.3", "any turn about y"]
    assert cells[1][:4] == ["a_long_name", "100.0 x 200.0 x 300.0", "12 kg", "12"]
    assert cells[1][4:6] == [
        "dielectric, texture 30 x 20, roughness 0.7 times a map 30 x 9",
        "4 equivalent poses",
    ]
    assert cells[2][4:6] == ["Lambertian, colour 0.5 0.5 0.5", "none"]
    # The columns are aligned, so every size ends at the end of its heading.
    ends = {row.index(cell[1]) + len(cell[1]) for row, cell in zip(rows, cells, strict=True)}
    assert ends == {head.index("size [mm]") + len("size [mm]")}


# --- pictures ----------------------------------------------------------------------------------


@pytest.mark.parametrize("size_m", [(0.002, 0.001, 0.0015), (0.19, 0.04, 0.05), (0.3, 0.2, 1.2)])
def test_a_part_of_any_size_fills_its_tile(size_m):
    """All vertices are within 86 % of the tile about its centre, and one is at this limit."""
    scene, layout = portrait_scene(cut_corner(block(size_m, at=3.0)))
    world = transform_points(layout.T_world_part[0], scene.parts[0].mesh.vertices_m)
    camera = scene.rig.camera
    pixel = project(camera, transform_points(inverse(scene.T_world_cam), world))
    middle = np.array([camera.cx_px, camera.cy_px])
    reach = np.abs(pixel - middle) / (0.5 * np.array([camera.width_px, camera.height_px]))
    assert reach.max() == pytest.approx(0.86, rel=1e-6)


def test_a_part_is_on_the_floor_and_seen_from_the_front_and_above():
    scene, layout = portrait_scene(block((0.1, 0.2, 0.3), at=3.0))
    world = transform_points(layout.T_world_part[0], scene.parts[0].mesh.vertices_m)
    assert world[:, 2].min() == pytest.approx(scene.surfaces[0].center_m[2])
    eye = scene.T_world_cam[:3, 3]
    assert eye[1] < world[:, 1].min() and eye[2] > world[:, 2].max()
    assert scene.T_world_cam[2, 1] < 0  # Down in the picture is down in the world.


def test_an_empty_list_of_parts_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no parts"):
        draw_parts((), tmp_path / "parts.png", renderer=open_renderer("reference"))


@pytest.mark.slow
def test_the_picture_shows_each_part_in_its_own_colour_on_a_grey_floor(mitsuba_renderer, tmp_path):
    red, blue = Material(base_color=(0.6, 0.05, 0.05)), Material(base_color=(0.05, 0.05, 0.6))
    size_m = (0.03, 0.03, 0.02)
    parts = (block(size_m, name="red", material=red), block(size_m, name="blue", material=blue))
    draw_parts(parts, tmp_path / "parts.png", renderer=mitsuba_renderer, samples=2)
    sheet = np.array(Image.open(tmp_path / "parts.png").convert("RGB")).astype(int)
    assert [path.name for path in tmp_path.iterdir()] == ["parts.png"]
    areas, middles = [], []
    for channel in (0, 2):
        coloured = sheet[..., channel] > 1.6 * sheet[..., 1] + 10
        areas.append(coloured.sum())
        middles.append(np.nonzero(coloured)[1].mean())
    # Both are the same block, so they cover the same share of their tiles.
    assert areas[0] == pytest.approx(areas[1], rel=0.1) and areas[0] > 0.15 * 480 * 360
    assert middles[1] - middles[0] == pytest.approx(480 + 24, abs=10)
    corner = sheet[72 + 340, 24 + 20]  # the floor near the first tile's lower left corner
    assert np.ptp(corner) < 20 and 90 < corner.mean() < 240
