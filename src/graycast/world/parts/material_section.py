"""Settings of a surface, and the material that they describe."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import UInt8
from PIL import Image, UnidentifiedImageError
from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator

from ...base.errors import ConfigError
from ...base.file_limits import refuse_large_picture
from ...base.settings import Positive, Settings, Share, Vector
from .material_presets import MATERIALS, material_preset
from .part import Color, Grain, Material, Mottle, Roughness, Transparent


def _known(name: str) -> str:
    material_preset(name)  # This call refuses unknown names.
    return name


PresetName = Annotated[
    str, AfterValidator(_known), WithJsonSchema({"type": "string", "enum": [*MATERIALS]})
]


def _named_axis(axis: Any) -> Any:
    """Return the direction of the mesh's axis x, y or z; check all other input as a vector."""
    names = ("x", "y", "z")
    return tuple(float(name == axis) for name in names) if axis in names else axis


def _unit(axis: Vector) -> Vector:
    """Return the unit vector along an axis, the form in which datasets store it."""
    if not any(axis):
        raise ValueError("an axis must have a direction, such as [0, 0, 1]")
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    return float(x), float(y), float(z)


Direction = Annotated[
    Vector,
    BeforeValidator(_named_axis, json_schema_input_type=Literal["x", "y", "z"] | Vector),
    AfterValidator(_unit),
]


class MaterialSection(Settings):
    """Settings that describe a surface in physical terms, or only the name of a material.

    A key that is left out has the value of the named material or the built-in part, or else its
    default.
    """

    preset: PresetName | None = Field(
        default=None,
        description="The name of a preset; each further key replaces one of its properties.",
    )
    base_color: Color | None = Field(
        default=None,
        description="The linear RGB reflectance, from 0 to 1 each; it replaces a built-in part's "
        "print. The default is [0.5, 0.5, 0.5].",
    )
    texture: Path | None = Field(
        default=None, description="A picture file in sRGB that replaces base_color."
    )
    metallic: Share | None = Field(
        default=None,
        description="The kind of surface: 0 is plastic, paint, wood or card; 1 is bare metal. The "
        "default is 0.",
    )
    roughness: Roughness | None = Field(
        default=None,
        description="The roughness: 0.05 is polished, 1 is matt, and 0.01 is the least. "
        "Transparent materials have no roughness. The default is 0.5.",
    )
    roughness_map: Path | None = Field(
        default=None,
        description="A grey picture file, read as numbers, that lowers roughness, such as in "
        "scratches: white is roughness itself, black is polished. It is mapped as a texture is.",
    )
    specular: Share | None = Field(
        default=None,
        description="The strength of the clear coat: 0 is Lambertian, 0.5 is a coat of refractive "
        "index 1.5. The default is 0.5.",
    )
    projector_reflectance: Share | None = Field(
        default=None,
        description="The reflectance at the projector's wavelength. Without this key, "
        "it follows from base_color and the projector's bands.",
    )
    anisotropy: Share | None = Field(
        default=None,
        description="The difference of roughness along and across the grooves of metal: 0 is none, "
        "0.8 is brushed. It needs grain or turned. The default is 0.",
    )
    grain: Direction | None = Field(
        default=None,
        description="The direction of the grooves of brushed metal: x, y or z of the mesh, or a "
        "direction. Of a bin or table, it is that of the world.",
    )
    turned: Direction | None = Field(
        default=None,
        description="The axis about which the grooves run, as on a lathe, in place of grain.",
    )
    turned_about_m: Vector | None = Field(
        default=None,
        description="A point on the axis of turned, in metres in the frame of the mesh. The "
        "default is its origin.",
    )
    diffuse: Share | None = Field(
        default=None,
        description="The share of a metal's light that is scattered in all directions, as by a "
        "blasted or an anodised surface: 0 scatters nothing, 1 is matt. It needs metallic above 0. "
        "The default is 0.",
    )
    mottle: Mottle | None = Field(
        default=None,
        description="The relative standard deviation of the reflectance between places of the "
        "surface, such as the grain of blasted or cast metal, up to 0.5. base_color is the mean. "
        "The default is 0.",
    )
    mottle_length_m: Positive | None = Field(
        default=None,
        description="The distance in metres at which the correlation of mottle has fallen to 1/e. "
        "Pixels that are larger average it away. The default is 0.0003.",
    )
    film: Roughness | None = Field(
        default=None,
        description="The roughness of a clear film over metal, such as oil or lacquer; its index "
        "follows from specular, and base_color is the reflectance in it. Without this key, metal "
        "is bare.",
    )
    transparent: Transparent | None = Field(
        default=None,
        description="Clear glass or plastic: solid, or thin for a mesh that is a wall without "
        "thickness. The index n follows from specular = 12.5 ((n - 1) / (n + 1))^2. Without this "
        "key, the surface is opaque.",
    )
    color_depth_m: Positive | None = Field(
        default=None,
        description="The way in metres through a solid that leaves base_color of the light; a thin "
        "wall does at each pass. The default is 0.01.",
    )

    @model_validator(mode="after")
    def _one_grain(self) -> "MaterialSection":
        if self.grain is not None and self.turned is not None:
            raise ValueError("grooves run along grain or about turned: remove one of them")
        if self.turned is None and self.turned_about_m is not None:
            raise ValueError("turned_about_m belongs to turned: add it, or remove turned_about_m")
        return self

    @property
    def files(self) -> dict[str, Path]:
        """The picture files that the section names, by key."""
        named = {"texture": self.texture, "roughness_map": self.roughness_map}
        return {key: path for key, path in named.items() if path is not None}

    def own_grain(self) -> Grain | None:
        if self.turned is not None:
            return Grain(axis=self.turned, turned=True, point_m=self.turned_about_m or (0, 0, 0))
        return None if self.grain is None else Grain(axis=self.grain)


