"""STL as programs write it, files that are no mesh, and the files that a mesh uses."""

import io

import numpy as np
import pytest
import trimesh
from PIL import Image

from graycast.base.errors import MeshError
from graycast.cell.resolve import load_cell
from graycast.cli.command import main
from graycast.world.parts import files_of_mesh, load_part, mass_kg

WORDS = {"unit": "m", "density_kg_m3": 1000.0, "friction": 0.5}
VOLUME_M3 = 0.06 * 0.04 * 0.03
BOX_OBJ = """mtllib {library}
usemtl a
{vertices}
vt 0 0
vt 1 0
vt 1 1
{faces}
"""


def box():
    return trimesh.creation.box((0.06, 0.04, 0.03))


def text_stl(path, *, first=b"solid part", last=b"endsolid part", ends=b"\n"):
    """Write a box as a text STL with the given first and last line."""
    lines = [first]
    for corners in box().triangles:
        lines += [b"facet normal 0 0 0", b" outer loop"]
        lines += [b"  vertex %.6f %.6f %.6f" % tuple(corner) for corner in corners]
        lines += [b" endloop", b"endfacet"]
    path.write_bytes(ends.join([*lines, last, b""]))
    return path


@pytest.mark.parametrize(
    ("first", "last", "ends"),
    [
        ("solid 零件1".encode("gbk"), "endsolid 零件1".encode("gbk"), b"\n"),
        ("solid Gehäuse".encode("latin-1"), b"endsolid", b"\r\n"),
        (b"\xef\xbb\xbfsolid part", b"endsolid part", b"\n"),
        (b"solid part", b"end solid part", b"\n"),
        (b"SOLID vertex 1 2 normal", b"End Solid", b"\r"),
    ],
)
def test_a_text_stl_is_read_completely_whatever_the_name_of_its_solid(tmp_path, first, last, ends):
    """Symptom: a complete file was called incomplete, or without triangles."""
    path = text_stl(tmp_path / "part.stl", first=first, last=last, ends=ends)
    part, notes = load_part(path, **WORDS)
    assert mass_kg(part) == pytest.approx(1000 * VOLUME_M3, rel=1e-4)
    assert notes == ()


@pytest.mark.parametrize("head", [b"", b"solid made by a CAD program", "零件".encode("gbk")])
def test_bytes_after_the_end_of_a_binary_stl_are_noted_and_not_read(tmp_path, head):
    data = bytearray(box().export(file_type="stl"))
    data[: len(head)] = head
    path = tmp_path / "part.stl"
    path.write_bytes(bytes(data) + 37 * b"x")
    part, notes = load_part(path, **WORDS)
    assert mass_kg(part) == pytest.approx(1000 * VOLUME_M3, rel=1e-4)
    assert notes == ("37 bytes after the last triangle were not read.",)


def test_a_truncated_binary_stl_is_refused_with_its_complete_size(tmp_path):
    (tmp_path / "part.stl").write_bytes(box().export(file_type="stl")[:400])
    with pytest.raises(MeshError, match="counts 12 triangles, which need 684 bytes, and it has 40"):
        load_part(tmp_path / "part.stl", **WORDS)


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "Git LFS.* pull"),
        (b"\n<!DOCTYPE html>\n<html><body>404</body></html>", "web page .HTML. .* download"),
        (b"ISO-10303-21;\nHEADER;\n" + 100 * b"#1=X();\n", "is a STEP file; .* ending .step"),
        (b"PK\x03\x04" + bytes(200), "ZIP archive or a 3MF file; unpack it"),
    ],
)
def test_the_error_for_a_file_with_a_false_mesh_ending_names_its_content(
    tmp_path, ending, content, words
):
    path = tmp_path / f"part.{ending}"
    path.write_bytes(content)
    with pytest.raises(MeshError, match=words):
        load_part(path, **WORDS)


def test_the_error_for_a_mesh_with_a_wrong_ending_names_the_right_ending(tmp_path):
    for kind, ending in (("ply", "stl"), ("glb", "ply"), ("stl_ascii", "obj")):
        box().export(tmp_path / f"part.{ending}", file_type=kind)
        right = kind.removesuffix("_ascii")
        with pytest.raises(MeshError, match=f"give it the ending .{right}"):
            load_part(tmp_path / f"part.{ending}", **WORDS)


