"""Make a scene from a cell and a record of random values; this step is not random.

Values that are not in the record come from the cell, so the record is complete.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError
from ...base.frames import axis_rotation, inverse, rigid, transform_points
from ...rig.pair import frame_in_camera, standoff_m
from ...world.parts import Part
from ...world.parts.material_section import read_texture
from ...world.scene import Bin, Environment, Lamp, Scene, bin_of
from .looks import color_of, light_of, material_of, retouched
from .named_files import Domain

Vector = tuple[float, float, float]
Record = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """One scene of a domain, ready to drop and render, and the record from which it was made."""

    scene: Scene
    counts: tuple[int, ...]  # number of each of the scene's parts
    record: Record


def vary(domain: Domain, scene: Scene, counts: tuple[int, ...], record: Record) -> Variation:
    """Return the scene for a record, which comes from `draw` or from a manifest.

    Args:
        domain: the record's domain, which has the files that the record names.
        scene: the cell.
        counts: number of parts of each kind.

    Raises:
        ConfigError: the rig is not above the bin, or a file is missing or cannot be read.
    """
    if record["kind"] == "adapted":
        return Variation(scene=_adapted(scene, record), counts=counts, record=record)
    numbers = record["distractors"]
    return Variation(
        scene=_randomized(domain, scene, record),
        counts=(
            *shared_out(counts, record["count_share"]),
            *(numbers.get(part.name, 0) for part in domain.distractors),
        ),
        record=record,
    )


def moved_place(scene: Scene, record: Record, scanner: str) -> Float[np.ndarray, "4 4"]:
    """Return the `T_world_cam` of a scanner with the deviations of a record.

    Args:
        scene: the cell in front of this scanner, as configured.
        scanner: its name; without its own deviation in the record, the first scanner's applies.
    """
    camera = record.get("cameras", {}).get(scanner, record.get("camera"))
    if record["kind"] == "adapted":
        return _tolerated(scene.T_world_cam, camera, record["bin"])
    return moved_rig(scene, camera) if camera is not None else scene.T_world_cam


def shared_out(counts: tuple[int, ...], share: float) -> tuple[int, ...]:
    """Return a share of each number, rounded; at least 1 if the number is not 0."""
    return tuple(max(1, round(share * n)) if n else 0 for n in counts)


# --- adapted -----------------------------------------------------------------------------------


def _adapted(scene: Scene, record: Record) -> Scene:
    """Return the adapted scene. Values without a deviation stay exactly the same."""
    box = record["bin"]
    lamps = tuple(
        replace(
            lamp,
            center_m=_sum(lamp.center_m, off["offset_m"]),
            radiance=_times(lamp.radiance, off["level"]),
        )
        for lamp, off in zip(scene.lamps, record["lamps"], strict=True)
    )
    environment = replace(
        scene.environment,
        radiance=_times(scene.environment.radiance, record["environment"]["level"]),
    )
    T_world_cell = _world_of(box)
    if T_world_cell is not None:
        lamps = tuple(_carried(lamp, T_world_cell) for lamp in lamps)
        turned_rad = environment.rotation_rad - box["turn_rad"]
        environment = replace(environment, rotation_rad=turned_rad)
    parts = tuple(
        replace(part, material=retouched(part.material, **record["parts"][part.name]))
        for part in scene.parts
    )
    return replace(
        scene,
        T_world_cam=_tolerated(scene.T_world_cam, record["camera"], box),
        lamps=lamps,
        environment=environment,
        parts=parts,
    )


def _tolerated(
    T_world_cam: Float[np.ndarray, "4 4"], camera: Record, box: Record
) -> Float[np.ndarray, "4 4"]:
    T_world_cell = _world_of(box)
    if any(camera["offset_m"]) or any(camera["rotation_rad"]):
        turn = np.eye(3)
        for axis, angle_rad in zip("xyz", camera["rotation_rad"], strict=True):
            turn = turn @ axis_rotation(axis, angle_rad)
        T_world_cam = rigid(T_world_cam[:3, :3] @ turn, T_world_cam[:3, 3] + camera["offset_m"])
    return T_world_cam if T_world_cell is None else T_world_cell @ T_world_cam


def _world_of(box: Record) -> Float[np.ndarray, "4 4"] | None:
    """Return the inverse of the bin's motion (the world is fixed to the bin); None if it is 0."""
    if not any(box["offset_m"]) and not box["turn_rad"]:
        return None
    return inverse(rigid(axis_rotation("z", box["turn_rad"]), np.array([*box["offset_m"], 0.0])))


def _carried(lamp: Lamp, T: Float[np.ndarray, "4 4"]) -> Lamp:
    center, target = transform_points(T, np.array([lamp.center_m, lamp.target_m])).tolist()
    return replace(lamp, center_m=tuple(center), target_m=tuple(target))


def _sum(point: Vector, offset_m: list[float]) -> Vector:
    x, y, z = (a + b for a, b in zip(point, offset_m, strict=True))
    return x, y, z


def _times(radiance: Vector, factor: float) -> Vector:
    red, green, blue = (factor * level for level in radiance)
    return red, green, blue


# --- randomized --------------------------------------------------------------------------------


def _randomized(domain: Domain, scene: Scene, record: Record) -> Scene:
    varied = with_rig_and_bin(domain, scene, record)
    if "lamps" in record:
        lamps = tuple(lamp_of(values, varied) for values in record["lamps"])
        varied = replace(varied, lamps=lamps)
    if "environment" in record:
        environment = _environment(domain, record["environment"])
        varied = replace(varied, environment=environment)
    if "table" in record:
        look = record["table"]
        varied = replace(
            varied,
            table=material_of(look, _texture(domain.table_textures, look)),
            table_texture_m=look["texture_size_m"],
        )
    parts = (*scene.parts, *domain.distractors)
    if "parts" in record:
        parts = tuple(_retouched_part(part, record["parts"][part.name]) for part in parts)
    return replace(varied, parts=parts)


