"""Read and check the user's mesh files; each error names a remedy.

A file is accepted or refused. Repairs that do not change the shape (merged vertices, dropped
repeated faces) are reported. The mesh keeps the file's coordinate frame; its shading normals
are computed again.
"""

import importlib.util
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ...base.errors import MeshError
from ...base.file_limits import refuse_large_size
from ...base.frames import UNITS_M
from .builtin import CREASE_RAD
from .mesh_formats import (
    STL_HEAD,
    file_beside,
    plain_stl,
    refuse_other_format,
    stl_bytes,
    stl_count,
)
from .normals import crease_normals
from .part import Material, Mesh, Part, Symmetry
from .surface import MAX_FACES, RawMesh, Refusal, as_solid, judge, too_many, welded

EXTENSIONS = (".obj", ".ply", ".stl", ".glb")
STEP = (".step", ".stp")  # cascadio, an optional package, triangulates their surfaces.
MAX_BYTES = 400_000_000  # An ASCII STL of MAX_FACES takes a third; textures may need more.
SIZE_M = (0.002, 1.5)  # limits of the longest side with a stated unit
UNSTATED_SIZE_M = (0.005, 1.0)  # Without a unit, a longest side between these is in metres.


def load_part(
    path: Path | str,
    *,
    name: str | None = None,
    unit: str | None = None,
    material: Material | None = None,
    density_kg_m3: float,
    friction: float,
    symmetry: Symmetry | None = None,
) -> tuple[Part, tuple[str, ...]]:
    """Load a part from an OBJ, PLY, STL, GLB or STEP file.

    Args:
        path: see `load_mesh`, also for `unit` and `material`.
        name: name of the part; None takes the file's name without its ending.
        symmetry: symmetry in the file's own frame, lengths in metres; None: no symmetry.

    Returns:
        The part, and notes on harmless defects of the file, one sentence each.

    Raises:
        MeshError, ValueError: see `load_mesh`.
    """
    path = Path(path)
    mesh, material, findings = load_mesh(path, unit=unit, material=material)
    away_m = float(np.linalg.norm(mesh.bounds_m.mean(axis=0)))
    if away_m > mesh.extent_m.max():
        findings += (f"The file's origin lies {_size(away_m)} from the part's middle.",)
    part = Part(
        name=path.stem if name is None else name,
        mesh=mesh,
        material=material,
        density_kg_m3=density_kg_m3,
        friction=friction,
        symmetry=symmetry or Symmetry(),
        source=path.name,
    )
    return part, findings


def load_mesh(
    path: Path, *, unit: str | None = None, material: Material | None = None
) -> tuple[Mesh, Material, tuple[str, ...]]:
    """Load a mesh in metres, and its surface, from OBJ, PLY, STL, GLB or STEP.

    Args:
        path: the mesh file; the file says where its texture is.
        unit: one of `UNITS_M`. None means metres if the format states its unit (GLB, STEP), or if
            the longest side is then within `UNSTATED_SIZE_M`.
        material: the surface; None takes the file's texture on a plain dielectric, or plain grey.

    Returns:
        Mesh, material, and notes on harmless defects of the file.

    Raises:
        MeshError: the file cannot be read, has no closed surface facing outwards, or has an
            impossible size. One line names the file and the remedy.
        ValueError: `unit` is not one of `UNITS_M`.
    """
    if unit is not None and unit not in UNITS_M:
        raise ValueError(f"unit is {unit!r}; choose one of {', '.join(UNITS_M)}")
    try:
        surface = read_surface(path)
        findings = list(surface.findings)
        surface.check_numbers()
        scale_m = _metres_per_unit(surface.longest, path.suffix.lower(), unit, findings)
        closed = welded(surface, findings)
        judge(closed, findings)
        closed = as_solid(closed, findings)
        vertices_m = closed.vertices * scale_m
        material = _material(closed, material, findings)
    except Refusal as refusal:
        raise MeshError(f"{path}: {refusal}") from refusal.__cause__
    mesh = Mesh(
        vertices_m=vertices_m,
        faces=closed.faces,
        corner_uv=closed.corner_uv,
        corner_normals=crease_normals(vertices_m, closed.faces, CREASE_RAD),
    )
    return mesh, material, tuple(findings)


