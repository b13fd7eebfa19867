"""A Graycast scene as a Mitsuba 3 scene: materials, merged part meshes, lights."""

from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ...base.errors import ConfigError
from ...world.parts import Material, Mesh
from ...world.parts.part import corner_grain
from ...world.scene import Lamp, Layout, Quad, Scene, bin_surfaces, lamp_quad, quad_mesh, table_quad
from ..bsdf.coated_diffuse import CoatedDiffuse
from ..bsdf.dielectric import Dielectric, ThinDielectric
from ..bsdf.filmed_conductor import FilmedConductor
from ..bsdf.mottle import PLACE, Mottled, places
from ..bsdf.rough_conductor import GRAIN, BrushedConductor, RoughConductor

mi.register_bsdf("coated_diffuse", CoatedDiffuse)
mi.register_bsdf("filmed_conductor", FilmedConductor)
mi.register_bsdf("rough_conductor", RoughConductor)
mi.register_bsdf("brushed_conductor", BrushedConductor)
mi.register_bsdf("solid_glass", Dielectric)
mi.register_bsdf("thin_glass", ThinDielectric)
mi.register_texture("mottled", Mottled)


@dataclass(frozen=True, slots=True)
class PartShape:
    """One kind of part, with all instances in one Mitsuba mesh, each with `faces_each` faces."""

    shape: mi.Mesh
    faces_each: int
    instances: np.ndarray  # Layout indices in the order of the mesh


@dataclass(frozen=True, slots=True)
class MitsubaWorld:
    """A scene in Mitsuba, with the meshes of its parts and its shiny shapes."""

    scene: mi.Scene
    part_shapes: tuple[PartShape, ...]
    shiny: tuple[mi.Shape, ...]
    glass: bool  # Whether anything is transparent
    thin: bool  # Whether there are thin walls of glass


def build(scene: Scene, layout: Layout) -> MitsubaWorld:
    world: dict[str, object] = {"type": "scene"}
    part_shapes, materials = [], {}  # `materials` has the material of each shape by its name.
    for index, part in enumerate(scene.parts):
        materials[f"part{index}"] = part.material
        instances = np.flatnonzero(layout.part_index == index)
        if len(instances) == 0:
            continue
        shape = _mesh(f"part{index}", part.mesh, part.material, layout.T_world_part[instances])
        part_shapes.append(PartShape(shape, len(part.mesh.faces), instances))
        world[f"part{index}"] = shape
    table = table_quad(scene)
    if scene.bin is not None and table is not None:
        for name, mesh, material in bin_surfaces(scene.bin):
            world[name] = _mesh(name, mesh, material, np.eye(4)[None])
            materials[name] = material
        world["table"], materials["table"] = _flat_surface("table", table), scene.table
    for index, surface in enumerate(scene.surfaces):
        name = f"surface{index}"
        materials[name] = surface.material
        if isinstance(surface, Quad):
            world[name] = _flat_surface(name, surface)
        else:
            world[name] = {
                "type": "sphere",
                "center": list(surface.center_m),
                "radius": surface.radius_m,
                "bsdf": _bsdf(surface.material),
            }
    environment = _environment(scene)
    if environment is not None:
        world["environment"] = environment
    for index, lamp in enumerate(scene.lamps):
        world[f"lamp{index}"] = _lamp(lamp)
    # In its optimisation, Mitsuba 3.9 merges rectangles of one material into a shape without
    # bounds. Shadow rays to the environment, which are as long as the scene, then end too early.
    loaded = mi.load_dict(world, optimize=False)
    shiny = {name for name, material in materials.items() if _is_shiny(material)}
    kinds = {material.transparent for material in materials.values()}
    return MitsubaWorld(
        scene=loaded,
        part_shapes=tuple(part_shapes),
        shiny=tuple(shape for shape in loaded.shapes() if shape.id() in shiny),
        glass=bool(kinds - {None}),
        thin="thin" in kinds,
    )


