"""Reading of third-party models as parts: colours, units and materials."""

import cv2
import numpy as np
import pytest

from graycast.base.errors import ConfigError, DatasetError
from graycast.dataset.write.models import model_files, models_info
from graycast.real.rescan.model_files import bop_models, read_models
from graycast.world.parts import builtin_part, material_preset

from .scene_files import FACES, SIDE_MM, cube_ply, write_json, write_models

TEXTURED = """ply
format ascii 1.0
comment TextureFile face.png
element vertex 4
property float x
property float y
property float z
property float texture_u
property float texture_v
element face 2
property list uchar int vertex_indices
end_header
0 0 0 0 0
40 0 0 1 0
40 40 0 1 1
0 40 0 0 1
3 0 1 2
3 0 2 3
"""


def read(folder, materials=None, obj_ids=None):
    files = bop_models(folder.parent, folder)
    return read_models(files, set(files) if obj_ids is None else obj_ids, materials)


def refusal(folder, *words, error=DatasetError, **options):
    with pytest.raises(error) as caught:
        read(folder, **options)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def texels_at(material, corner_uv):
    """Return the nearest texture pixels, and their offsets in x; v increases upwards."""
    h, w = material.texture.shape[:2]
    column = np.floor(corner_uv[..., 0] * w).astype(int)
    row = np.floor((1 - corner_uv[..., 1]) * h).astype(int)
    return material.texture[row, column], column + 0.5 - corner_uv[..., 0] * w


def test_colours_of_vertices_become_one_colour_per_face(tmp_path):
    """Oracle: the mean colour of the three vertices of each face, matched by position."""
    colors = np.random.default_rng(0).integers(0, 256, (8, 3))
    write_models(tmp_path, colors=colors)
    models = read(tmp_path)
    assert models.plain == frozenset()
    mesh, material = models.parts[1].mesh, models.parts[1].material
    pixels, off_centre = texels_at(material, mesh.corner_uv)
    assert material.texture.shape == (4, 4, 3)  # 12 faces
    assert np.abs(off_centre).max() < 1e-9
    place = np.rint(mesh.vertices_m / (SIDE_MM / 1e3) + 0.5).astype(int) @ [1, 2, 4]
    mean = colors[place[mesh.faces]].mean(axis=1)
    assert np.abs(pixels - mean[:, None]).max() <= 1
    assert (pixels == pixels[:, :1]).all()


def test_a_texture_is_kept_with_its_coordinates(tmp_path):
    (tmp_path / "obj_000003.ply").write_text(TEXTURED)
    texture = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    refusal(tmp_path, "obj_000003.ply", "TextureFile")
    assert cv2.imwrite(str(tmp_path / "face.png"), texture[..., ::-1])
    part = read(tmp_path).parts[3]
    assert np.array_equal(part.material.texture, texture)
    u, v = part.mesh.corner_uv[..., 0], part.mesh.corner_uv[..., 1]
    x, y = (part.mesh.vertices_m[part.mesh.faces] / 0.04)[..., :2].transpose(2, 0, 1)
    assert np.allclose(u, x) and np.allclose(v, y)


@pytest.mark.parametrize("name", ["toothpaste", "metal_workpiece_1", "metal_workpiece_2"])
def test_models_written_by_graycast_are_read_back(tmp_path, name):
    """Oracle: shape, texture and symmetries of the part that was written."""
    part = builtin_part(name)
    for file, content in model_files((part,)).items():
        (tmp_path / file).write_bytes(content)
    write_json(tmp_path / "models_info.json", models_info((part,)))
    back = read(tmp_path).parts[1]
    assert np.allclose(back.mesh.bounds_m, part.mesh.bounds_m, atol=1e-6)
    if part.material.texture is not None:
        assert np.array_equal(back.material.texture, part.material.texture)
    for T, T_back in zip(part.symmetry.discrete, back.symmetry.discrete, strict=True):
        assert np.allclose(T, T_back, atol=1e-9)
    for line, line_back in zip(part.symmetry.continuous, back.symmetry.continuous, strict=True):
        assert np.allclose(line, line_back, atol=1e-9)


def test_an_open_mesh_has_normals_and_no_material(tmp_path):
    write_models(tmp_path, faces=FACES[:-2])
    models = read(tmp_path)
    mesh = models.parts[1].mesh
    assert models.plain == {1} and len(mesh.faces) == 10
    assert np.allclose(mesh.corner_normals, mesh.face_normal[:, None], atol=1e-9)


@pytest.mark.parametrize(
    ("side", "diameter", "words"),
    [
        (0.06, None, ("0.06 mm", "2 to 1500 mm")),
        (6e4, None, ("6e+04 mm", "--unit", "export it in mm")),
        (60.0, 30.0, ("models_info.json says", "17.1 to 30 mm")),
    ],
)
def test_a_model_in_another_unit_is_refused(tmp_path, side, diameter, words):
    write_models(tmp_path, side=side)
    if diameter is not None:
        write_json(tmp_path / "models_info.json", {"1": {"diameter": diameter}})
    refusal(tmp_path, "obj_000001.ply", *words)


@pytest.mark.parametrize(
    ("unit", "mm"), [("m", 1000.0), ("cm", 10.0), ("inch", 25.4)], ids=["m", "cm", "inch"]
)
def test_a_model_in_another_unit_is_converted_if_its_diameter_shows_the_unit(tmp_path, unit, mm):
    """Oracle: the same cube in millimetres."""
    write_models(tmp_path / "right")
    write_json(tmp_path / "right/models_info.json", {"1": {"diameter": 103.9}})
    right = read(tmp_path / "right")
    write_models(tmp_path / "other", side=SIDE_MM / mm)
    write_json(tmp_path / "other/models_info.json", {"1": {"diameter": 103.9}})
    other = read(tmp_path / "other")
    assert right.notes == ()
    np.testing.assert_allclose(
        other.parts[1].mesh.vertices_m, right.parts[1].mesh.vertices_m, rtol=1e-5
    )
    (note,) = other.notes
    assert note.startswith(f"obj_000001.ply: the model is in {unit}, as its size")