def _of_name(material: Any) -> Any:
    return {"preset": material} if isinstance(material, str) else material


# A configuration states a material as a section or only as a name.
MaterialWords = Annotated[
    MaterialSection,
    BeforeValidator(_of_name, json_schema_input_type=PresetName | MaterialSection),
]


def resolve_material(
    section: MaterialSection, folder: Path, *, own: Material | None = None
) -> Material:
    """Return a material with its pictures, which are read from files.

    Args:
        own: values of the keys that are left out, unless the section names a preset; None is the
            default material.

    Raises:
        ConfigError: a picture cannot be read, or keys do not go together.
    """
    if section.preset is not None:
        own = material_preset(section.preset).material
    own = own or Material()
    changes: dict[str, Any] = section.model_dump(
        exclude_none=True, exclude={"preset", "grain", "turned", "turned_about_m"}
    )
    if (grain := section.own_grain()) is not None:
        changes["grain"] = grain
        if not changes.get("anisotropy", own.anisotropy):
            raise ConfigError("grain and turned need an anisotropy: add one, such as 0.8")
    if section.texture is not None:
        changes["texture"] = read_texture(folder / section.texture)
    elif section.base_color is not None:
        changes = {"texture": None, "projector_reflectance": None} | changes
    if section.roughness_map is not None:
        changes["roughness_map"] = read_roughness_map(folder / section.roughness_map)
    try:
        material = replace(own, **changes)
    except ValueError as error:
        raise ConfigError(f"material: {error}") from error
    if material.transparent != "solid" and section.color_depth_m is not None:
        raise ConfigError("material: color_depth_m belongs to transparent: solid; remove it")
    if material.mottle == 0 and section.mottle_length_m is not None:
        raise ConfigError("material: mottle_length_m belongs to mottle: add it, such as 0.1")
    return material


def material_words(material: Material, section: MaterialSection | None) -> dict[str, Any]:
    """Return the keys that describe a material, without its texture; `section` states its map."""
    if section is None or section.roughness_map is None:
        return material.words
    return material.words | {"roughness_map": str(section.roughness_map)}


def read_texture(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    return np.array(_opened(path, "texture").convert("RGB"))


def read_roughness_map(path: Path) -> UInt8[np.ndarray, "h w"]:
    picture = _opened(path, "roughness_map")
    level = np.array(picture.convert("RGB"))
    if picture.mode not in ("L", "LA", "P", "RGB", "RGBA") or np.ptp(level, axis=2).any():
        raise ConfigError(
            f"roughness_map {path} has colours, or is of the kind {picture.mode}: save it with 8 "
            "bits of grey"
        )
    return level[..., 0].copy()


def _opened(path: Path, key: str) -> Image.Image:
    try:
        refuse_large_picture(path, f"{key} {path}", ConfigError)
        with Image.open(path) as image:
            image.load()
            return image
    except (OSError, UnidentifiedImageError) as error:
        raise ConfigError(f"{key} {path}: {error}; give a PNG or JPEG picture") from error
