"""The user's own meshes: files read, judged, and refused with a remedy.

A file is taken as it is or refused. What is put right without changing the shape (vertices
merged, repeated faces dropped) is reported. The mesh keeps the file's own frame; its shading
normals are made anew.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import MeshError
from .builtin import CREASE_RAD
from .normals import crease_normals
from .part import Material, Mesh, Part, Symmetry

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
EXTENSIONS = (".obj", ".ply", ".stl", ".glb")
MAX_FACES = 500_000
SIZE_M = (0.002, 1.5)  # longest side that a stated unit may give
UNSTATED_SIZE_M = (0.005, 1.0)  # longest side at which metres are believed without being stated
_MERGE = 1e-6  # vertices closer than this share of the longest side are one: float32 round-off


def load_part(
    path: Path,
    *,
    name: str | None = None,
    unit: str | None = None,
    material: Material | None = None,
    density_kg_m3: float,
    friction: float,
    symmetry: Symmetry,
) -> tuple[Part, tuple[str, ...]]:
    """A part from an OBJ, PLY, STL or GLB file.

    Args:
        path, unit, material: see `load_mesh`.
        name: of the part; None takes the file's name without its ending.
        symmetry: in the file's own frame, lengths in metres.

    Returns:
        The part, and what was found in the file but is no reason to refuse it, a sentence each.

    Raises:
        MeshError, ValueError: see `load_mesh`.
    """
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
        symmetry=symmetry,
        source=path.name,
    )
    return part, findings


def load_mesh(
    path: Path, *, unit: str | None = None, material: Material | None = None
) -> tuple[Mesh, Material, tuple[str, ...]]:
    """A mesh in metres, in the file's own frame, and its surface, from OBJ, PLY, STL or GLB.

    Args:
        path: the mesh file; a texture is looked for where the file says.
        unit: one of `UNITS_M`. None takes metres where the format states them (GLB), or where the
            longest side is then within `UNSTATED_SIZE_M`.
        material: None takes the file's texture on a plain dielectric, or plain grey.

    Returns:
        Mesh, material, and what was found in the file but is no reason to refuse it.

    Raises:
        MeshError: the file cannot be read, is no closed surface facing outwards, or is of an
            impossible size. One line that names the file and the remedy.
        ValueError: `unit` is not one of `UNITS_M`.
    """
    if unit is not None and unit not in UNITS_M:
        raise ValueError(f"unit is {unit!r}; one of {', '.join(UNITS_M)}")
    try:
        surface = _read(path)
        findings = list(surface.findings)
        surface.check_numbers()
        scale_m = _metres_per_unit(surface.longest, path.suffix.lower(), unit, findings)
        closed = _welded(surface, findings)
        _judge(closed, findings)
        vertices_m = closed.vertices * scale_m
        material = _material(closed, material, findings)
    except _Refusal as refusal:
        raise MeshError(f"{path}: {refusal}") from refusal.__cause__
    mesh = Mesh(
        vertices_m=vertices_m,
        faces=closed.faces,
        corner_uv=closed.corner_uv,
        corner_normals=crease_normals(vertices_m, closed.faces, CREASE_RAD),
    )
    return mesh, material, tuple(findings)


class _Refusal(Exception):
    """Why a file cannot be a part, and the remedy; `load_mesh` adds the file's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surface:
    """What a file holds, in its own unit, before anything is judged."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    corner_uv: Float[np.ndarray, "f 3 2"] | None
    texture: UInt8[np.ndarray, "h w 3"] | None
    other_materials: int  # materials that the part cannot have beside this texture
    shares_vertices: bool
    findings: tuple[str, ...] = ()

    @property
    def longest(self) -> float:
        return float(np.ptp(self.vertices[np.unique(self.faces)], axis=0).max())

    def check_numbers(self) -> None:
        if len(self.faces) > MAX_FACES:
            raise _Refusal(
                f"{len(self.faces)} faces are more than {MAX_FACES}; decimate the mesh, "
                "a camera pixel sees no such detail"
            )
        bad = int((~np.isfinite(self.vertices[np.unique(self.faces)]).all(axis=1)).sum())
        if bad:
            raise _Refusal(f"{bad} vertices are NaN or infinite; export the mesh again")
        if self.longest == 0:
            raise _Refusal("all vertices are in one place; export the mesh again")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps a dependency's log lines and warnings off the user's terminal."""
    from trimesh.util import log as logger

    was_disabled, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled


