import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import TestCase

import numpy as np
import pytest
import trimesh
from PIL import Image
from step_file import step_box

from benchmarks.zoo_parts import wavy_ring
from graycast.base.errors import MeshError
from graycast.world.parts import Material, Symmetry, load_part, mass_kg, surface

MESHES = Path(__file__).resolve().parents[3] / "../shared/data/meshes"
needs_meshes = pytest.mark.skipif(not MESHES.is_dir(), reason="../shared/data/meshes is absent")


def load(path, **keywords):
    options = {"density_kg_m3": 1000.0, "friction": 0.5, "symmetry": Symmetry()} | keywords
    return load_part(path, **options)


def volume(part):
    return trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces, process=False).volume


def box(size=(0.06, 0.04, 0.03)):
    return trimesh.creation.box(size)


def write_obj(path, vertices, faces):
    lines = ["v {} {} {}".format(*v) for v in vertices]
    lines += ["f {} {} {}".format(*(np.array(f) + 1)) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def textured_box(size=(0.06, 0.04, 0.03)):
    """Return a box whose faces have their own corners, so that all edges are uv seams."""
    mesh = box(size)
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    rng = np.random.default_rng(5)
    uv = rng.uniform(0.05, 0.95, (36, 2))
    picture = rng.integers(0, 256, (8, 16, 3), dtype=np.uint8)
    visual = trimesh.visual.TextureVisuals(uv=uv, image=Image.fromarray(picture))
    faces = np.arange(36).reshape(12, 3)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False), uv, picture


# --- What is taken ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "kind"),
    [("obj", None), ("ply", None), ("stl", None), ("STL", "stl_ascii"), ("glb", None)],
)
def test_a_box_is_read_from_every_format(tmp_path, ending, kind):
    path = tmp_path / f"block.{ending}"
    box().export(path, file_type=kind)
    part, findings = load(path)
    assert part.name == "block" and part.source == f"block.{ending}"
    assert part.mesh.extent_m == pytest.approx([0.06, 0.04, 0.03], rel=1e-6)
    assert volume(part) == pytest.approx(0.06 * 0.04 * 0.03, rel=1e-6)
    assert len(part.mesh.vertices_m) == 8 and len(part.mesh.faces) == 12
    flat = trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces, process=False).face_normals
    assert np.abs(part.mesh.corner_normals - flat[:, None]).max() < 1e-9
    if ending == "glb":
        assert findings == ()  # the format states metres
    else:
        assert findings == ("No unit was stated: read as metres, longest side 60 mm.",)


@pytest.mark.parametrize(
    ("unit", "size", "metres"),
    [("m", 0.06, 1.0), ("cm", 6, 0.01), ("mm", 60, 0.001), ("inch", 2.5, 0.0254)],
)
def test_a_stated_unit_scales_the_mesh(tmp_path, unit, size, metres):
    box((size, size / 2, size / 3)).export(tmp_path / "block.ply")
    part, findings = load(tmp_path / "block.ply", unit=unit, name="mine")
    assert part.name == "mine" and findings == ()
    assert part.mesh.extent_m.max() == pytest.approx(size * metres, rel=1e-6)


def test_a_part_keeps_the_frame_of_its_mesh_file(tmp_path):
    mesh = box()
    mesh.apply_translation([0.01, 0.02, 0.03])
    mesh.export(tmp_path / "block.glb")
    part, findings = load(tmp_path / "block.glb")
    assert part.mesh.bounds_m.mean(axis=0) == pytest.approx([0.01, 0.02, 0.03], rel=1e-6)
    assert findings == ()
    mesh.apply_translation([0.5, 0, 0])
    mesh.export(tmp_path / "far.glb")
    assert load(tmp_path / "far.glb")[1] == (
        "The file's origin lies 511.3 mm from the part's middle.",
    )


