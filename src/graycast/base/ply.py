"""PLY files: the header of meshes and clouds, a writer of clouds, a reader of vertices.

Meshes are read by trimesh (`parts.load_mesh`), which knows faces and loses what else a vertex has.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from .errors import DatasetError

COLORS = ("red", "green", "blue")
CAMERA_FRAME = "metres, camera frame: x right, y down, z forward"
WORLD_FRAME = "metres, world frame: z up, from the middle of the bin's inner floor"
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


def header(
    form: str,
    properties: Iterable[tuple[str, str]],
    *,
    vertices: int,
    faces: int | None = None,
    notes: Sequence[str] = (),
) -> bytes:
    """Return the header of a file; `properties` are (type, name), `notes` and `obj_info`."""
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
    """Return a binary PLY of points; an organised one (`width_px` points a row) says its size.

    Args:
        more: what else is known of each point; floats are stored in single precision.
        frame: what the points are in, as a comment says it.
    """
    columns = dict(zip("xyz", point_m.T, strict=True))
    columns |= {} if color is None else dict(zip(COLORS, color.T, strict=True))
    columns |= more or {}
    kinds = {name: _kind(column.dtype) for name, column in columns.items()}
    table = np.empty(len(point_m), dtype=[(name, _TYPES[kind]) for name, kind in kinds.items()])
    for name, column in columns.items():
        table[name] = column
    size = []
    if width_px is not None:
        rows = len(table) // width_px
        size = [f"obj_info num_cols {width_px}", f"obj_info num_rows {rows}"]
    head = header(
        "binary_little_endian",
        [(kind, name) for name, kind in kinds.items()],
        vertices=len(table),
        notes=[f"comment {frame}", *size],
    )
    return head + table.astype(table.dtype.newbyteorder("<")).tobytes()


def _kind(dtype: np.dtype) -> str:
    if dtype.kind == "f":
        return "float"
    return "uchar" if dtype == np.uint8 else "int"


def split(path: Path) -> tuple[list[str], bytes]:
    """Return the lines of the header, and the bytes after it.

    Raises:
        DatasetError: it is no PLY.
    """
    data = path.read_bytes()
    end = re.search(rb"\nend_header[ \t]*\r?\n", data)
    if not data.startswith(b"ply") or end is None:
        raise DatasetError(f"{path}: is not a PLY file: its header is missing")
    return data[: end.start()].decode("ascii", errors="replace").splitlines(), data[end.end() :]


def read_vertices(path: Path) -> tuple[list[str], Mapping[str, np.ndarray], int]:
    """Return the header, each property of the vertices by its name, and the number of vertices.

    Vertices are the first element; what follows is not read.

    Raises:
        DatasetError: it is no PLY, or is damaged.
    """
    lines, body = split(path)
    try:
        count, names = _vertices(path, lines)
        order = _order(path, lines)
    except (ValueError, IndexError) as error:
        raise DatasetError(f"{path}: its header is damaged: export it again") from error
    if order == "=":
        return lines, _ascii(path, body, count, names), count
    kind = np.dtype([(name, order + code) for name, code in names])
    if len(body) < count * kind.itemsize:
        raise DatasetError(
            f"{path}: ends before its {count} vertices are complete: copy the file again"
        )
    table = np.frombuffer(body, dtype=kind, count=count)
    return lines, {name: table[name] for name, _ in names}, count


def _order(path: Path, header: list[str]) -> str:
    form = next((line.split()[1] for line in header if line.startswith("format ")), "none")
    if form not in _ORDERS:
        raise DatasetError(f"{path}: format is {form}: choose one of {', '.join(_ORDERS)}")
    return _ORDERS[form]


def _vertices(path: Path, header: list[str]) -> tuple[int, list[tuple[str, str]]]:
    """Return the number of vertices, and the names and types of their properties."""
    at = [i for i, line in enumerate(header) if line.startswith("element ")]
    first = header[at[0]].split() if at else []
    if len(first) != 3 or first[1] != "vertex":
        raise DatasetError(f"{path}: its first element is not 'vertex': write the vertices first")
    names = []
    for line in header[at[0] + 1 : at[1] if len(at) > 1 else None]:
        words = line.split()
        if words[:1] == ["property"]:
            if words[1] not in _TYPES:
                raise DatasetError(f"{path}: vertices have a property of type {words[1]}")
            names.append((words[2], _TYPES[words[1]]))
    if missing := set("xyz") - {name for name, _ in names}:
        raise DatasetError(f"{path}: vertices have no {', '.join(sorted(missing))}")
    return int(first[2]), names


def _ascii(
    path: Path, body: bytes, count: int, names: list[tuple[str, str]]
) -> Mapping[str, np.ndarray]:
    lines = body.decode("ascii", errors="replace").splitlines()[:count]
    try:
        rows = np.array([line.split() for line in lines], dtype=np.float64)
    except ValueError as error:
        raise DatasetError(f"{path}: its vertices are not numbers in equal rows") from error
    if rows.shape != (count, len(names)):
        raise DatasetError(
            f"{path}: has {len(rows)} vertices of {rows.shape[1] if rows.ndim > 1 else 0} numbers, "
            f"its header says {count} of {len(names)}"
        )
    whole = {name: code for name, code in names if code[0] != "f"}
    return {name: rows[:, i].astype(whole.get(name, "f8")) for i, (name, _) in enumerate(names)}
