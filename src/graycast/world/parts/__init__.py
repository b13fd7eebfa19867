"""The parts: built-in ones and the user's own, as meshes with materials."""

from .builtin import BUILTIN, builtin_part
from .material_presets import MATERIALS, material_preset
from .mesh_formats import files_of_mesh
from .meshfile import load_mesh, load_part
from .part import Grain, Material, Mesh, Part, Symmetry, glass_notes
from .size import full_count, mass_kg, mass_text, size_notes, size_text, unusual_size_note

__all__ = [
    "BUILTIN",
    "MATERIALS",
    "Grain",
    "Material",
    "Mesh",
    "Part",
    "Symmetry",
    "builtin_part",
    "files_of_mesh",
    "full_count",
    "glass_notes",
    "load_mesh",
    "load_part",
    "mass_kg",
    "mass_text",
    "material_preset",
    "size_notes",
    "size_text",
    "unusual_size_note",
]