def test_a_binary_stl_whose_header_looks_like_another_format_is_read(tmp_path):
    data = bytearray(box().export(file_type="stl"))
    data[:12] = b"ISO-10303-21"
    (tmp_path / "part.stl").write_bytes(data)
    assert mass_kg(load_part(tmp_path / "part.stl", **WORDS)[0]) > 0


def textured_obj(folder, *, library="part.mtl", picture="red.png", named="red.png"):
    """Write a box with texture coordinates, its material and a red picture."""
    mesh = box()
    vertices = "\n".join("v {:.6f} {:.6f} {:.6f}".format(*v) for v in mesh.vertices)
    faces = "\n".join("f {}/1 {}/2 {}/3".format(*(face + 1)) for face in mesh.faces)
    text = BOX_OBJ.format(library=library, vertices=vertices, faces=faces)
    (folder / "part.obj").write_text(text)
    (folder / "part.mtl").write_text(f"newmtl a\nKd 1 1 1\nmap_Kd {named}\n")
    (folder / picture).parent.mkdir(exist_ok=True)
    Image.new("RGB", (4, 4), (255, 0, 0)).save(folder / picture)
    return folder / "part.obj"


@pytest.mark.parametrize(
    ("picture", "named"),
    [("red.png", "red.png"), ("maps/red.png", "maps\\red.png"), ("red.png", "C:\\work\\red.png")],
)
def test_the_new_command_copies_the_texture_of_a_mesh(
    tmp_path, monkeypatch, capsys, picture, named
):
    """Symptom: it claimed to use the texture, wrote plastic, and copied only the mesh."""
    (tmp_path / "from").mkdir()
    path = textured_obj(tmp_path / "from", picture=picture, named=named)
    assert files_of_mesh(path) == (tmp_path / "from/part.mtl", tmp_path / "from" / picture)
    monkeypatch.chdir(tmp_path)
    assert main(["new", "cell", "--part", "from/part.obj", "--unit", "m"]) == 0
    assert "The texture (4 x 4 px) was taken" in capsys.readouterr().out
    for file in (tmp_path / "from").rglob("*.*"):
        file.unlink()  # The cell must not need these files.
    (part,) = load_cell(tmp_path / "cell/cell.yaml").kinds
    np.testing.assert_array_equal(part.material.texture[0, 0], [255, 0, 0])
    assert part.material.base_color != (0.3, 0.3, 0.3)


@pytest.mark.slow
def test_the_new_command_replaces_a_texture_by_a_requested_surface(tmp_path, monkeypatch, capsys):
    path = textured_obj(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = ["new", "cell", "--part", path.name, "--unit", "m", "--surface", "steel"]
    assert main(words) == 0
    assert "texture" not in capsys.readouterr().out
    (part,) = load_cell(tmp_path / "cell/cell.yaml").kinds
    assert part.material.texture is None and part.material.metallic == 1


def test_the_listed_files_of_a_mesh_are_exactly_those_that_its_reader_uses(tmp_path):
    """A name that leads out of the folder is not followed; a GLB contains its own pictures."""
    (tmp_path / "a").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "red.png")
    path = textured_obj(tmp_path / "a", picture="other.png", named="../red.png")
    assert files_of_mesh(path) == (tmp_path / "a/part.mtl",)
    assert load_part(path, **WORDS)[0].material.texture is None
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4)))
    mesh = box()
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    (tmp_path / "part.glb").write_bytes(mesh.export(file_type="glb"))
    assert files_of_mesh(tmp_path / "part.glb") == ()
    picture = io.BytesIO()
    Image.new("RGB", (4, 4)).save(picture, "PNG")
    (tmp_path / "skin.png").write_bytes(picture.getvalue())
    head = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 0\nend_header\n"
    (tmp_path / "part.ply").write_text(head)
    assert files_of_mesh(tmp_path / "part.ply") == (tmp_path / "skin.png",)