def _load_reader() -> None:
    """Load trimesh in a thread, while this thread handles Ctrl-C and SIGTERM.

    The import of trimesh suppresses exceptions that signal handlers raise. Python runs signal
    handlers only in the main thread.
    """
    loader = threading.Thread(target=importlib.import_module, args=("trimesh",), daemon=True)
    loader.start()
    loader.join()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep a dependency's log lines and warnings off the user's terminal."""
    from trimesh.util import log as logger

    was_disabled, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled


def read_surface(path: Path) -> RawMesh:
    """Return a file's content in its own unit, without a check that it can be a part.

    Raises:
        Refusal: the file cannot be read as a mesh with triangles.
    """
    _load_reader()
    import trimesh

    suffix = path.suffix.lower()
    _check_file(path, suffix)
    changed, notes = plain_stl(path) if suffix == ".stl" else (None, ())
    source: Any = path if changed is None else BytesIO(changed)
    with _quiet():
        try:
            scene = trimesh.load_scene(
                source, file_type=suffix[1:], resolver=_resolver(path), process=False
            )
            pieces = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh) and len(g.faces)]
        # A broken file makes the reader fail in ways that no list of types covers
        # (IndexError, JSONDecodeError, struct.error, even ModuleNotFoundError).
        except Exception as error:
            reason = f"unreadable as {suffix[1:].upper()} ({_one_line(error)})"
            raise Refusal(f"{reason}; the file may be incomplete, so export it again") from error
    if not pieces:
        # The installed packages decide which of the two errors a truncated file raises.
        raise Refusal(
            "it has no triangles; it may be incomplete or hold only points, so export it again "
            "as a mesh"
        )
    surface = _surface(pieces, shares_vertices=suffix != ".stl")
    return replace(surface, findings=(*notes, *surface.findings))


def _resolver(path: Path):
    """Return a resolver for the reader that finds the same files as `files_of_mesh`."""
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        def get(self, name: str) -> bytes:
            file = file_beside(path, name)
            if file is None:
                raise FileNotFoundError(name)
            return file.read_bytes()

    return Beside(str(path))


def _check_file(path: Path, suffix: str) -> None:
    """Refuse a file whose kind, ending or size shows that it is no mesh, before it is read."""
    if not path.exists():
        raise Refusal("there is no such file; check the path")
    if not path.is_file():  # A pipe would block, and a device never ends.
        kind = "a folder" if path.is_dir() else "a device or a pipe"
        raise Refusal(f"it is {kind}; give the path of a mesh file")
    if suffix in STEP and importlib.util.find_spec("cascadio") is None:
        raise Refusal(
            f"{suffix} needs cascadio; run pip install 'graycast[cad]', or export "
            f"{', '.join(EXTENSIONS)}"
        )
    if suffix not in EXTENSIONS + STEP:
        raise Refusal(f"cannot read {suffix or 'no ending'}; export {', '.join(EXTENSIONS)}")
    size = path.stat().st_size
    if size == 0:
        raise Refusal("the file is empty; export the mesh again")
    if size > MAX_BYTES:
        raise Refusal(
            f"the file has {size / 1e6:.0f} MB, more than the {MAX_BYTES / 1e6:.0f} MB that a "
            f"mesh of {MAX_FACES} faces needs; decimate the mesh, or export smaller textures"
        )
    refuse_other_format(path, suffix)
    if suffix == ".stl":
        _check_stl_count(path, size)


def _check_stl_count(path: Path, size: int) -> None:
    """Refuse a binary STL whose header states too many triangles, before they are read."""
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
    count = stl_count(head)
    if len(head) == STL_HEAD and size == stl_bytes(head) and count > MAX_FACES:
        raise Refusal(too_many(count))


def _one_line(error: Exception) -> str:
    if isinstance(
        error, ImportError
    ):  # The file has no header, so the reader guesses its encoding.
        return "not that format"
    text = " ".join(str(error).split())[:80]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _surface(pieces: Sequence, *, shares_vertices: bool) -> RawMesh:
    """Return the reader's meshes as one; keep uv and texture if one texture covers all meshes."""
    start = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    faces = [
        np.asarray(piece.faces, dtype=np.int64) + s
        for piece, s in zip(pieces, start[:-1], strict=True)
    ]
    count = start[-1]
    for piece, s in zip(faces, start[:-1], strict=True):
        if piece.min() < s or piece.max() >= count:
            raise Refusal("faces name vertices that do not exist; export the mesh again")
    uv = [_uv(piece) for piece in pieces]
    pictures = [_picture(piece) for piece in pieces]
    maps = [p for p in pictures if p is not None]
    distinct = [p for i, p in enumerate(maps) if not any(np.array_equal(p, q) for q in maps[:i])]
    bare = sum(p is None for p in pictures)
    findings = []
    coloured = any(_has_colours(piece) for piece in pieces)
    if coloured and not distinct:
        findings.append("Colours in the file are not used; give the part a material.")
    corner_uv = None
    known = [u for u in uv if u is not None]
    if len(known) == len(uv):
        corner_uv = np.concatenate([u[p.faces] for u, p in zip(known, pieces, strict=True)])
        if not np.isfinite(corner_uv).all():
            raise Refusal("texture coordinates are NaN or infinite; export the mesh again")
        if not distinct:
            findings.append(
                "The mesh has texture coordinates, but no picture was read with it: it is "
                "missing, damaged or too large."
            )
    return RawMesh(
        vertices=np.concatenate([np.asarray(p.vertices, dtype=np.float64) for p in pieces]),
        faces=np.concatenate(faces),
        corner_uv=corner_uv,
        texture=distinct[0] if distinct else None,
        face_color=_face_color(pieces),
        other_materials=len(distinct) - 1 + bare if distinct else 0,
        shares_vertices=shares_vertices,
        findings=tuple(findings),
    )