def _is_shiny(material: Material) -> bool:
    """Return whether a lamp's reflection is brighter than white paper: `F0 D / 4 > 1 / pi`."""
    if material.transparent is not None:
        return True
    coat = ((material.ior - 1) / (material.ior + 1)) ** 2 if material.specular else 0.0
    metal = 1.0 if material.texture is not None else max(material.base_color)
    mirrored = material.metallic * (1 - material.diffuse)
    normal = metal * mirrored + coat * (1 - material.metallic)
    films = material.film is not None and coat / (4 * material.film**4) > 1
    return films or normal / (4 * material.smoothest**4) > 1


def load_bsdf(material: Material) -> mi.BSDF:
    """Return a material as a Mitsuba BSDF, without a shape."""
    return mi.load_dict(_bsdf(material))


def _bsdf(material: Material) -> dict[str, object]:
    """Return a material as Mitsuba BSDFs; see docs/explanation/light.md, "Materials"."""
    if material.transparent is not None:
        return _glass(material)
    if material.metallic == 0:
        return _dielectric(material)
    if material.metallic == 1:
        return _conductor(material)
    return {
        "type": "blendbsdf",
        "weight": material.metallic,
        "dielectric": _dielectric(material),
        "conductor": _conductor(material),
    }


def _dielectric(material: Material) -> dict[str, object]:
    if material.specular == 0:
        return {"type": "diffuse", "reflectance": _reflectance(material)}
    return {
        "type": "coated_diffuse",
        "eta": material.ior,
        "reflectance": _reflectance(material),
    } | _width(material)


def _width(material: Material) -> dict[str, object]:
    if material.roughness_map is None:
        return {"alpha": material.roughness**2}
    picture = mi.Bitmap(material.local_roughness.astype(np.float32)[..., None])
    return {"roughness": {"type": "bitmap", "bitmap": picture, "raw": True}}


def _glass(material: Material) -> dict[str, object]:
    glass = {"eta": material.ior, "reflectance": _reflectance(material)}
    if material.transparent == "thin":
        return {"type": "thin_glass"} | glass
    return {"type": "solid_glass", "color_depth": material.color_depth_m} | glass


def _conductor(material: Material) -> dict[str, object]:
    if material.diffuse == 0:
        return _facets(material)
    return {
        "type": "blendbsdf",
        "weight": material.diffuse,
        "facets": _facets(material),
        "scattered": {"type": "diffuse", "reflectance": _reflectance(material)},
    }


def _facets(material: Material) -> dict[str, object]:
    reflectance = {"reflectance": _reflectance(material)}
    if material.film is not None:
        film = {"film_alpha": material.film**2, "eta": material.ior}
        return {"type": "filmed_conductor"} | _width(material) | film | reflectance
    if material.grooves is None:
        return {"type": "rough_conductor"} | _width(material) | reflectance
    along, across = material.alphas
    return {"type": "brushed_conductor", "alpha": along, "alpha_across": across} | reflectance


def _reflectance(material: Material) -> dict[str, object]:
    if material.texture is not None:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.array(material.texture)), "raw": False}
    color: dict[str, object] = {"type": "rgb", "value": list(material.base_color)}
    if material.mottle == 0:
        return color
    mottle = {"spread": material.mottle, "length": material.mottle_length_m}
    return mottle | {"type": "mottled", "base": color}


def _mesh(name: str, mesh: Mesh, material: Material, T_world_part: np.ndarray) -> mi.Mesh:
    """Return all copies of a mesh (in the world) as one shape, which is fastest for Embree."""
    n, corners = len(T_world_part), 3 * len(mesh.faces)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(material))
    shape = mi.Mesh(
        name,
        vertex_count=n * corners,
        face_count=n * len(mesh.faces),
        has_vertex_normals=mesh.corner_normals is not None,
        has_vertex_texcoords=mesh.corner_uv is not None,
        props=properties,
    )
    parameters = mi.traverse(shape)
    rotation, translation = T_world_part[:, :3, :3], T_world_part[:, None, :3, 3]
    corner = mesh.vertices_m[mesh.faces].reshape(-1, 3)
    placed = corner @ np.swapaxes(rotation, 1, 2) + translation
    parameters["vertex_positions"] = _flat(placed)
    parameters["faces"] = mi.UInt32(np.arange(n * corners, dtype=np.uint32))
    if mesh.corner_normals is not None:
        normal = mesh.corner_normals.reshape(-1, 3) @ np.swapaxes(rotation, 1, 2)
        parameters["vertex_normals"] = _flat(normal)
    if mesh.corner_uv is not None:
        uv = mesh.corner_uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]  # In Mitsuba, v points down.
        parameters["vertex_texcoords"] = _flat(np.broadcast_to(uv, (n, *uv.shape)))
    parameters.update()
    if (grain := material.grooves) is not None:
        along = corner_grain(mesh, grain).reshape(-1, 3) @ np.swapaxes(rotation, 1, 2)
        shape.add_attribute(GRAIN, 3, _flat(along))
    if material.mottle > 0:
        shape.add_attribute(PLACE, 3, _flat(places(corner, n, material.mottle_length_m)))
    return shape