def with_rig_and_bin(domain: Domain, scene: Scene, record: Record) -> Scene:
    """Return the cell with a record's rig and bin, which limit where lamps may be.

    Raises:
        ConfigError: camera or projector is not above the bin's rim.
    """
    box, T_world_cam = bin_of(scene), scene.T_world_cam
    if "camera" in record:
        T_world_cam = moved_rig(scene, record["camera"])
    if "bin" in record:
        box = _changed_bin(box, record["bin"], _texture(domain.bin_textures, record["bin"]))
    varied = replace(scene, T_world_cam=T_world_cam, bin=box)
    T_world_proj = T_world_cam @ scene.rig.T_cam_proj
    lowest_m = float(min(T_world_cam[2, 3], T_world_proj[2, 3]))
    if lowest_m <= box.inner_m[2]:
        raise ConfigError(
            f"domain.camera: camera or projector comes to z = {lowest_m:.3f} m, below the bin's "
            f"rim at {box.inner_m[2]:.3f} m: narrow tilt_deg or distance_factor"
        )
    return varied


def moved_rig(scene: Scene, values: Record) -> Float[np.ndarray, "4 4"]:
    """Return `T_world_cam` of the rig moved about its target; angles add to those of `place`."""
    T_cam_rig = frame_in_camera(scene.rig)
    T_world_rig = scene.T_world_cam @ T_cam_rig
    rotation, middle = T_world_rig[:3, :3], T_world_rig[:3, 3]
    target = _aim_point(T_world_rig, scene)
    about_baseline = rotation @ axis_rotation("x", values["tilt_rad"]) @ rotation.T
    turn = axis_rotation("z", values["azimuth_rad"]) @ about_baseline
    moved = rigid(
        turn @ rotation @ axis_rotation("z", values["roll_rad"]),
        target + values["shift_m"] + values["distance_factor"] * (turn @ (middle - target)),
    )
    return moved @ inverse(T_cam_rig)


def _aim_point(T_world_rig: Float[np.ndarray, "4 4"], scene: Scene) -> Float[np.ndarray, "3"]:
    """Return where the rig's axis meets the plane at a third of the bin's height, its usual target.

    If that plane is beyond twice the rig's far limit, return the point where its axes are closest.
    """
    middle, axis = T_world_rig[:3, 3], T_world_rig[:3, 2]
    drop_m = bin_of(scene).inner_m[2] / 3 - middle[2]
    looks_down = drop_m < 0 and axis[2] < -1e-3
    distance_m = drop_m / axis[2] if looks_down else np.inf
    if distance_m > 2 * scene.rig.far_m:
        distance_m = standoff_m(scene.rig)
    return middle + distance_m * axis


def _changed_bin(box: Bin, values: Record, texture: np.ndarray | None) -> Bin:
    factor, mesh = values["size_factor"], box.mesh
    x, y, z = (factor * size for size in box.inner_m)
    return replace(
        box,
        inner_m=(x, y, z),
        mesh=None if mesh is None else replace(mesh, vertices_m=factor * mesh.vertices_m),
        own_texture=False,
        material=material_of(values, texture),
        floor=None,
        texture_size_m=values["texture_size_m"],
    )


def lamp_of(values: Record, scene: Scene) -> Lamp:
    """Return a lamp with a given direction and distance from the bin, and irradiance at the bin.

    The radiance follows from the formula for a small lamp: L = E d^2 / a^2. A lamp with an edge of
    half its distance gives 8 % less irradiance than stated.
    """
    target = (0.0, 0.0, bin_of(scene).inner_m[2] / 3)
    around, up = values["azimuth_rad"], values["elevation_rad"]
    away = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    x, y, z = (target + values["distance_m"] * away).tolist()
    level = values["irradiance"] * (values["distance_m"] / values["size_m"]) ** 2
    return Lamp(
        center_m=(x, y, z),
        target_m=target,
        size_m=values["size_m"],
        radiance=_times(light_of(values["color_temperature_k"]), level),
    )


def _environment(domain: Domain, values: Record) -> Environment:
    level = values["radiance"]
    if "map" not in values:
        return Environment(radiance=_times(light_of(values["color_temperature_k"]), level))
    return Environment(
        radiance=(level, level, level),
        map_file=_file(domain.maps, values["map"]),
        rotation_rad=values["rotation_rad"],
        levelled=True,
    )


def _retouched_part(part: Part, values: Record) -> Part:
    change = dict(values)
    color, material = change.pop("color"), part.material
    if color is not None:
        red, green, blue = (min(material.reflectance_limit, level) for level in color_of(color))
        material = replace(
            material, base_color=(red, green, blue), texture=None, projector_reflectance=None
        )
        change |= {"brightness": 1.0, "tint": (1.0, 1.0, 1.0)}
    return replace(part, material=retouched(material, **change))


def _texture(files: tuple[Path, ...], values: Record) -> np.ndarray | None:
    return None if values["texture"] is None else read_texture(_file(files, values["texture"]))


def _file(files: tuple[Path, ...], name: str) -> Path:
    matches = [file for file in files if file.name == name]
    if not matches:
        raise ConfigError(f"the domain has no file {name}: put it back into its folder")
    return matches[0]