def _uv(piece) -> Float[np.ndarray, "v 2"] | None:
    uv = getattr(piece.visual, "uv", None)
    if uv is None or np.shape(uv) != (len(piece.vertices), 2):
        return None
    return np.asarray(uv, dtype=np.float64)


def _picture(piece) -> UInt8[np.ndarray, "h w 3"] | None:
    """Return a piece's base-colour picture as 8-bit RGB, if it has one."""
    material = getattr(piece.visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if picture is None:
        return None
    refuse_large_size(picture.width, picture.height, "its texture", Refusal)
    try:
        pixels = np.array(picture.convert("RGB"))
        # For uv without a material, trimesh 5 substitutes four pixels of this grey.
        stand_in = pixels.shape == (2, 2, 3) and (pixels == 100).all()
        return None if stand_in else pixels
    except OSError as error:
        reason = f"its texture is unreadable ({_one_line(error)})"
        raise Refusal(f"{reason}; export it again") from error


def _face_color(pieces: Sequence) -> UInt8[np.ndarray, "f 3"] | None:
    """Return the sRGB of each face if every piece has colours of its vertices or faces."""
    if any(piece.visual.kind not in ("vertex", "face") for piece in pieces):
        return None
    return np.concatenate([np.asarray(p.visual.face_colors)[:, :3] for p in pieces])


def _has_colours(piece) -> bool:
    """Return whether a file has colours; without colours, the reader uses a known grey."""
    if piece.visual.kind in ("vertex", "face"):
        return True
    material = getattr(piece.visual, "material", None)
    return material is not None and tuple(material.main_color[:3]) != (102, 102, 102)


def _metres_per_unit(longest: float, suffix: str, unit: str | None, findings: list[str]) -> float:
    if unit and suffix in STEP:
        raise Refusal("a STEP file states its own unit; remove unit")
    stated = unit
    if unit is None and suffix in (".glb", *STEP):
        stated = "m"  # glTF 2.0 specification, section 3.4; cascadio makes glTF of STEP
    low, high = SIZE_M if stated else UNSTATED_SIZE_M
    size_m = longest * UNITS_M[stated or "m"]
    if low <= size_m <= high:
        if stated is None:
            findings.append(f"No unit was stated: read as metres, longest side {_size(size_m)}.")
        return UNITS_M[stated or "m"]
    each = {u: longest * factor for u, factor in UNITS_M.items()}
    fits = [u for u, size in each.items() if UNSTATED_SIZE_M[0] <= size <= UNSTATED_SIZE_M[1]]
    remedy = f"state unit: {' or '.join(fits)}" if fits else "scale the mesh"
    if stated is None:
        listed = [f"{_size(size)} if in {u}" for u, size in each.items()]
        raise Refusal(f"no unit stated and the longest side is {longest:.4g}, that is "
                       f"{', '.join(listed)}; {remedy}")  # fmt: skip
    whose = "with unit" if unit else "by its format, with unit"
    raise Refusal(
        f"{whose} {stated} the longest side is {_size(size_m)}, "
        f"a part has {_size(low)} to {_size(high)}; {remedy}"
    )


def _size(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 1 else f"{1000 * metres:.4g} mm"


def _material(surface: RawMesh, material: Material | None, findings: list[str]) -> Material:
    if material is not None:
        flat = {"texture": "base colour", "roughness_map": "roughness"}
        for key in (key for key in flat if getattr(material, key) is not None):
            if surface.corner_uv is None:
                raise Refusal(
                    f"the material has a {key}, but the mesh has no texture coordinates; unwrap it "
                    f"and export OBJ or GLB, or give a {flat[key]} alone"
                )
        return material
    if surface.texture is None:
        return Material()
    if surface.other_materials or surface.corner_uv is None:
        raise Refusal(
            "one texture does not cover the whole mesh; bake its materials into one, "
            "or give the part a material"
        )
    h, w = surface.texture.shape[:2]
    findings.append(f"The texture ({w} x {h} px) was taken from the file.")
    return Material(texture=surface.texture)
