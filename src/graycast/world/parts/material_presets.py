"""Named materials, such as `material: steel` in a configuration.

The colour of a pure metal is its reflectance at normal incidence in air,
`((n - 1)^2 + k^2) / ((n + 1)^2 + k^2)`, at 610, 550 and 465 nm, one for each band; `n` and `k` are
published and interpolated linearly over the wavelength. The colour of a nonmetal with a source is
the measured reflectance at the same wavelengths. A transparent material's colour is the share of
light that 10 mm transmit; its stated source is that of the index. Everything else is our choice,
including every roughness, anisotropy and scattered share, until the part's are known. Brushed and
ground metal has its grooves along x of the mesh, turned metal about z.

`surface` names the measured numbers of a finish. Classes of Ra do not give a roughness, because
`alpha` is about 1.4 times the standard deviation of the slope along a line, which also depends on
the distances between peaks.

`steel-oiled` uses the same formula with `n - 1.47` and `n + 1.47`, for metal in oil.

Leaves out: oxide films and scratches, which make real metal darker than a pure one; `steel`
describes such a surface. Densities, for `graycast new`, apply to the usual alloy or grade.
"""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from .part import Color, Grain, Material

OUR_CHOICE = "our choice"
_RA = "all our choice; usual {}: calqlata.com, Surface Finish"
# Brightness of the blasted plate in the white frame of an industrial scanner with pixels of 0.28
# mm: its scatter is 0.18 of its local mean, with a correlation of 0.18 to 0.27 between neighbours.
# On a surface with these two numbers, squares of 0.28 mm have the same scatter and correlation.
_BLASTED = (
    "mottle measured on one scanned plate: Open3DV, 3D_reconstruction_python; all else our choice"
)
Grooves = tuple[float, Grain | None]  # the anisotropy, and the direction of the grooves
_GROUND: Grooves = (0.6, Grain(axis=(1.0, 0.0, 0.0)))
_BRUSHED: Grooves = (0.8, Grain(axis=(1.0, 0.0, 0.0)))
_TURNED: Grooves = (0.8, Grain(axis=(0.0, 0.0, 1.0), turned=True))
_IRON = (0.525, 0.512, 0.500)
_STAINLESS = (0.599, 0.588, 0.573)
_ALUMINIUM = (0.910, 0.915, 0.921)
_OIL_INDEX = 1.47  # mineral oil
_OF_IRON = "Fe: Johnson & Christy, Phys. Rev. B 9, 5056, 1974"
_OF_STAINLESS = "ferritic steel: Karlsson & Ribbing, J. Appl. Phys. 53, 6340, 1982"
_OF_ALUMINIUM = "Al: Rakić, Appl. Opt. 34, 4755, 1995"
_OF_CHROMIUM = "Cr: Johnson & Christy, Phys. Rev. B 9, 5056, 1974"
_OF_COPPER = "Cu: Johnson & Christy, Phys. Rev. B 6, 4370, 1972"
_OF_BRASS = "Cu70Zn30: Querry, CRDC-CR-85034, 1985"
_OF_ZINC = "Zn: Werner et al., J. Phys. Chem. Ref. Data 38, 1013, 2009"
_OF_GLASS = "n: N-BK7, Schott AG, data sheet 2014"
_OF_PMMA = "n: Sultanova et al., Acta Phys. Pol. A 116, 585, 2009"
_MEASURED = "measured: physicallybased.info, "


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialPreset:
    """A material, the density of its substance [kg/m^3], and the source of its colour.

    `surface` names the other measured numbers and their source; without it, they are our choice.
    """

    material: Material
    density_kg_m3: float
    source: str
    surface: str = OUR_CHOICE


def _metal(
    color: Color,
    roughness: float,
    density_kg_m3: float,
    source: str,
    grooves: Grooves = (0.0, None),
) -> MaterialPreset:
    material = Material(
        base_color=color, metallic=1.0, roughness=roughness, anisotropy=grooves[0], grain=grooves[1]
    )
    return MaterialPreset(material=material, density_kg_m3=density_kg_m3, source=source)


def _finished(preset: MaterialPreset, surface: str, **changes: Any) -> MaterialPreset:
    """Return a preset with changed properties, and with the source of its surface's numbers."""
    return replace(preset, material=replace(preset.material, **changes), surface=surface)


def _oiled(color: Color, density_kg_m3: float, source: str) -> MaterialPreset:
    specular = _specular(_OIL_INDEX)
    material = Material(base_color=color, metallic=1.0, roughness=0.3, specular=specular, film=0.05)
    return MaterialPreset(material=material, density_kg_m3=density_kg_m3, source=source)


def _other(color: Color, roughness: float, density_kg_m3: float, source: str) -> MaterialPreset:
    material = Material(base_color=color, roughness=roughness)
    return MaterialPreset(material=material, density_kg_m3=density_kg_m3, source=source)


def _clear(color: Color, index: float, density_kg_m3: float, source: str) -> MaterialPreset:
    material = Material(base_color=color, specular=_specular(index), transparent="solid")
    return MaterialPreset(material=material, density_kg_m3=density_kg_m3, source=source)


def _specular(index: float) -> float:
    return ((index - 1) / (index + 1)) ** 2 / 0.08


def _grey(level: float) -> Color:
    return level, level, level


