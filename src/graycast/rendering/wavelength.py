"""Convert a scene to light of the projector's wavelength, as the measuring camera sees it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..world.parts import Material
from ..world.scene import Bin, Scene


def at_projector_wavelength(scene: Scene) -> Scene:
    """Return the scene with the grey `projector_reflectance` of each material that has one.

    Without such a material the same scene is returned, so the scene need not be rendered twice.
    """
    if all(material.projector_reflectance is None for material in _materials(scene)):
        return scene
    return _with_materials(scene, _grey)


def at_one_wavelength(scene: Scene) -> Scene:
    """Return the scene in grey, with each reflectance from the only band of the projector's light.

    Several bands are possible if every material is grey, because all bands are then equal.

    Raises:
        ValueError: the projector has several bands and a material has a colour.
    """
    shining = np.flatnonzero(np.array(scene.rig.band_weights) > 0)
    if len(shining) > 1:
        for material in _materials(scene):
            if not _is_grey(material):
                look = "a texture" if material.texture is not None else str(material.base_color)
                raise ValueError(
                    "patterns_per_render 3 needs light of one wavelength, but rig "
                    f"{scene.rig.name} shines in {len(shining)} bands, and a material has the "
                    f"colour {look}: set patterns_per_render to 1, or give the materials a "
                    "projector_reflectance"
                )
        return scene
    band = int(shining[0])
    return _with_materials(scene, lambda material: _in_band(material, band))


def refuse_layers(scene: Scene, renderer: str) -> None:
    """Refuse glass, films and mottled surfaces, for which only Mitsuba has our models."""
    for material in _materials(scene):
        present = {
            "transparent materials": material.transparent is not None,
            "a film over metal": material.film is not None,
            "mottled surfaces": material.mottle > 0,
        }
        for what, has in present.items():
            if has:
                raise ValueError(f"{renderer} cannot render {what}: use mitsuba")


def _materials(scene: Scene) -> list[Material]:
    materials = [part.material for part in scene.parts]
    materials += [surface.material for surface in scene.surfaces]
    if scene.bin is not None:
        materials += [scene.table, scene.bin.material]
        materials += [] if scene.bin.floor is None else [scene.bin.floor]
    return materials


def _with_materials(scene: Scene, change: Callable[[Material], Material]) -> Scene:
    return replace(
        scene,
        table=change(scene.table),
        parts=tuple(replace(part, material=change(part.material)) for part in scene.parts),
        surfaces=tuple(replace(one, material=change(one.material)) for one in scene.surfaces),
        bin=scene.bin and _with_bin_materials(scene.bin, change),
    )


def _with_bin_materials(box: Bin, change: Callable[[Material], Material]) -> Bin:
    floor = None if box.floor is None else change(box.floor)
    return replace(box, material=change(box.material), floor=floor)


def _is_grey(material: Material) -> bool:
    if material.texture is None:
        return len(set(material.base_color)) == 1
    return bool((material.texture == material.texture[..., :1]).all())


def _in_band(material: Material, band: int) -> Material:
    texture = material.texture
    if texture is not None:
        texture = np.repeat(texture[..., band : band + 1], 3, axis=-1)
    return replace(material, base_color=(material.base_color[band],) * 3, texture=texture)


def _grey(material: Material) -> Material:
    reflectance = material.projector_reflectance
    if reflectance is None:
        return material
    return replace(material, base_color=(reflectance,) * 3, texture=None)