def test_a_dataset_in_metres_is_converted_with_its_symmetries(tmp_path):
    """Symptom: a cube of 0.06 was read as 0.06 mm, because the diameter agreed."""
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    half_turn[0, 3] = 0.02
    axis = {"axis": [0, 0, 1], "offset": [0.01, 0, 0]}
    write_models(tmp_path, side=0.06)
    info = {"diameter": 0.1039, "symmetries_discrete": [half_turn.ravel().tolist()]}
    write_json(tmp_path / "models_info.json", {"1": info | {"symmetries_continuous": [axis]}})
    models = read(tmp_path)
    part = models.parts[1]
    np.testing.assert_allclose(part.mesh.extent_m, 0.06, rtol=1e-5)
    np.testing.assert_allclose(part.symmetry.discrete[0], half_turn)
    np.testing.assert_allclose(part.symmetry.continuous[0][1], [0.01, 0, 0])
    assert "in m, and its models_info.json in m" in models.notes[0]


def test_a_stated_unit_takes_precedence_over_the_unit_shown_by_the_diameter(tmp_path):
    write_models(tmp_path, side=0.06)
    refusal(tmp_path, "0.06 mm", "seems to be in m", "--unit")
    models = read_models(bop_models(tmp_path.parent, tmp_path, "m"), {1}, None)
    np.testing.assert_allclose(models.parts[1].mesh.extent_m, 0.06, rtol=1e-5)
    assert models.notes == ()
    write_json(tmp_path / "models_info.json", {"1": {"diameter": 103.9}})
    with pytest.raises(DatasetError, match=r"longest side is 0\.06 cm, models_info\.json says"):
        read_models(bop_models(tmp_path.parent, tmp_path, "cm"), {1}, None)


def test_the_diameters_of_a_box_and_of_a_rod_fit_their_longest_sides(tmp_path):
    write_models(tmp_path)
    for diameter in (SIDE_MM, SIDE_MM * np.sqrt(3)):
        write_json(tmp_path / "models_info.json", {"1": {"diameter": diameter, "more": 1}})
        assert list(read(tmp_path).parts) == [1]
    write_json(tmp_path / "models_info.json", {"1": {"diameter": 2 * SIDE_MM}})
    refusal(tmp_path, "models_info.json says")


def test_materials_are_assigned_by_id_by_name_and_by_default(tmp_path):
    write_models(tmp_path, colors=np.full((8, 3), 200))
    for obj_id in (2, 3):
        (tmp_path / f"obj_{obj_id:06d}.ply").write_text(cube_ply())
    infos = {str(i): {"diameter": 103.9, "name": n} for i, n in ((1, "nut"), (2, "lid"))}
    write_json(tmp_path / "models_info.json", infos)
    looks = tmp_path / "looks.yaml"
    looks.write_text("lid: steel-brushed\n3:\n  preset: plastic\n  roughness: 0.9\n")
    models = read(tmp_path, looks)
    assert [part.name for part in models.parts.values()] == ["nut", "lid", "obj_000003"]
    assert models.parts[1].material.texture is not None
    assert models.parts[2].material == material_preset("steel-brushed").material
    assert models.parts[3].material.roughness == 0.9
    assert models.plain == frozenset()
    looks.write_text("default: rubber\nobj_000003: brass\n")
    models = read(tmp_path, looks)
    assert models.parts[1].material == material_preset("rubber").material
    assert models.parts[3].material == material_preset("brass").material
    assert list(read(tmp_path, looks, obj_ids={2}).parts) == [2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("screw: brass", ("screw", "choose default, background, 1")),
        ("7: brass", ("name 7", "choose default")),
        ("1: steel-brushd", ("looks.yaml: 1", "steel-brushed")),
        ("1:\n  rougness: 0.3", ("looks.yaml: 1", "roughness")),
        ("1:\n  texture: no.png", ("looks.yaml: 1", "no.png")),
        ("1: brass\nobj_000001: brass", ("object 1", "two materials")),
        ("[brass]", ("looks.yaml", "no keys")),
    ],
)
def test_an_invalid_key_in_a_materials_file_is_refused_by_name(tmp_path, text, words):
    write_models(tmp_path)
    (tmp_path / "looks.yaml").write_text(text)
    refusal(tmp_path, *words, error=ConfigError, materials=tmp_path / "looks.yaml")


def test_a_texture_needs_texture_coordinates(tmp_path):
    write_models(tmp_path)
    assert cv2.imwrite(str(tmp_path / "a.png"), np.zeros((2, 2, 3), np.uint8))
    (tmp_path / "looks.yaml").write_text("1:\n  texture: a.png")
    refusal(tmp_path, "obj_000001.ply", "texture coordinates", materials=tmp_path / "looks.yaml")


@pytest.mark.parametrize("content", ["", "ply\nformat ascii 1.0\n", "nothing", cube_ply()[:-30]])
def test_a_damaged_model_is_named(tmp_path, content):
    (tmp_path / "obj_000001.ply").write_text(content)
    refusal(tmp_path, "obj_000001.ply")


def test_missing_or_damaged_models_are_named(tmp_path):
    refusal(tmp_path, "--models DIR", "--depth-only")
    write_models(tmp_path)
    refusal(tmp_path, "obj_000009.ply", "object 9", obj_ids={1, 9})
    (tmp_path / "models_info.json").write_text('{"1": {"diameter": 10')
    refusal(tmp_path, "models_info.json", "JSON")
