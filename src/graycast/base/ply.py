"""Write headers and point clouds of PLY files, and read vertices.

trimesh reads files, but its writer stores neither the size of organised clouds nor their frame.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from .errors import DatasetError

COLORS = ("red", "green", "blue")
TEXTURE = "comment TextureFile"  # A mesh with a texture has this in its header.
CAMERA_FRAME = "metres, camera frame: x right, y down, z forward"
WORLD_FRAME = "metres, world frame: z up, from the middle of the bin's inner floor"
_TYPES = {"uchar": "u1", "int": "i4", "float": "f4"}
_FORMATS = ("binary_little_endian", "binary_big_endian", "ascii")


def header(
    form: str,
    properties: Iterable[tuple[str, str]],
    *,
    vertices: int,
    faces: int | None = None,
    notes: Sequence[str] = (),
) -> bytes:
    """Return the header of a PLY file for `properties` (type, name); `notes` are complete lines."""
    element = [f"element face {faces}", "property list uchar int vertex_indices"]
    lines = [
        "ply",
        f"format {form} 1.0",
        *notes,
        f"element vertex {vertices}",
        *(f"property {kind} {name}" for kind, name in properties),
        *(element if faces is not None else []),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def cloud_bytes(
    point_m: Float[np.ndarray, "n 3"],
    color: UInt8[np.ndarray, "n 3"] | None,
    *,
    more: Mapping[str, np.ndarray] | None = None,
    width_px: int | None = None,
    frame: str = CAMERA_FRAME,
) -> bytes:
    """Return a binary PLY file of points; `width_px` (points per row) adds the size of the grid.

    Args:
        more: more properties of the points by name; floats are stored in single precision.
        frame: text that describes the frame of the points; it is stored as a comment.
    """
    # Three numbers of a point are copied together, which takes half as long as one by one.
    blocks = [(tuple("xyz"), point_m), *([] if color is None else [(COLORS, color)])]
    blocks += [((name,), column) for name, column in (more or {}).items()]
    types = [f"<{_TYPES[_kind(block.dtype)]}" for _, block in blocks]
    forms = [(names[0], kind, block.shape[1:])
             for (names, block), kind in zip(blocks, types, strict=True)]  # fmt: skip
    table = np.empty(len(point_m), dtype=forms)
    for names, block in blocks:
        table[names[0]] = block
    size = []
    if width_px is not None:
        rows = len(table) // width_px
        size = [f"obj_info num_cols {width_px}", f"obj_info num_rows {rows}"]
    head = header(
        "binary_little_endian",
        [(_kind(block.dtype), name) for names, block in blocks for name in names],
        vertices=len(table),
        notes=[f"comment {frame}", *size],
    )
    return head + table.tobytes()


def _kind(dtype: np.dtype) -> str:
    if dtype.kind == "f":
        return "float"
    return "uchar" if dtype == np.uint8 else "int"


def split(path: Path) -> tuple[list[str], bytes]:
    """Return the lines of a PLY file's header, and the bytes after it.

    Raises:
        DatasetError: the file is no PLY.
    """
    data = path.read_bytes()
    end = re.search(rb"\nend_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or end is None:
        raise DatasetError(f"{path}: is not a PLY file: its header is missing")
    return data[: end.start()].decode("ascii", errors="replace").splitlines(), data[end.end() :]


def read_vertices(path: Path) -> tuple[list[str], Mapping[str, np.ndarray], int]:
    """Return the header, each property of the vertices by its name, and the number of vertices.

    Raises:
        DatasetError: the file is no PLY, or is damaged.
    """
    from trimesh.exchange.ply import load_ply  # The import takes long, and writers do not need it.

    lines, body = split(path)
    form = next(
        (line[7:].partition(" ")[0] for line in lines if line.startswith("format ")), "none"
    )
    if form not in _FORMATS:
        raise DatasetError(f"{path}: format is {form}: choose one of {', '.join(_FORMATS)}")
    vertex_lines = "\n".join(lines).partition("\nelement vertex ")[2].partition("\nelement ")[0]
    names = {line.split()[-1] for line in vertex_lines.splitlines() if line.startswith("property ")}
    if missing := set("xyz") - names:
        raise DatasetError(f"{path}: its vertices have no {', '.join(sorted(missing))}")
    try:
        with open(path, "rb") as file:
            vertex = load_ply(file)["metadata"]["_ply_raw"]["vertex"]
        table = {name: np.ravel(vertex["data"][name]) for name in vertex["properties"]}
    except Exception as error:  # trimesh has no exception class for damaged files.
        raise DatasetError(
            f"{path}: its vertices cannot be read ({error}): export or copy the file again"
        ) from error
    count = int(vertex["length"])
    whole = all(len(column) == count and column.dtype != object for column in table.values())
    if form == "ascii":  # trimesh ignores numbers beyond those that the header names.
        whole &= _row_sizes(lines, body) <= {len(table)}
    if not whole:
        raise DatasetError(
            f"{path}: its rows are not the {count} vertices that its header states: export or copy "
            "the file again"
        )
    return lines, table, count


def triangles(
    path: Path,
) -> tuple[list[str], Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return the header, vertices and triangles of an ASCII PLY file of ours, or of a binary file.

    trimesh reads binary files. Its import takes longer than the check of a scene, so it does not
    read ours.

    Raises:
        DatasetError: the file is damaged, or another program wrote it as ASCII.
    """
    lines, body = split(path)
    if any(line.startswith("format binary") for line in lines):
        return lines, *_binary_triangles(path)
    rows = [row.split() for row in body.splitlines()]
    try:
        vertices, faces = (int(line.split()[2]) for line in lines if line.startswith("element "))
        if lines[1] != "format ascii 1.0" or len(rows) != vertices + faces:
            raise ValueError(f"{lines[1]}, {len(rows)} rows of {vertices + faces}")
        point = np.array([row[:3] for row in rows[:vertices]], dtype=np.float64)
        corners = np.array(rows[vertices:], dtype=np.int64).reshape(-1, 4)  # the number 3, and them
    except (ValueError, IndexError) as error:
        raise DatasetError(f"{path}: is no intact ASCII PLY file of triangles ({error})") from error
    return lines, point.reshape(-1, 3), corners[:, 1:]


def _binary_triangles(path: Path) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    from trimesh.exchange.ply import load_ply

    try:
        with open(path, "rb") as file:
            mesh = load_ply(file)
        return mesh["vertices"].astype(np.float64), mesh["faces"].astype(np.int64).reshape(-1, 3)
    except Exception as error:  # trimesh has no exception class for damaged files.
        raise DatasetError(f"{path}: is no intact PLY file of triangles ({error})") from error


def _row_sizes(lines: Sequence[str], body: bytes) -> set[int]:
    """Return the different numbers of words per row of vertices in an ASCII file."""
    elements = [line.split()[1:3] for line in lines if line.startswith("element ")]
    names = [name for name, _ in elements]
    counts = [int(count) for _, count in elements]
    first = sum(counts[: names.index("vertex")])
    rows = body.splitlines()[first : first + counts[names.index("vertex")]]
    return {len(row.split()) for row in rows}