@pytest.mark.parametrize("ending", ["obj", "glb"])
def test_welding_seams_keeps_texture_and_uv_coordinates(tmp_path, ending):
    """Each corner, located by its position in its face, keeps its uv; the texels are equal."""
    mesh, uv, picture = textured_box()
    mesh.export(tmp_path / f"block.{ending}")
    part, findings = load(tmp_path / f"block.{ending}")
    assert len(part.mesh.vertices_m) == 8
    assert volume(part) == pytest.approx(0.06 * 0.04 * 0.03, rel=1e-6)
    assert np.array_equal(part.material.texture, picture)
    assert "The texture (16 x 8 px) was taken from the file." in findings
    assert "28 duplicate vertices were merged." in findings
    loaded = np.concatenate([part.mesh.vertices_m[part.mesh.faces], part.mesh.corner_uv], axis=-1)
    wrote = np.concatenate([mesh.vertices, uv], axis=1).reshape(12, 3, 5)
    for face in loaded:
        turns = np.stack([np.roll(wrote, k, axis=1) for k in range(3)])
        assert np.abs(turns - face).max(axis=(2, 3)).min() < 1e-6


def test_a_texture_from_a_mesh_file_is_upright(tmp_path):
    """Oracle: in the glTF file itself v = 0 is the picture's top; in a `Mesh` v = 1 is."""
    mesh, uv, _ = textured_box()
    mesh.export(tmp_path / "block.glb")
    raw = (tmp_path / "block.glb").read_bytes()
    assert np.float32(1 - uv[0, 1]).tobytes() in raw
    part, _ = load(tmp_path / "block.glb")
    assert np.abs(part.mesh.corner_uv[..., 1] - uv[0, 1]).min() < 1e-6


def test_a_given_material_replaces_the_material_of_a_mesh_file(tmp_path):
    mesh, _, picture = textured_box()
    mesh.export(tmp_path / "block.glb")
    steel = Material(metallic=1.0, base_color=(0.2, 0.2, 0.2))
    part, findings = load(tmp_path / "block.glb", material=steel)
    assert part.material is steel and not any("texture" in f for f in findings)
    own = Material(texture=picture[::-1].copy())
    part, _ = load(tmp_path / "block.glb", material=own)
    assert part.material is own and part.mesh.corner_uv is not None


