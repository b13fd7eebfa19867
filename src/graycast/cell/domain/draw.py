"""Draw the random values of a domain: all differences of a scene from the cell, as JSON.

Each section has its own random stream, so changes of one section do not affect other sections.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import ConfigError
from ...base.streams import DOMAIN
from ...rig.optics import Optics, rays
from ...world.scene import Lamp, Scene, bin_of
from .domain_sections import (
    AdaptedSection,
    CameraRanges,
    CameraTolerance,
    ColorRanges,
    DistractorRanges,
    EnvironmentRanges,
    LampRanges,
    PartRanges,
    RandomizedSection,
    SurfaceRanges,
)
from .named_files import Domain
from .vary import lamp_of, shared_out, with_rig_and_bin

PARTS_MAX = 255  # largest number of parts in one drop
LAMP_TRIES = 1000

Streams = Mapping[str, np.random.Generator]


def draw(
    domain: Domain,
    scene: Scene,
    counts: tuple[int, ...],
    rng: np.random.Generator,
    *,
    scanners: Sequence[str] = (),
) -> dict[str, Any]:
    """Draw the values from which `vary` makes a scene.

    Args:
        scene: the cell.
        counts: number of parts of each kind.
        rng: a random generator for this call only; it must be able to `spawn`.
        scanners: names of the other scanners that are not mounted on the first; the record's
            `cameras` has a deviation for each.

    Raises:
        ConfigError: every lamp in these ranges blocks the view, or the rig is not above the bin.
    """
    streams = dict(zip(DOMAIN, rng.spawn(len(DOMAIN)), strict=True))
    further = dict(zip(scanners, streams["camera"].spawn(len(scanners)), strict=True))
    if isinstance(domain.section, AdaptedSection):
        tolerances = domain.section.camera
        record = _draw_adapted(domain.section, scene, streams)
        own = {name: _mounting_error(tolerances, each) for name, each in further.items()}
    else:
        ranges = domain.section.camera
        record = _draw_randomized(domain, domain.section, scene, counts, streams)
        own = {} if ranges is None else {n: _camera(ranges, each) for n, each in further.items()}
    return record | ({"cameras": own} if own else {})


def _draw_adapted(section: AdaptedSection, scene: Scene, streams: Streams) -> dict[str, Any]:
    box, lamp, part = section.bin, section.lamps, section.parts
    return {
        "kind": "adapted",
        "camera": _mounting_error(section.camera, streams["camera"]),
        "bin": {
            "offset_m": _off(streams["bin"], box.position_m, 2),
            "turn_rad": _off(streams["bin"], np.radians(box.rotation_deg), 1)[0],
        },
        "lamps": [
            {
                "offset_m": _off(streams["lamps"], lamp.position_m, 3),
                "level": 1 + _off(streams["lamps"], lamp.level, 1)[0],
            }
            for _ in scene.lamps
        ],
        "environment": {"level": 1 + _off(streams["environment"], lamp.environment_level, 1)[0]},
        "parts": {
            one.name: {
                "brightness": 1 + _off(streams["parts"], part.reflectance, 1)[0],
                "roughness": _off(streams["parts"], part.roughness, 1)[0],
            }
            for one in scene.parts
        },
    }


def _draw_randomized(
    domain: Domain,
    section: RandomizedSection,
    scene: Scene,
    counts: tuple[int, ...],
    streams: Streams,
) -> dict[str, Any]:
    record: dict[str, Any] = {"kind": "randomized"}
    if section.camera is not None:
        record["camera"] = _camera(section.camera, streams["camera"])
    if section.bin is not None:
        record["bin"] = {
            "size_factor": _log_uniform(streams["bin"], section.bin.size_factor),
            **_surface(section.bin, domain.bin_textures, streams["bin"]),
        }
    if section.lamps is not None:
        moved = with_rig_and_bin(domain, scene, record)
        rng, cones = streams["lamps"], views(moved)
        count = int(rng.integers(*section.lamps.count, endpoint=True))
        record["lamps"] = [_lamp(section.lamps, moved, cones, rng) for _ in range(count)]
    if section.environment is not None:
        record["environment"] = _environment(section.environment, domain, streams["environment"])
    if section.table is not None:
        record["table"] = _surface(section.table, domain.table_textures, streams["table"])
    if section.parts is not None:
        kinds = (*scene.parts, *domain.distractors)
        record["parts"] = {kind.name: _part(section.parts, streams["parts"]) for kind in kinds}
    record["count_share"] = _uniform(streams["counts"], section.count_share)
    room = PARTS_MAX - sum(shared_out(counts, record["count_share"]))
    record["distractors"] = _distractors(section.distractors, domain, room, streams["distractors"])
    return record


def _mounting_error(camera: CameraTolerance, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "offset_m": _off(rng, camera.position_m, 3),
        "rotation_rad": _off(rng, np.radians(camera.rotation_deg), 3),
    }


def _camera(camera: CameraRanges, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "distance_factor": _log_uniform(rng, camera.distance_factor),
        "tilt_rad": float(np.radians(_uniform(rng, camera.tilt_deg))),
        "azimuth_rad": float(np.radians(_uniform(rng, camera.azimuth_deg))),
        "roll_rad": float(np.radians(_uniform(rng, camera.roll_deg))),
        "shift_m": rng.uniform(*camera.shift_m, 3).tolist(),
    }


def _environment(
    ranges: EnvironmentRanges, domain: Domain, rng: np.random.Generator
) -> dict[str, Any]:
    level = _log_uniform(rng, ranges.radiance)
    if not domain.maps:
        temperature_k = _uniform(rng, ranges.color_temperature_k)
        return {"radiance": level, "color_temperature_k": temperature_k}
    return {
        "radiance": level,
        "map": _any_of(domain.maps, rng),
        "rotation_rad": float(np.radians(_uniform(rng, ranges.rotation_deg))),
    }


def _part(ranges: PartRanges, rng: np.random.Generator) -> dict[str, Any]:
    values = {
        "brightness": _log_uniform(rng, ranges.brightness),
        "tint": [_log_uniform(rng, ranges.tint) for _ in range(3)],
        "roughness": _uniform(rng, ranges.roughness),
        "metallic": _uniform(rng, ranges.metallic),
    }
    repainted, color = rng.random() < ranges.repainted_share, _color(ranges.color, rng)
    return values | {"color": color if repainted else None}


def _surface(
    ranges: SurfaceRanges, textures: tuple[Path, ...], rng: np.random.Generator
) -> dict[str, Any]:
    values = {
        "color": _color(ranges.color, rng),
        "roughness": _uniform(rng, ranges.roughness),
        "metallic": float(rng.random() < ranges.metal_share),
        "texture_size_m": _log_uniform(rng, ranges.texture_size_m),
    }
    textured = rng.random() < ranges.textured_share and len(textures) > 0
    return values | {"texture": _any_of(textures, rng) if textured else None}


def _color(ranges: ColorRanges, rng: np.random.Generator) -> dict[str, float]:
    return {name: _uniform(rng, getattr(ranges, name)) for name in ColorRanges.model_fields}


def _distractors(
    ranges: DistractorRanges | None, domain: Domain, room: int, rng: np.random.Generator
) -> dict[str, int]:
    """Draw the number of distractors of each kind; all kinds are equally likely."""
    kinds = domain.distractors
    if ranges is None or not kinds:
        return {}
    low, high = ranges.count
    total = min(int(rng.integers(low, high + 1)), room)
    numbers = rng.multinomial(total, np.full(len(kinds), 1 / len(kinds)))
    return {kind.name: int(n) for kind, n in zip(kinds, numbers, strict=True)}


# --- lamps -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cone:
    """A cone of view or light: all directions up to `half_angle_rad` from its axis."""

    apex_m: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    half_angle_rad: float

    def meets(self, center_m: Float[np.ndarray, "3"], radius_m: float) -> bool:
        """Return whether a ball overlaps the cone."""
        away_m = center_m - self.apex_m
        distance_m = float(np.linalg.norm(away_m))
        if distance_m <= radius_m:
            return True
        aside_rad = np.arccos(np.clip(away_m @ self.axis / distance_m, -1, 1))
        return bool(aside_rad < self.half_angle_rad + np.arcsin(radius_m / distance_m))


def views(scene: Scene) -> tuple[_Cone, ...]:
    """Return the cones around the fields of view of camera and projector."""
    T_world_proj = scene.T_world_cam @ scene.rig.T_cam_proj
    both = ((scene.T_world_cam, scene.rig.camera), (T_world_proj, scene.rig.projector))
    return tuple(
        _Cone(apex_m=T[:3, 3], axis=T[:3, 2], half_angle_rad=_widest_rad(lens)) for T, lens in both
    )


def _widest_rad(lens: Optics) -> float:
    """Return the angle [rad] between the lens's axis and the picture corner farthest from it."""
    x, y = (np.array([-0.5, n - 0.5]) for n in (lens.width_px, lens.height_px))
    corner = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return float(np.arctan(np.nanmax(np.linalg.norm(rays(lens, corner)[:, :2], axis=-1))))


