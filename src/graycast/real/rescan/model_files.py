"""Reader of third-party models as parts with materials from a file, their own, or grey.

Checks are lenient, because a model is only rendered: a reconstructed mesh may be open, and a face
may point the wrong way. So such a part cannot be dropped into a bin. Vertex colours become one
colour for each face, in a small texture.

Source: BOP's format, github.com/thodan/bop_toolkit, docs/bop_datasets_format.md: PLY files in
millimetres, with colours or with a texture, and `models_info.json`.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import Float, UInt8
from pydantic import BaseModel, ConfigDict

from ...base.errors import ConfigError, DatasetError
from ...base.frames import UNITS_M
from ...base.settings import check_settings, parse_yaml, read_text
from ...dataset.files.places import CLAIM
from ...dataset.files.records import MM_PER_M, Continuous, Count, Matrix4, Positive
from ...dataset.read.real import read_claim
from ...dataset.read.rescanned import claim_kind
from ...dataset.write.models import symmetry_m
from ...world.parts import Material, Mesh, Part, Symmetry
from ...world.parts.builtin import CREASE_RAD
from ...world.parts.material_section import MaterialSection, resolve_material
from ...world.parts.meshfile import SIZE_M, read_surface
from ...world.parts.normals import crease_normals
from ...world.parts.surface import RawMesh, Refusal, welded
from .source_files import record_of

FOLDERS = ("models", "models_cad", "models_reconst", "models_eval")
_BACKGROUND = "background"  # key in the materials file for everything except objects
_GREY = Material(base_color=(0.3, 0.3, 0.3))
_REMEDY = "give their folder with --models DIR, or leave objects out with --depth-only"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFile:
    """The mesh file of an object, the object's name, and known facts about both.

    `unit` is the unit of the mesh. Unless the user stated it (`unit_stated`), `diameter_m` may show
    that it is wrong. `diameter_m` and `symmetry` assume a `models_info.json` in millimetres.
    """

    path: Path
    name: str
    unit: str
    unit_stated: bool = False
    diameter_m: float | None = None
    symmetry: Symmetry = field(default_factory=Symmetry)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Models:
    """Parts by object id, ids of parts without a known colour (`plain`), and notes for the user."""

    parts: Mapping[int, Part]
    plain: frozenset[int]
    notes: tuple[str, ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _Units:
    """The unit of a mesh, and the unit of its entry in `models_info.json`."""

    mesh: str
    info: str


NO_MODELS = Models(parts={}, plain=frozenset())


class _ModelInfo(BaseModel):
    """One model in a `models_info.json` of any origin."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    diameter: Positive | None = None
    name: str | None = None
    symmetries_discrete: list[Matrix4] = []
    symmetries_continuous: list[Continuous] = []


def bop_models(root: Path, models: Path | None, unit: str | None = None) -> Mapping[int, ModelFile]:
    """Return the model files of a dataset in BOP's form, without reading the meshes.

    Args:
        root: the folder of the dataset; the first existing folder of `FOLDERS` in it is used.
        models: another folder of models, which the user chose; None uses the dataset's.
        unit: unit of the meshes if the user states it; None means BOP's millimetres.

    Raises:
        DatasetError: there are no models, or `models_info.json` is damaged.
    """
    if models is None:
        models = next((root / name for name in FOLDERS if (root / name).is_dir()), None)
        if models is None:
            raise DatasetError(f"{root}: has no folder {', '.join(FOLDERS)}: {_REMEDY}")
    files = {
        int(match[1]): path
        for path in sorted(models.glob("obj_*.ply"))
        if (match := re.fullmatch(r"obj_(\d+)\.ply", path.name))
    }
    if not files:
        raise DatasetError(f"{models}: has no models obj_000001.ply and so on: {_REMEDY}")
    infos: Mapping[int, _ModelInfo] = {}
    if (models / "models_info.json").is_file():
        infos = record_of(models / "models_info.json", dict[Count, _ModelInfo])
    names = _own_names(root)
    objects = {}
    for obj_id, path in files.items():
        info = infos.get(obj_id, _ModelInfo())
        objects[obj_id] = ModelFile(
            path=path,
            name=names.get(obj_id) or info.name or path.stem,
            unit=unit or "mm",
            unit_stated=unit is not None,
            diameter_m=None if info.diameter is None else info.diameter / MM_PER_M,
            symmetry=symmetry_m(info.symmetries_discrete, info.symmetries_continuous),
        )
    return objects


def _own_names(root: Path) -> Mapping[int, str]:
    """Return the part names of a dataset that Graycast generated; BOP's files have no names."""
    if not (root / CLAIM).is_file() or claim_kind(root) is not None:
        return {}
    return {part.obj_id: part.name for part in read_claim(root).parts}