def test_transforms_in_the_scene_of_a_glb_are_applied(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(box(), transform=trimesh.transformations.scale_matrix(0.5))
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[:3, 3] = [0.1, 0, 0]
    scene.add_geometry(box(), transform=mirrored)
    scene.export(tmp_path / "two.glb")
    part, findings = load(tmp_path / "two.glb")
    assert volume(part) == pytest.approx(0.06 * 0.04 * 0.03 * (1 + 1 / 8), rel=1e-6)
    assert findings == ("2 separate bodies are taken as one rigid part.",)


def test_corrections_to_a_mesh_are_reported(tmp_path):
    mesh = box()
    faces = [*mesh.faces, np.roll(mesh.faces[3], 1), [0, 1, 1]]
    part, findings = load(write_obj(tmp_path / "block.obj", mesh.vertices, faces), unit="m")
    assert findings == ("1 degenerate faces were dropped.", "1 repeated faces were dropped.")
    assert len(part.mesh.faces) == 12
    loose = mesh.vertices[mesh.faces].reshape(-1, 3)
    loose[::2] += 1e-9
    path = write_obj(tmp_path / "loose.obj", loose, np.arange(36).reshape(12, 3))
    part, findings = load(path, unit="m")
    assert len(part.mesh.vertices_m) == 8 and "nearly equal vertices were merged" in findings[0]
    hollow = trimesh.util.concatenate([box(), flipped(box((0.02, 0.02, 0.02)))])
    hollow.export(tmp_path / "hollow.ply")
    part, findings = load(tmp_path / "hollow.ply", unit="m")
    assert findings == ("1 of 2 shells face inwards, taken as cavities.",)
    assert volume(part) == pytest.approx(0.06 * 0.04 * 0.03 - 0.02**3, rel=1e-5)


def test_unused_colours_of_a_mesh_are_reported(tmp_path):
    mesh = box()
    mesh.visual.vertex_colors = [200, 10, 10, 255]
    mesh.export(tmp_path / "red.ply")
    part, findings = load(tmp_path / "red.ply", unit="m")
    assert findings == ("Colours in the file are not used; give the part a material.",)
    assert part.material == Material()


def test_reading_a_mesh_prints_and_logs_nothing(tmp_path, capfd):
    textured_box()[0].export(tmp_path / "block.obj")
    (tmp_path / "material.mtl").unlink()
    with TestCase().assertNoLogs(level="DEBUG"):
        part, findings = load(tmp_path / "block.obj", unit="m")
    assert any("no picture was read with it" in finding for finding in findings)
    assert part.material.texture is None
    assert capfd.readouterr() == ("", "")
    assert not trimesh.util.log.disabled


# --- What is refused -------------------------------------------------------------------------


def flipped(mesh):
    mesh = mesh.copy()
    mesh.faces = mesh.faces[:, ::-1]
    return mesh


def cut(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


def exported(mesh, path, kind=None):
    mesh.export(path, file_type=kind)
    return path


def missing(folder):
    return folder / "nothing.stl"


def unsupported(folder):
    (folder / "part.dwg").write_text("AC1032")
    return folder / "part.dwg"


def empty_file(folder):
    (folder / "part.stl").touch()
    return folder / "part.stl"


def not_a_mesh(folder):
    (folder / "part.obj").write_text("hello\n")
    return folder / "part.obj"


def only_points(folder):
    return exported(trimesh.PointCloud(box().vertices), folder / "part.ply")


def cut_binary_stl(folder):
    return cut(exported(box(), folder / "part.stl"), 0.5)


def cut_ascii_stl(folder):
    return cut(exported(box(), folder / "part.stl", "stl_ascii"), 0.5)


def cut_ply(folder):
    return cut(exported(box(), folder / "part.ply"), 0.8)


def cut_glb(folder):
    return cut(exported(box(), folder / "part.glb"), 0.9)


def wrong_index(folder):
    return write_obj(folder / "part.obj", box().vertices, [*box().faces, [0, 1, 99]])


def nan_vertex(folder):
    vertices = box().vertices.copy()
    vertices[3, 1] = np.nan
    return write_obj(folder / "part.obj", vertices, box().faces)


def infinite_vertex(folder):
    vertices = box().vertices.copy()
    vertices[3, 1] = np.inf
    return write_obj(folder / "part.obj", vertices, box().faces)


def one_point(folder):
    return write_obj(folder / "part.obj", np.zeros((8, 3)), box().faces)


def open_box(folder):
    return exported(trimesh.Trimesh(box().vertices, box().faces[1:]), folder / "part.stl")


def one_face_turned(folder):
    faces = box().faces.copy()
    faces[4] = faces[4][::-1]
    return exported(trimesh.Trimesh(box().vertices, faces, process=False), folder / "part.ply")


def inside_out(folder):
    return exported(flipped(box()), folder / "part.stl")


def flat_sheet(folder):
    corners = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]  # a flat tetrahedron
    return write_obj(folder / "part.obj", corners, faces)


REFUSALS = [
    (missing, {}, ["no such file", "check the path"]),
    (unsupported, {}, [".dwg", "export .obj, .ply, .stl, .glb"]),
    (empty_file, {}, ["file is empty", "export"]),
    (not_a_mesh, {}, ["no triangles", "so export it again as a mesh"]),
    (only_points, {}, ["no triangles", "points"]),
    (cut_binary_stl, {}, ["may be incomplete", "export it again"]),
    (cut_ascii_stl, {}, ["no triangles", "may be incomplete"]),
    (cut_ply, {}, ["unreadable as PLY", "may be incomplete"]),
    (cut_glb, {}, ["unreadable as GLB", "may be incomplete"]),
    (wrong_index, {}, ["unreadable as OBJ", "index 99"]),
    (nan_vertex, {}, ["1 vertices are NaN or infinite", "export"]),
    (infinite_vertex, {}, ["1 vertices are NaN or infinite", "export"]),
    (one_point, {}, ["all vertices have the same position; export the mesh again"]),
    (open_box, {}, ["open: 3 boundary edges", "close its holes"]),
    (one_face_turned, {}, ["wound both ways round at 3 edges", "recalculate the normals"]),
    (inside_out, {}, ["inside out", "negative volume", "flip its normals"]),
    (flat_sheet, {}, ["no volume", "thickness"]),
]


@pytest.mark.parametrize(("make", "keywords", "words"), REFUSALS)
def test_a_bad_mesh_is_refused_in_one_line_with_the_remedy(tmp_path, make, keywords, words):
    path = make(tmp_path)
    with pytest.raises(MeshError) as refusal:
        load(path, **keywords)
    text = str(refusal.value)
    assert text.startswith(f"{path}: ") and "\n" not in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("size", "ending", "unit", "words"),
    [
        (60, "stl", None, ["60 m if in m, 600 mm if in cm, 60 mm if in mm, 1.524 m if in inch",
                           "state unit: cm or mm"]),
        (300, "ply", None, ["state unit: mm"]),
        (2.953, "stl", None, ["state unit: cm or inch"]),
        (0.06, "stl", "mm", ["unit mm", "0.06 mm", "state unit: m"]),
        (60, "obj", "m", ["unit m", "60 m", "state unit: cm or mm"]),
        (60, "glb", None, ["by its format", "unit m", "60 m", "state unit: cm or mm"]),
        (1e6, "stl", None, ["scale the mesh"]),
        (1e-5, "stl", "m", ["0.01 mm", "scale the mesh"]),
    ],
)  # fmt: skip
def test_the_error_for_an_impossible_size_names_the_unit_that_fits(
    tmp_path, size, ending, unit, words
):
    path = exported(box((size, size / 2, size / 2)), tmp_path / f"part.{ending}")
    with pytest.raises(MeshError) as refusal:
        load(path, unit=unit)
    for word in [str(path), *words]:
        assert word in str(refusal.value)