def _flat(array: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(array, dtype=np.float32).ravel())


def _flat_surface(name: str, quad: Quad) -> mi.Mesh | dict[str, object]:
    """Return a rectangle, or a mesh if the surface varies over its area or has a grain.

    A picture on a rectangle would be upside down.
    """
    material = quad.material
    plain = material.texture is material.roughness_map is None and material.mottle == 0
    if plain and material.grooves is None:
        return _quad(quad)
    return _mesh(name, quad_mesh(quad), quad.material, np.eye(4)[None])


def _quad(quad: Quad) -> dict[str, object]:
    u, v = np.array(quad.half_u_m), np.array(quad.half_v_m)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] = u, v, quad.center_m
    matrix[:3, 2] = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix),
        "bsdf": _bsdf(quad.material),
    }


def _lamp(lamp: Lamp) -> mi.Shape:
    radiance = {"type": "rgb", "value": list(lamp.radiance)}
    shape = mi.load_dict(
        _quad(lamp_quad(lamp)) | {"emitter": {"type": "area", "radiance": radiance}}
    )
    # Literal positions would force a new compilation of the kernel for every scene.
    parameters = mi.traverse(shape)
    to_world = mi.Transform4f(parameters["to_world"].matrix)
    dr.make_opaque(to_world)
    parameters["to_world"] = to_world
    parameters.update()
    return shape


def _environment(scene: Scene) -> dict[str, object] | None:
    environment = scene.environment
    if environment.map_file is None:
        if not any(environment.radiance):
            return None
        return {
            "type": "constant",
            "radiance": {"type": "rgb", "value": list(environment.radiance)},
        }
    pixels = _map_pixels(environment.map_file)
    if environment.levelled:
        pixels = pixels / _mean_radiance(pixels, environment.map_file)
    pixels = pixels * np.array(environment.radiance, dtype=np.float32)
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], np.degrees(environment.rotation_rad))
    z_up = turned.rotate([1, 0, 0], 90.0)  # In Mitsuba's maps, y is up.
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": z_up}


def _map_pixels(file: Path) -> np.ndarray:
    threads = dr.thread_count()
    # Mitsuba 3.9 reads an EXR's rows on Dr.Jit's threads; with only one thread it waits forever.
    dr.set_thread_count(max(threads, 2))
    try:
        bitmap = mi.Bitmap(str(file))
    except RuntimeError as error:
        why = str(error).splitlines()[-1]
        raise ConfigError(
            f"environment map {file} cannot be read: {why}; "
            "give a latitude-longitude EXR or HDR picture"
        ) from error
    finally:
        dr.set_thread_count(threads)
    return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))


def _mean_radiance(pixels: np.ndarray, file: Path) -> np.float32:
    """Return the mean of a latitude-longitude map over solid angle and bands."""
    border = np.cos(np.linspace(0, np.pi, len(pixels) + 1))
    mean = float((border[:-1] - border[1:]) / 2 @ pixels.mean(axis=(1, 2), dtype=np.float64))
    if not 0 < mean < np.inf:
        raise ConfigError(
            f"environment map {file} has the mean radiance {mean}: remove values that are not "
            "finite, or give another map"
        )
    return np.float32(mean)