def read_models(
    files: Mapping[int, ModelFile], obj_ids: Collection[int], materials: Path | None
) -> Models:
    """Read the models of objects, with their materials.

    Args:
        files: all models of the dataset.
        obj_ids: ids of the models to read.
        materials: a YAML file that has, under the id or name of an object or under `default`, the
            name of a material or a section of its keys. A section changes the mesh's own material,
            so that `{roughness: 0.3}` keeps the colours; a name replaces the material.

    Raises:
        DatasetError: an object has no model, or a model file is damaged or in another unit.
        ConfigError: the materials file is not valid.
    """
    looks = {} if materials is None else _looks(materials, files)
    folder = Path() if materials is None else materials.parent
    if missing := sorted(set(obj_ids) - set(files)):
        raise DatasetError(
            f"{next(iter(files.values())).path.parent}: has no model obj_{missing[0]:06d}.ply, and "
            f"an image has the object {missing[0]}: add the model, or {_REMEDY}"
        )
    parts, plain, converted = {}, set(), {}
    for obj_id in sorted(obj_ids):
        look = looks.get(obj_id, MaterialSection())
        try:
            mesh, material, units = _read_model(files[obj_id], look, folder)
        except ConfigError as error:
            raise ConfigError(f"{materials}: {obj_id}: {error}") from error
        if material.texture is None and look.base_color is None and look.preset is None:
            plain.add(obj_id)
        if units.mesh != files[obj_id].unit or units.info != "mm":
            converted[files[obj_id].path.name] = units
        parts[obj_id] = Part(
            name=files[obj_id].name,
            mesh=mesh,
            material=material,
            density_kg_m3=1000.0,
            friction=0.4,
            symmetry=_scaled(files[obj_id].symmetry, UNITS_M[units.info] / UNITS_M["mm"]),
            source=files[obj_id].path.name,
        )
    return Models(parts=parts, plain=frozenset(plain), notes=tuple(_unit_notes(converted)))


def _unit_notes(converted: Mapping[str, _Units]) -> Iterator[str]:
    for units in sorted(set(converted.values()), key=lambda units: units.mesh):
        names = [name for name, other in converted.items() if other == units]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        info = "" if units.info == "mm" else f", and its models_info.json in {units.info}"
        yield (
            f"{names[0]}{more}: the model is in {units.mesh}{info}, as its size and its diameter "
            "show, and was converted: BOP's models are in mm"
        )


def _scaled(symmetry: Symmetry, factor: float) -> Symmetry:
    """Return the symmetry of a part whose lengths are multiplied by `factor`."""
    scale = np.array([[1, 1, 1, factor]] * 3 + [[1, 1, 1, 1]])
    return Symmetry(
        discrete=tuple(matrix * scale for matrix in symmetry.discrete),
        continuous=tuple(
            (axis, (factor * x, factor * y, factor * z)) for axis, (x, y, z) in symmetry.continuous
        ),
    )


def read_background(materials: Path) -> Material | None:
    """Return the material under the key `background` of the materials file; None without this key.

    Raises:
        ConfigError: the file is not valid.
    """
    words = parse_yaml(read_text(materials), materials).get(_BACKGROUND)
    if words is None:
        return None
    section = _section(words, materials, _BACKGROUND)
    if section.files or section.transparent is not None:
        what = next(iter(section.files), "transparent")
        raise ConfigError(f"{materials}: {_BACKGROUND}: it cannot have {what}: remove this key")
    return resolve_material(section, Path())


def _section(words: Any, path: Path, key: str | int) -> MaterialSection:
    section = {"preset": words} if isinstance(words, str) else words
    return check_settings(section, MaterialSection, Path(f"{path}: {key}"))


def _looks(path: Path, files: Mapping[int, ModelFile]) -> Mapping[int, MaterialSection]:
    """Return the sections of a materials file by object id; `default` covers all other objects."""
    looks: dict[int, MaterialSection] = {}
    default = None
    by_name = {file.name: obj_id for obj_id, file in files.items()}
    for key, words in parse_yaml(read_text(path), path).items():
        if key == _BACKGROUND:
            continue
        obj_id = by_name.get(key, int(key) if re.fullmatch(r"\d+", str(key)) else None)
        if obj_id not in files and not (key == "default" and files):
            names = [f"{i}" if file.name == file.path.stem else f"{i} ({file.name})"
                     for i, file in files.items()]  # fmt: skip
            raise ConfigError(
                f"{path}: no object has the id or name {key}: choose "
                + ", ".join([*(["default"] if files else []), _BACKGROUND, *names])
            )
        section = _section(words, path, key)
        if obj_id is None:
            default = section
        elif obj_id in looks:
            raise ConfigError(f"{path}: object {obj_id} has two materials: remove one of them")
        else:
            looks[obj_id] = section
    return looks if default is None else dict.fromkeys(files, default) | looks


