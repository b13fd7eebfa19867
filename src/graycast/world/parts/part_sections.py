"""Settings of a part, and the part that they describe."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import ConfigError
from ...base.frames import is_rigid
from ...base.settings import Positive, Settings, Vector
from .builtin import BUILTIN, builtin_part
from .material_section import Direction, MaterialWords, resolve_material
from .meshfile import load_part
from .part import Mesh, Part, Symmetry
from .symmetry import joined, shape_symmetry, turns_together

Unit = Literal["m", "cm", "mm", "inch"]


class ContinuousSymmetry(Settings):
    """Symmetry under any turn about an axis."""

    axis: Direction = Field(description="The axis: x, y or z of the mesh, or a direction.")
    point_m: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="A point on the axis, in metres in the frame of the mesh.",
    )


class TurnSymmetry(Settings):
    """Symmetry under `fold` equal turns, which together make a full circle about an axis."""

    axis: Direction = Field(description="The axis: x, y or z of the mesh, or a direction.")
    fold: int = Field(
        ge=2, le=120, description="The number of turns in a full circle: 2 is a half turn."
    )
    point_m: Vector | None = Field(
        default=None,
        description="A point on the axis, in metres in the frame of the mesh. Without this key, "
        "it is the middle of the bounding box.",
    )


class SymmetrySection(Settings):
    """Rigid motions that leave the part looking the same, in its own frame."""

    auto: bool = Field(
        default=False,
        description="Whether the symmetries of the shape are found. Use it if neither print nor "
        "colour tells the sides of the part apart.",
    )
    turns: tuple[TurnSymmetry, ...] = Field(
        default=(),
        description="The discrete symmetries as turns about axes, such as {axis: z, fold: 4}. "
        "What several turns make together is added.",
    )

    discrete: tuple[tuple[float, ...], ...] = Field(
        default=(),
        description="The discrete symmetries as 4x4 transforms: 16 numbers row by row, "
        "lengths in metres.",
    )
    continuous: tuple[ContinuousSymmetry, ...] = Field(
        default=(), description="The axes about which any turn leaves the part the same."
    )

    @model_validator(mode="after")
    def _sixteen(self) -> "SymmetrySection":
        for matrix in self.discrete:
            if len(matrix) != 16:
                raise ValueError(f"a discrete symmetry has {len(matrix)} numbers; give 16")
            if not is_rigid(np.reshape(matrix, (4, 4))):
                raise ValueError("a discrete symmetry is not a rotation and a translation")
        return self


class PartSection(Settings):
    """A kind of part: a built-in part, or a mesh file of your own."""

    builtin: str | None = Field(
        default=None, description=f"The built-in part: one of {', '.join(BUILTIN)}."
    )
    mesh: Path | None = Field(
        default=None, description="The OBJ, PLY, STL, GLB or STEP file of the part."
    )
    unit: Unit | None = Field(
        default=None,
        description="The unit of the mesh file. It must be stated if the sizes are not "
        "plausible in metres.",
    )
    scale: Positive = Field(
        default=1.0,
        description="The factor on the size of the file or of the built-in part; 1.005 "
        "makes parts 0.5 % larger.",
    )
    name: str | None = Field(
        default=None,
        description="The name of the part. Without this key, it is the name of the file.",
    )
    material: MaterialWords | None = Field(
        default=None,
        description="The material: a name, or a section. Keys change a built-in part's own "
        "material; a name replaces it, and so does either that of a file.",
    )
    density_kg_m3: Positive | None = Field(
        default=None,
        description="The density in kg/m^3; steel has 7800. Without this key, it is 1000 for a "
        "mesh.",
    )
    friction: float | None = Field(
        default=None,
        ge=0,
        description="The coefficient of friction. Without this key, it is 0.4 for a mesh.",
    )
    symmetry: SymmetrySection | None = Field(
        default=None, description="The motions that leave the part looking the same."
    )

    @model_validator(mode="after")
    def _one_source(self) -> "PartSection":
        if (self.builtin is None) == (self.mesh is None):
            raise ValueError("give either builtin or mesh, and not both")
        if self.builtin is not None and (self.unit or self.name or self.symmetry):
            raise ValueError("unit, name and symmetry belong to a mesh, not to a built-in part")
        return self


def resolve_part(section: PartSection, folder: Path) -> tuple[Part, tuple[str, ...]]:
    """Return a part, and notes on its mesh.

    Raises:
        ConfigError: an unknown built-in part, or a texture that cannot be read.
        MeshError: a mesh that cannot be a part.
    """
    part, noticed = _unscaled(section, folder)
    return (part if section.scale == 1 else part.scaled(section.scale)), noticed


def _unscaled(section: PartSection, folder: Path) -> tuple[Part, tuple[str, ...]]:
    look = section.material
    if section.builtin is not None:
        if section.builtin not in BUILTIN:
            raise ConfigError(f"no built-in part {section.builtin!r}: choose {', '.join(BUILTIN)}")
        own = builtin_part(section.builtin)
        if look is not None and look.files and own.mesh.corner_uv is None:
            raise ConfigError(
                f"the built-in part {section.builtin} has no texture coordinates: remove "
                f"{' and '.join(look.files)}, or choose another part"
            )
        return replace(
            own,
            material=own.material
            if look is None
            else resolve_material(look, folder, own=own.material),
            density_kg_m3=section.density_kg_m3 or own.density_kg_m3,
            friction=own.friction if section.friction is None else section.friction,
        ), ()
    assert section.mesh is not None  # A section states a mesh or a built-in part.
    part, noticed = load_part(
        folder / section.mesh,
        name=section.name,
        unit=section.unit,
        material=None if look is None else resolve_material(look, folder),
        density_kg_m3=section.density_kg_m3 or 1000.0,
        friction=0.4 if section.friction is None else section.friction,
    )
    return replace(part, symmetry=_symmetry(section.symmetry, part.mesh)), noticed


def _symmetry(section: SymmetrySection | None, mesh: Mesh) -> Symmetry:
    if section is None:
        return Symmetry()
    middle_m = tuple(mesh.bounds_m.mean(axis=0).tolist())
    turns = [(turn.axis, turn.point_m or middle_m, turn.fold) for turn in section.turns]
    stated = Symmetry(
        discrete=(
            *turns_together(turns),
            *(np.reshape(matrix, (4, 4)) for matrix in section.discrete),
        ),
        continuous=tuple((s.axis, s.point_m) for s in section.continuous),
    )
    return joined(stated, shape_symmetry(mesh)) if section.auto else stated