def test_a_mesh_with_too_many_faces_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(surface, "MAX_FACES", 11)
    with pytest.raises(MeshError, match=r"12 faces are more than 11; decimate"):
        load(exported(box(), tmp_path / "part.stl"))


def sparse(path, size):
    with path.open("wb") as file:
        file.truncate(size)
    return path


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb"])
def test_a_huge_mesh_file_is_refused_before_it_is_read(tmp_path, ending):
    """The file is sparse and has 10 GB, which would fill the memory."""
    with pytest.raises(MeshError, match=r"has 10000 MB, more than the 400 MB.*decimate"):
        load(sparse(tmp_path / f"part.{ending}", 10_000_000_000))


def test_the_header_of_a_binary_stl_suffices_to_refuse_too_many_faces(tmp_path, monkeypatch):
    import trimesh

    path = sparse(tmp_path / "part.stl", 84 + 50 * 500_001)
    with path.open("r+b") as file:
        file.seek(80)
        file.write((500_001).to_bytes(4, "little"))
    monkeypatch.setattr(trimesh, "load_scene", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(MeshError, match=r"500001 faces are more than 500000; decimate"):
        load(path)


def test_a_path_to_something_other_than_a_regular_file_is_refused_at_once(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    for name, kind in (("folder", "a folder"), ("pipe", "a pipe"), ("zero", "a device")):
        with pytest.raises(MeshError, match=rf"{kind}.*give the path of a mesh file"):
            load(tmp_path / f"{name}.stl")


def cubes(folder, corners, name="part.stl"):
    shapes = [trimesh.creation.box((0.02,) * 3) for _ in corners]
    for shape, corner in zip(shapes, corners, strict=True):
        shape.apply_translation(corner)
    return exported(trimesh.util.concatenate(shapes), folder / name)


def test_overlapping_bodies_are_joined_and_their_common_volume_counts_once(tmp_path):
    """Two cubes of 8 cm^3 that share an eighth of one."""
    part, findings = load(cubes(tmp_path, [(0, 0, 0), (0.01, 0.01, 0.01)]), unit="m")
    assert volume(part) == pytest.approx(15e-6, rel=1e-6)
    assert findings == (
        "2 separate bodies are taken as one rigid part.",
        "2 bodies overlap, 6.25% of their volume would count twice: they were joined into one.",
    )
    part, findings = load(cubes(tmp_path, [(0, 0, 0), (0.001, 0, 0), (0.05, 0, 0)]), unit="m")
    assert volume(part) == pytest.approx((8 + 0.4 + 8) * 1e-6, rel=1e-6)


@pytest.mark.parametrize("beside", [(0.02, 0, 0), (0.02, 0.02, 0), (0.02,) * 3, (0.03, 0, 0)])
def test_touching_and_separate_bodies_are_unchanged(tmp_path, beside):
    """They touch in a face, an edge, a corner, or not at all; file vertices are kept."""
    part, findings = load(cubes(tmp_path, [(0, 0, 0), beside]), unit="m")
    assert volume(part) == pytest.approx(16e-6, rel=1e-6) and len(part.mesh.faces) == 24
    assert findings[-1] == "2 separate bodies are taken as one rigid part."


def test_only_an_inner_body_within_a_cavity_adds_to_the_volume(tmp_path):
    outer, hole, inner = (trimesh.creation.box((s,) * 3) for s in (0.04, 0.03, 0.02))
    hole.invert()
    nested = trimesh.util.concatenate([outer, inner])
    part, _ = load(exported(nested, tmp_path / "nested.stl"), unit="m")
    assert volume(part) == pytest.approx(64e-6, rel=1e-6)
    rattle = trimesh.util.concatenate([outer, hole, inner])
    part, findings = load(exported(rattle, tmp_path / "rattle.stl"), unit="m")
    assert volume(part) == pytest.approx((64 - 27 + 8) * 1e-6, rel=1e-6)
    assert findings[-1] == "1 of 3 shells face inwards, taken as cavities."


def test_an_inverted_body_beside_another_body_is_not_taken_for_a_cavity(tmp_path):
    large, small = trimesh.creation.box((0.04,) * 3), trimesh.creation.box((0.02,) * 3)
    small.apply_translation((0.05, 0, 0))
    small.invert()
    path = exported(trimesh.util.concatenate([large, small]), tmp_path / "part.stl")
    with pytest.raises(
        MeshError, match=r"inside out.*is not inside another shell; flip its normals"
    ):
        load(path, unit="m")


def test_overlapping_bodies_with_a_texture_are_refused(tmp_path):
    one = textured_box()[0]
    other = one.copy()
    other.apply_translation((0.02, 0.01, 0.01))
    trimesh.Scene([one, other]).export(tmp_path / "two.glb")
    with pytest.raises(MeshError, match=r"2 bodies overlap.*boolean union"):
        load(tmp_path / "two.glb")


@pytest.mark.slow
def test_three_thousand_cubes_are_read_as_one_part(tmp_path):
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in (15, 15, 14)]), axis=-1).reshape(-1, 3)
    part, findings = load(cubes(tmp_path, (0.025 * grid)[:3000]), unit="m")
    assert volume(part) == pytest.approx(3000 * 8e-6, rel=1e-6)
    assert findings == ("3000 separate bodies are taken as one rigid part.",)