def _read_model(
    file: ModelFile, look: MaterialSection, folder: Path
) -> tuple[Mesh, Material, _Units]:
    """Read a model; return its mesh [m], its material and the units of its files.

    The material has the mesh's own colours, or grey, unless the user's section changes them.
    """
    try:
        surface = read_surface(file.path)
        surface.check_numbers()
        header = _header(file.path)
        count = re.search(rb"element face (\d+)", header)
        if count is not None and len(surface.faces) < int(count[1]):
            raise Refusal(f"has {len(surface.faces)} of {int(count[1])} faces; copy it again")
        units = _units(file, surface.longest)
        surface = welded(surface, [])
        uv, texture = _texture(surface)
        material = resolve_material(look, folder, own=replace(_GREY, texture=texture))
        colored = look.base_color is not None or look.texture is not None or look.preset is not None
        if not colored and texture is None and b"TextureFile" in header:
            raise Refusal("its header names a TextureFile that is missing or damaged; add it")
        if look.texture is not None and surface.corner_uv is None:
            raise Refusal("has no texture coordinates; give it a material with a base_color")
    except Refusal as refusal:
        raise DatasetError(f"{file.path}: {refusal}") from refusal
    vertices_m = surface.vertices * UNITS_M[units.mesh]
    mesh = Mesh(
        vertices_m=vertices_m,
        faces=surface.faces,
        corner_uv=surface.corner_uv if colored else uv,
        corner_normals=crease_normals(vertices_m, surface.faces, CREASE_RAD),
    )
    return mesh, material, units


def _units(file: ModelFile, longest: float) -> _Units:
    """Return the units with which a mesh has the size of a part and the stated diameter.

    The diameter of a mesh is between 1 and sqrt(3) times the longest side of its bounding box.
    Units differ by larger factors, so a diameter determines the unit. Without a diameter, only
    `file.unit` is possible. `models_info.json` may have the meshes' unit instead of millimetres.

    Raises:
        Refusal: no possible unit gives the mesh such a size.
    """
    diameter = None if file.diameter_m is None else file.diameter_m / UNITS_M["mm"]
    others = [] if file.unit_stated or diameter is None else [u for u in UNITS_M if u != file.unit]
    for unit in (file.unit, *others):
        size_m = longest * UNITS_M[unit]
        for info in ("mm", unit):
            low_m, high_m = SIZE_M
            if diameter is not None:
                high_m = diameter * UNITS_M[info]
                low_m = max(low_m, 0.57 * high_m)
            if _within(size_m, low_m, high_m):
                return _Units(mesh=unit, info=info)
    low, high = SIZE_M if file.diameter_m is None else (0.57 * file.diameter_m, file.diameter_m)
    fits = [unit for unit, m in UNITS_M.items() if _within(longest * m, *SIZE_M)]
    whose = "a part has" if diameter is None else "models_info.json says"
    hint = f"; it seems to be in {fits[0]}" if diameter is None and len(fits) == 1 else ""
    raise Refusal(
        f"its longest side is {longest:.4g} {file.unit}, {whose} {low / UNITS_M['mm']:.4g} to "
        f"{high / UNITS_M['mm']:.4g} mm{hint}; give its unit with --unit, or export it in "
        f"{file.unit}"
    )


def _within(size_m: float, low_m: float, high_m: float) -> bool:
    return 0.99 * low_m <= size_m <= 1.01 * high_m


def _header(path: Path) -> bytes:
    """Return the header of a PLY file; empty for other formats."""
    with path.open("rb") as stream:
        return stream.read(4096).partition(b"end_header")[0] if path.suffix == ".ply" else b""


def _texture(
    surface: RawMesh,
) -> tuple[Float[np.ndarray, "f 3 2"] | None, UInt8[np.ndarray, "h w 3"] | None]:
    """Return the file's uv coordinates and texture, or a texture with one pixel per face colour."""
    if surface.texture is not None and surface.corner_uv is not None:
        return surface.corner_uv, surface.texture
    if surface.face_color is None:
        return surface.corner_uv, None
    count = len(surface.faces)
    side = math.ceil(math.sqrt(count))
    row, column = np.divmod(np.arange(count), side)
    texture = np.zeros((side * side, 3), np.uint8)
    texture[:count] = surface.face_color
    uv = np.stack([(column + 0.5) / side, 1 - (row + 0.5) / side], axis=-1)
    return np.repeat(uv[:, None], 3, axis=1), texture.reshape(side, side, 3)