def _read(path: Path) -> _Surface:
    import trimesh

    if not path.is_file():
        raise _Refusal("there is no such file; check the path")
    suffix = path.suffix.lower()
    if suffix not in EXTENSIONS:
        raise _Refusal(f"cannot read {suffix or 'no ending'}; export {', '.join(EXTENSIONS)}")
    if path.stat().st_size == 0:
        raise _Refusal("the file is empty; export the mesh again")
    with _quiet():
        try:
            scene = trimesh.load_scene(path, process=False)
            pieces = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh) and len(g.faces)]
        # A broken file makes the reader fail in ways that no list of types covers
        # (IndexError, JSONDecodeError, struct.error, even ModuleNotFoundError).
        except Exception as error:
            reason = f"unreadable as {suffix[1:].upper()} ({_one_line(error)})"
            raise _Refusal(f"{reason}; is it cut off? export it again") from error
    if not pieces:
        # Which of the two a cut file gives depends on what else is installed beside the reader.
        raise _Refusal("no triangles in it; is it cut off, or points? export it again, as a mesh")
    return _surface(pieces, shares_vertices=suffix != ".stl")


def _one_line(error: Exception) -> str:
    if isinstance(error, ImportError):  # the reader guesses at an encoding, for want of a header
        return "not that format"
    text = " ".join(str(error).split())[:80]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _surface(pieces: Sequence, *, shares_vertices: bool) -> _Surface:
    """The reader's meshes as one; uv and texture are kept where one texture covers all."""
    start = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    faces = [
        np.asarray(piece.faces, dtype=np.int64) + s
        for piece, s in zip(pieces, start[:-1], strict=True)
    ]
    count = start[-1]
    for piece, s in zip(faces, start[:-1], strict=True):
        if piece.min() < s or piece.max() >= count:
            raise _Refusal("faces name vertices that do not exist; export the mesh again")
    uv = [_uv(piece) for piece in pieces]
    pictures = [_picture(piece) for piece in pieces]
    shown = [p for p in pictures if p is not None]
    distinct = [p for i, p in enumerate(shown) if not any(np.array_equal(p, q) for q in shown[:i])]
    bare = sum(p is None for p in pictures)
    findings = []
    coloured = any(_has_colours(piece) for piece in pieces)
    if coloured and not distinct:
        findings.append("Colours in the file are not used; give the part a material.")
    corner_uv = None
    if all(u is not None for u in uv):
        corner_uv = np.concatenate([u[p.faces] for u, p in zip(uv, pieces, strict=True)])
        if not np.isfinite(corner_uv).all():
            raise _Refusal("texture coordinates are NaN or infinite; export the mesh again")
        if not distinct:
            findings.append("The mesh has texture coordinates, but no picture was found with it.")
    return _Surface(
        vertices=np.concatenate([np.asarray(p.vertices, dtype=np.float64) for p in pieces]),
        faces=np.concatenate(faces),
        corner_uv=corner_uv,
        texture=distinct[0] if distinct else None,
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
    """A piece's base-colour picture as 8-bit RGB, if it has one."""
    material = getattr(piece.visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if picture is None:
        return None
    try:
        pixels = np.array(picture.convert("RGB"))
        # Where a file has uv and no material, trimesh 5 stands in four pixels of this grey.
        stand_in = pixels.shape == (2, 2, 3) and (pixels == 100).all()
        return None if stand_in else pixels
    except OSError as error:
        reason = f"its texture is unreadable ({_one_line(error)})"
        raise _Refusal(f"{reason}; export it again") from error


def _has_colours(piece) -> bool:
    """Whether a file gives colours; the reader's stand-in for none is a certain grey."""
    if piece.visual.kind in ("vertex", "face"):
        return True
    material = getattr(piece.visual, "material", None)
    return material is not None and tuple(material.main_color[:3]) != (102, 102, 102)


def _metres_per_unit(longest: float, suffix: str, unit: str | None, findings: list[str]) -> float:
    stated = unit
    if unit is None and suffix == ".glb":
        stated = "m"  # glTF 2.0 specification, section 3.4: all linear distances are in metres
    low, high = SIZE_M if stated else UNSTATED_SIZE_M
    size_m = longest * UNITS_M[stated or "m"]
    if low <= size_m <= high:
        if stated is None:
            findings.append(f"No unit was stated: read as metres, longest side {_size(size_m)}.")
        return UNITS_M[stated or "m"]
    each = {u: longest * factor for u, factor in UNITS_M.items()}
    fits = [u for u, size in each.items() if UNSTATED_SIZE_M[0] <= size <= UNSTATED_SIZE_M[1]]
    remedy = f"say unit: {' or '.join(fits)}" if fits else "scale the mesh"
    if stated is None:
        listed = [f"{_size(size)} if in {u}" for u, size in each.items()]
        raise _Refusal(f"no unit stated and the longest side is {longest:.4g}, that is "
                       f"{', '.join(listed)}; {remedy}")  # fmt: skip
    whose = "with unit" if unit else "by its format, with unit"
    raise _Refusal(
        f"{whose} {stated} the longest side is {_size(size_m)}, "
        f"a part has {_size(low)} to {_size(high)}; {remedy}"
    )


def _size(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 1 else f"{1000 * metres:.4g} mm"


def _welded(surface: _Surface, findings: list[str]) -> _Surface:
    """The same surface with one vertex per position; uv stays with the face corners."""
    position, label = np.unique(surface.vertices[surface.faces].reshape(-1, 3), axis=0,
                                return_inverse=True)  # fmt: skip
    used = len(np.unique(surface.faces))
    pair = cKDTree(position).query_pairs(_MERGE * surface.longest, output_type="ndarray")
    if len(pair):
        links = coo_array((np.ones(len(pair)), pair.T), shape=(len(position),) * 2)
        root = connected_components(links, directed=False)[1]
        first = np.unique(root, return_index=True)[1]
        findings.append(f"{len(position) - len(first)} nearly equal vertices were merged.")
        position, label = position[first], root[label.reshape(-1)]
    elif surface.shares_vertices and used > len(position):
        findings.append(f"{used - len(position)} duplicate vertices were merged.")
    faces = label.reshape(-1, 3).astype(np.int64)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    if not whole.all():
        findings.append(f"{(~whole).sum()} degenerate faces were dropped.")
    keep = np.flatnonzero(whole)
    # A face written twice the same way round: turn the smallest index to the front, compare.
    turned = faces[keep]
    lead = turned.argmin(axis=1)[:, None]
    turned = np.take_along_axis(turned, (lead + np.arange(3)) % 3, axis=1)
    once = np.sort(np.unique(turned, axis=0, return_index=True)[1])
    if len(once) < len(keep):
        findings.append(f"{len(keep) - len(once)} repeated faces were dropped.")
    keep = keep[once]
    if len(keep) == 0:
        raise _Refusal("all its faces are degenerate; export the mesh again")
    kept, faces = np.unique(faces[keep], return_inverse=True)
    return _Surface(
        vertices=position[kept],
        faces=faces.reshape(-1, 3).astype(np.int64),
        corner_uv=None if surface.corner_uv is None else surface.corner_uv[keep],
        texture=surface.texture,
        other_materials=surface.other_materials,
        shares_vertices=True,
    )


def _judge(surface: _Surface, findings: list[str]) -> None:
    """Refuses a surface that is open, wound both ways, inside out or flat."""
    faces = surface.faces
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge = np.stack([np.minimum(start, end), np.maximum(start, end)], axis=1)
    edge, which = np.unique(edge, axis=0, return_inverse=True)
    uses = np.bincount(which.reshape(-1), minlength=len(edge))
    balance = np.bincount(which.reshape(-1), np.where(start < end, 1, -1), minlength=len(edge))
    boundary = int((uses % 2 == 1).sum())
    if boundary:
        raise _Refusal(
            f"the surface is open: {boundary} boundary edges; close its holes, or give the "
            "sheet a thickness"
        )
    if (balance != 0).any():
        count = int((balance != 0).sum())
        raise _Refusal(
            f"faces are wound both ways round at {count} edges; recalculate the normals to point "
            "outwards"
        )
    if (uses > 2).any():
        findings.append(f"{(uses > 2).sum()} edges are shared by more than two faces.")
    links = coo_array((np.ones(len(start)), (start, end)), shape=(len(surface.vertices),) * 2)
    shells, shell_of_vertex = connected_components(links, directed=False)
    corner = (surface.vertices - surface.vertices.mean(axis=0))[faces]
    signed = np.einsum("fi,fi->f", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    volume = np.bincount(shell_of_vertex[faces[:, 0]], signed, minlength=shells)
    if abs(volume.sum()) < 1e-9 * surface.longest**3:
        raise _Refusal("the surface encloses no volume; give the sheet a thickness")
    if volume.sum() < 0:
        raise _Refusal("the surface is inside out (negative volume); flip its normals")
    inward = int((volume < 0).sum())
    if shells - inward > 1:
        findings.append(f"{shells - inward} separate bodies are taken as one rigid part.")
    if inward:
        findings.append(f"{inward} of {shells} shells face inwards, taken as cavities.")


def _material(surface: _Surface, given: Material | None, findings: list[str]) -> Material:
    if given is not None:
        if given.texture is not None and surface.corner_uv is None:
            raise _Refusal(
                "the material has a texture, but the mesh no texture coordinates; "
                "unwrap it and export OBJ or GLB, or give a base colour"
            )
        return given
    if surface.texture is None:
        return Material()
    if surface.other_materials or surface.corner_uv is None:
        raise _Refusal(
            "one texture does not cover the whole mesh; bake its materials into one, "
            "or give the part a material"
        )
    h, w = surface.texture.shape[:2]
    findings.append(f"The texture ({w} x {h} px) was taken from the file.")
    return Material(texture=surface.texture)