@pytest.mark.parametrize(
    ("look", "instead"),
    [
        (Material(texture=np.zeros((4, 4, 3), dtype=np.uint8)), "a base colour"),
        (Material(roughness_map=np.zeros((4, 4), dtype=np.uint8)), "a roughness"),
    ],
)
def test_a_texture_for_a_mesh_without_texture_coordinates_is_refused(tmp_path, look, instead):
    path = exported(box(), tmp_path / "part.stl")
    with pytest.raises(MeshError, match=f"no texture coordinates; unwrap it .* give {instead}"):
        load(path, material=look)


def test_two_textures_are_refused_unless_a_material_is_given(tmp_path):
    one, two = textured_box()[0], textured_box()[0]
    two.visual.material.image = Image.fromarray(np.full((4, 4, 3), 9, dtype=np.uint8))
    two.apply_translation([0.1, 0, 0])
    trimesh.Scene([one, two]).export(tmp_path / "two.glb")
    with pytest.raises(MeshError, match="one texture does not cover"):
        load(tmp_path / "two.glb")
    part, _ = load(tmp_path / "two.glb", material=Material())
    assert len(part.mesh.faces) == 24


def test_an_unknown_unit_of_a_mesh_raises_value_error(tmp_path):
    with pytest.raises(ValueError, match="'inches'; choose one of m, cm, mm, inch"):
        load(exported(box(), tmp_path / "part.stl"), unit="inches")


