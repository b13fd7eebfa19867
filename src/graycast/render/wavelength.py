"""The scene in the light of the projector's wavelength, as the measuring camera sees it."""

from dataclasses import replace

from ..parts import Material
from ..scene import Scene


def at_projector_wavelength(scene: Scene) -> Scene:
    """The scene with every material that has a `projector_reflectance` in that grey.

    The very same scene where none has one, so that a renderer need not do the work twice.
    """
    materials = [scene.table, *(part.material for part in scene.parts)]
    materials += [surface.material for surface in scene.surfaces]
    if scene.bin is not None:
        materials.append(scene.bin.material)
    if all(material.projector_reflectance is None for material in materials):
        return scene
    return replace(
        scene,
        table=_grey(scene.table),
        parts=tuple(replace(part, material=_grey(part.material)) for part in scene.parts),
        surfaces=tuple(replace(one, material=_grey(one.material)) for one in scene.surfaces),
        bin=scene.bin and replace(scene.bin, material=_grey(scene.bin.material)),
    )


def _grey(material: Material) -> Material:
    reflectance = material.projector_reflectance
    if reflectance is None:
        return material
    return replace(material, base_color=(reflectance,) * 3, texture=None)