def in_the_way(lamp: Lamp, scene: Scene, cones: tuple[_Cone, ...]) -> bool:
    """Return whether the ball around a lamp overlaps the ball around the bin or a view's cone."""
    center_m, reach_m = np.array(lamp.center_m), lamp.size_m * math.sqrt(0.5)
    low_m, high_m = bin_of(scene).bounds_m
    bin_reach_m = np.linalg.norm(high_m - low_m) / 2
    if np.linalg.norm(center_m - (low_m + high_m) / 2) < reach_m + bin_reach_m:
        return True
    return any(cone.meets(center_m, reach_m) for cone in cones)


def _lamp(
    ranges: LampRanges, scene: Scene, cones: tuple[_Cone, ...], rng: np.random.Generator
) -> dict[str, float]:
    """Draw a lamp that is outside the bin and outside the cones of camera and projector."""
    for _ in range(LAMP_TRIES):
        height = rng.uniform(*np.sin(np.radians(ranges.elevation_deg)))  # uniform on the sphere
        values = {
            "distance_m": _uniform(rng, ranges.distance_m),
            "elevation_rad": float(np.arcsin(height)),
            "azimuth_rad": float(np.radians(_uniform(rng, ranges.azimuth_deg))),
            "size_m": _log_uniform(rng, ranges.size_m),
            "irradiance": _log_uniform(rng, ranges.irradiance),
            "color_temperature_k": _uniform(rng, ranges.color_temperature_k),
        }
        if not in_the_way(lamp_of(values, scene), scene, cones):
            return values
    raise ConfigError(
        f"domain.lamps: {LAMP_TRIES} consecutive lamps were inside the bin or in the rig's view: "
        "give a lower elevation_deg, a larger distance_m or a smaller size_m"
    )


# --- distributions -----------------------------------------------------------------------------


def _uniform(rng: np.random.Generator, span: tuple[float, float]) -> float:
    return float(rng.uniform(*span))


def _log_uniform(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Draw a value that is uniform in its logarithm."""
    if span[0] == span[1]:
        return float(span[0])  # exact, unlike exp(log(x))
    return float(np.exp(rng.uniform(*np.log(span))))


def _off(rng: np.random.Generator, most: float, n: int) -> list[float]:
    """Draw `n` values, each uniform between `-most` and `most`."""
    return rng.uniform(-most, most, n).tolist()


def _any_of(files: tuple[Path, ...], rng: np.random.Generator) -> str:
    return files[int(rng.integers(len(files)))].name