READ = """
import signal, sys
from pathlib import Path
from graycast.world.parts import load_mesh
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
print("start", flush=True)
load_mesh(Path({path!r}), unit="m")
"""


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.1, 0.3, 1.0, 2.0])
def test_a_batch_system_s_stop_signal_interrupts_the_reading_of_a_large_mesh(tmp_path, delay_s):
    """The signal also works during the import of the reader, which suppresses exceptions."""
    mesh = wavy_ring(490_000)
    shape = trimesh.Trimesh(mesh.vertices_m, mesh.faces, process=False)
    program = READ.format(path=str(exported(shape, tmp_path / "part.stl")))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with process:
        process.stdout.readline()
        time.sleep(delay_s)
        stopped = time.perf_counter()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) == 7
        assert time.perf_counter() - stopped < 2


# --- Real files ------------------------------------------------------------------------------


@needs_meshes
@pytest.mark.parametrize(
    ("file", "unit", "longest_m"),
    [
        ("kit/yellowsaltcube.stl", None, 0.1462),
        ("cad/idler_riser.STL", "inch", 0.0750),
        ("cad/plate_holes.STL", "mm", 0.3048),
        ("cad/octagonal_pocket.stl", "m", 0.2286),
        ("nist/pump/pump_base.stl", None, 0.1100),
        ("nist/battery/battery_pins.stl", None, 0.0240),
    ],
)
def test_real_meshes_have_the_volume_that_trimesh_computes(file, unit, longest_m):
    part, _ = load(MESHES / file, unit=unit)
    scale = {None: 1.0, "m": 1.0, "mm": 1e-3, "inch": 0.0254}[unit]
    assert part.mesh.extent_m.max() == pytest.approx(longest_m, abs=5e-5)
    assert volume(part) == pytest.approx(
        trimesh.load_mesh(MESHES / file).volume * scale**3, rel=1e-4
    )


@needs_meshes
def test_a_mesh_in_inches_is_not_taken_for_metres():
    with pytest.raises(MeshError, match=r"idler_riser.STL: no unit .* 75.01 mm if in inch"):
        load(MESHES / "cad/idler_riser.STL")


# --- STEP ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("prefix", "metres"), [(".MILLI.", 1e-3), (".CENTI.", 1e-2)])
def test_a_step_file_is_read_in_its_own_unit(tmp_path, prefix, metres):
    """The box of 6 x 4 x 3 lengths is written as by a CAD program: planes, edges and a unit."""
    pytest.importorskip("cascadio", reason="needs cascadio: make extras")
    (tmp_path / "box.step").write_text(step_box(6, 4, 3, prefix))
    part, findings = load(tmp_path / "box.step")
    np.testing.assert_allclose(part.mesh.extent_m, np.array([6, 4, 3]) * metres, rtol=1e-5)
    assert mass_kg(part) == pytest.approx(part.density_kg_m3 * 72 * metres**3, rel=1e-5)
    assert not any("unit" in finding for finding in findings)
    with pytest.raises(MeshError, match="states its own unit; remove unit"):
        load(tmp_path / "box.step", unit="mm")


def test_the_error_for_a_step_file_without_its_reader_names_the_extra(tmp_path, monkeypatch):
    (tmp_path / "box.stp").write_text(step_box(6, 4, 3, ".MILLI."))
    monkeypatch.setitem(sys.modules, "cascadio", None)
    with pytest.raises(MeshError, match=r"pip install 'graycast\[cad\]', or export \.obj"):
        load(tmp_path / "box.stp")