MATERIALS: Mapping[str, MaterialPreset] = {
    "steel": _metal(_grey(0.4), 0.4, 7850.0, OUR_CHOICE),
    "steel-polished": _metal(_IRON, 0.15, 7850.0, _OF_IRON),
    "steel-ground": _finished(
        _metal(_IRON, 0.3, 7850.0, _OF_IRON, _GROUND),
        _RA.format("Ra 0.1 to 1.6 um of grinding"),
    ),
    "steel-brushed": _metal(_IRON, 0.35, 7850.0, _OF_IRON, _BRUSHED),
    "steel-cast": _finished(
        _metal(_grey(0.3), 0.6, 7850.0, OUR_CHOICE),
        _RA.format("Ra 12.5 to 25 um of sand casting"),
        diffuse=0.5,
        mottle=0.15,
        mottle_length_m=0.0005,
    ),
    "steel-sheet": _finished(
        _metal(_IRON, 0.4, 7850.0, _OF_IRON),
        _RA.format("Ra 0.8 to 3.1 um of cold rolling"),
        diffuse=0.1,
        mottle=0.08,
        mottle_length_m=0.0002,
    ),
    "steel-oiled": _oiled((0.398, 0.383, 0.373), 7850.0, f"{_OF_IRON}; in oil of index 1.47"),
    "steel-turned": _metal(_IRON, 0.3, 7850.0, _OF_IRON, _TURNED),
    "stainless-polished": _metal(_STAINLESS, 0.15, 7700.0, _OF_STAINLESS),
    "stainless-brushed": _metal(_STAINLESS, 0.35, 7700.0, _OF_STAINLESS, _BRUSHED),
    "aluminium-cast": _metal(_ALUMINIUM, 0.55, 2700.0, _OF_ALUMINIUM),
    "aluminium-machined": _metal(_ALUMINIUM, 0.3, 2700.0, _OF_ALUMINIUM, _GROUND),
    "aluminium-turned": _metal(_ALUMINIUM, 0.25, 2700.0, _OF_ALUMINIUM, _TURNED),
    "aluminium-milled": _finished(
        _metal(_ALUMINIUM, 0.35, 2700.0, _OF_ALUMINIUM, _GROUND),
        _RA.format("Ra 0.8 to 6.3 um of milling"),
        diffuse=0.15,
        mottle=0.04,
        mottle_length_m=0.0005,
    ),
    "aluminium-blasted": _finished(
        _metal(_grey(0.65), 0.6, 2700.0, OUR_CHOICE),
        _BLASTED,
        diffuse=0.6,
        mottle=0.24,
        mottle_length_m=0.00016,
    ),
    "aluminium-anodised": _finished(
        _metal(_grey(0.6), 0.45, 2700.0, OUR_CHOICE),
        OUR_CHOICE,
        diffuse=0.4,
        mottle=0.06,
        mottle_length_m=0.0002,
    ),
    "chrome": _metal((0.552, 0.555, 0.558), 0.1, 7850.0, _OF_CHROMIUM),
    "copper": _metal((0.869, 0.624, 0.550), 0.25, 8940.0, _OF_COPPER),
    "brass": _metal((0.864, 0.789, 0.493), 0.25, 8530.0, _OF_BRASS),
    "zinc": _metal((0.873, 0.869, 0.859), 0.4, 7140.0, _OF_ZINC),
    "steel-black-oxide": _other(_grey(0.03), 0.4, 7850.0, OUR_CHOICE),
    "cast-iron": _other((0.027, 0.026, 0.027), 0.6, 7200.0, _MEASURED + "cast iron, 2026"),
    "rust": _other((0.152, 0.068, 0.026), 0.9, 7850.0, _MEASURED + "rust, 2026"),
    "plastic": _other(_grey(0.3), 0.5, 1100.0, OUR_CHOICE),
    "abs-black": _other(_grey(0.04), 0.5, 1050.0, OUR_CHOICE),
    "pom-black": _other(_grey(0.04), 0.35, 1410.0, OUR_CHOICE),
    "pom-white": _other(_grey(0.8), 0.35, 1410.0, OUR_CHOICE),
    "rubber": _other(_grey(0.023), 0.8, 1150.0, _MEASURED + "tire, 2022"),
    "cardboard": _other((0.310, 0.224, 0.128), 0.9, 700.0, _MEASURED + "cardboard, 2026"),
    "glass-clear": _clear((0.990, 0.995, 0.992), 1.5168, 2510.0, _OF_GLASS),
    "glass-green": _clear((0.35, 0.75, 0.30), 1.5168, 2510.0, _OF_GLASS),
    "pmma-clear": _clear(_grey(0.995), 1.4906, 1190.0, _OF_PMMA),
    "pet-clear": _clear(_grey(0.98), 1.575, 1380.0, OUR_CHOICE),
    "paper": _other((0.817, 0.802, 0.912), 0.9, 800.0, _MEASURED + "office paper, 2023"),
}


def material_preset(name: str) -> MaterialPreset:
    """Return the material preset with this name.

    Raises:
        ValueError: the name is not in `MATERIALS`.
    """
    if name in MATERIALS:
        return MATERIALS[name]
    plain = name.strip().lower().replace(" ", "-").replace("_", "-")
    near = [known for known in MATERIALS if plain in known] if plain else []
    if not near:
        near = difflib.get_close_matches(plain, MATERIALS, n=4)
        stem = next((known.partition("-")[0] for known in near), "")
        near += [known for known in MATERIALS if known.startswith(f"{stem}-") and known not in near]
    if not near:
        raise ValueError(f"no material has the name {name!r}; choose {', '.join(MATERIALS)}")
    raise ValueError(f"no material has the name {name!r}; did you mean {' or '.join(near)}?")
