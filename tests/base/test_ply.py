"""The reader of models agrees with trimesh, and refuses damaged files."""

import numpy as np
import pytest
import trimesh

from graycast.base.errors import DatasetError
from graycast.base.ply import COLORS, header, triangles

VERTICES = np.array([[0, 0, 0], [1.5, 0, 0], [0, -2.25, 0], [0, 0, 1e-3]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def ascii_text():
    """Return a tetrahedron with a colour per vertex, as models of a dataset have."""
    properties = [*(("float", axis) for axis in "xyz"), *(("uchar", color) for color in COLORS)]
    rows = [f"{x:.9g} {y:.9g} {z:.9g} 1 2 3\n" for x, y, z in VERTICES]
    rows += [f"3 {a} {b} {c}\n" for a, b, c in FACES]
    return header("ascii", properties, vertices=4, faces=4) + "".join(rows).encode()


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ascii_and_binary_files_give_the_same_triangles(tmp_path, order):
    """trimesh writes little-endian files; the rows of the others are written here."""
    path = tmp_path / "part.ply"
    if order == "ascii":
        path.write_bytes(ascii_text())
    elif order == "binary_little_endian":
        trimesh.Trimesh(VERTICES, FACES, process=False).export(path)
    else:
        head = header(order, [("float", axis) for axis in "xyz"], vertices=4, faces=4)
        corners = b"".join(b"\3" + face.astype(">i4").tobytes() for face in FACES)
        path.write_bytes(head + VERTICES.astype(">f4").tobytes() + corners)
    lines, vertices, faces = triangles(path)
    assert lines[:2] == ["ply", f"format {order} 1.0"]
    np.testing.assert_allclose(vertices, VERTICES, rtol=1e-7)
    np.testing.assert_array_equal(faces, FACES)


@pytest.mark.parametrize("binary", [False, True])
def test_a_file_that_was_cut_off_is_refused(tmp_path, binary):
    path = tmp_path / "part.ply"
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    content = mesh.export(file_type="ply") if binary else ascii_text()
    path.write_bytes(content[:-9])
    with pytest.raises(DatasetError, match=r"part.ply: is no intact .*PLY file of triangles"):
        triangles(path)


@pytest.mark.parametrize(
    "old, new",
    [(b"3 0 2 1", b"4 0 2 1 3"), (b"1.5 0 0", b"1.5 x 0"), (b"ascii 1.0", b"ascii 2"),
     (ascii_text(), b"ply\nend_header\n")],
)  # fmt: skip
def test_an_ascii_file_of_another_form_is_refused(tmp_path, old, new):
    path = tmp_path / "part.ply"
    path.write_bytes(ascii_text().replace(old, new))
    with pytest.raises(DatasetError, match="is no intact ASCII PLY file of triangles"):
        triangles(path)
