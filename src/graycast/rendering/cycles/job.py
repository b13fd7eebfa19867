"""Write the files that describe a scene for Cycles, and list its renders."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from ...rig.optics import Optics, fold_radius2, rays
from ...rig.pair import Rig, emission
from ...world.parts import Material, Mesh
from ...world.parts.part import corner_grain
from ...world.scene import (
    Environment,
    Layout,
    Quad,
    Scene,
    Sphere,
    bin_surfaces,
    lamp_quad,
    quad_mesh,
    table_quad,
)
from ..radiance import Patterns

Bands = tuple[float, float, float]
WHITE = -1  # This index in a frame's list of patterns means white.


@dataclass(frozen=True, slots=True, kw_only=True)
class Render:
    """One render. `levels` has pattern numbers: one for all bands, or one for each band."""

    name: str
    kind: str
    levels: tuple[int, ...] = ()

    def order(self, bands: Bands, seed: int) -> dict[str, Any]:
        """Return the render's entry in a job; `bands` has their shares of the projector's light."""
        # Three patterns share one render, one per colour channel. The scene is grey at the
        # projector's wavelength, so each channel gets all of the projector's light.
        shares = [1.0] * 3 if len(self.levels) == 3 else list(bands)
        return asdict(self) | {"bands": shares, "seed": seed}


def need_renders(pattern: Patterns) -> list[int]:
    """Return the numbers of patterns to render, without black (no light) and white (see `LOOK`)."""
    low, high = pattern.min(axis=(1, 2)), pattern.max(axis=(1, 2))
    plain = (low == high) & ((low == 0) | (low == 255))
    return np.flatnonzero(~plain).tolist()


def pattern_frames(numbers: Sequence[int], per_render: int) -> tuple[Render, ...]:
    """Return renders with one or three patterns each; white fills up the last render."""
    frames = []
    for first in range(0, len(numbers), per_render):
        levels = tuple(numbers[first : first + per_render])
        filled = levels + (WHITE,) * (per_render - len(levels))
        name = f"pattern_{levels[0]:03d}"
        frames.append(Render(name=name, kind="projected", levels=filled))
    return tuple(frames)


LOOK = (
    Render(name="white", kind="projected", levels=(WHITE,)),
    Render(name="ambient", kind="ambient"),
)
ALBEDO = (Render(name="albedo", kind="albedo"),)
TRUTH = tuple(Render(name=name, kind=name) for name in ("position", "normal", "instance"))


@dataclass(frozen=True, slots=True)
class _Placed:
    """A mesh and the poses of its copies; `instances` are layout indices + 1, or 0 if no part."""

    name: str
    mesh: Mesh
    material: Material
    T_world: Float[np.ndarray, "n 4 4"]
    instances: Int[np.ndarray, " n"]
    radiance: Bands | None = None


def write_job(
    folder: Path, scene: Scene, layout: Layout, pattern: Patterns, settings: Mapping[str, Any]
) -> None:
    """Write the input of `worker/` to a folder: `job.json`, arrays and pictures.

    `settings` has `samples`, `depth`, `denoise`, `device`, `threads`, and the entries of `frames`.
    """
    rig = scene.rig
    placed = _placed(scene, layout)
    spheres = [surface for surface in scene.surfaces if isinstance(surface, Sphere)]
    surfaces = [(one.material, one.radiance) for one in placed]
    surfaces += [(sphere.material, None) for sphere in spheres]
    np.save(folder / "pattern.npy", pattern)
    job = {
        "camera": _optics(rig.camera) | {"is_simple": is_simple(rig.camera)},
        "projector": _optics(rig.projector),
        "T_world_cam": scene.T_world_cam.tolist(),
        "T_world_proj": (scene.T_world_cam @ rig.T_cam_proj).tolist(),
        "intensity_w_sr": rig.intensity_w_sr,
        "field_tangent": _field_tangent(rig),
        "emission": emission(rig, np.arange(256, dtype=np.uint8)).tolist(),
        "materials": [_material(folder, i, *surface) for i, surface in enumerate(surfaces)],
        "meshes": [_mesh(folder, i, one) for i, one in enumerate(placed)],
        "spheres": [
            {"center_m": s.center_m, "radius_m": s.radius_m, "material": i}
            for i, s in enumerate(spheres, start=len(placed))
        ],
        "environment": _environment(scene.environment),
    }
    (folder / "job.json").write_text(json.dumps(job | dict(settings)), encoding="utf-8")


def is_simple(camera: Optics) -> bool:
    """Return whether Blender's own camera model suffices, without Open Shading Language."""
    square = camera.fx_px == camera.fy_px and camera.fill_factor == 1
    return square and camera.is_pinhole and not camera.has_distortion


def _optics(optics: Optics) -> dict[str, Any]:
    """Return optics for JSON, which has no infinity: an infinite focus or fold radius is None."""
    fold = fold_radius2(optics.distortion)
    return asdict(optics) | {
        "focus_m": None if math.isinf(optics.focus_m) else optics.focus_m,
        "fold_radius2": None if math.isinf(fold) else fold,
    }


def _field_tangent(rig: Rig) -> float:
    """Return the tangent of the largest angle to the axis at which light leaves the projector."""
    projector = rig.projector
    x = np.array([-0.5, projector.width_px - 0.5])
    y = np.array([-0.5, projector.height_px - 0.5])
    border = np.concatenate(
        [
            np.stack(np.meshgrid(x, np.linspace(y[0], y[1], 65)), axis=-1).reshape(-1, 2),
            np.stack(np.meshgrid(np.linspace(x[0], x[1], 65), y), axis=-1).reshape(-1, 2),
        ]
    )
    tangent = np.linalg.norm(rays(projector, border)[:, :2], axis=-1).max()
    # Light leaves the border of the lens at a larger angle than the middle of the lens.
    near_m = min(projector.focus_m, rig.near_m)
    return float(tangent + projector.aperture_m / near_m)


def _placed(scene: Scene, layout: Layout) -> list[_Placed]:
    placed = []
    for index, part in enumerate(scene.parts):
        instances = np.flatnonzero(layout.part_index == index)
        if len(instances):
            T_world = layout.T_world_part[instances]
            placed.append(_Placed(part.name, part.mesh, part.material, T_world, instances + 1))
    alone = [] if scene.bin is None else [*bin_surfaces(scene.bin)]
    for surface in (table_quad(scene), *scene.surfaces):
        if isinstance(surface, Quad):
            alone.append(("quad", quad_mesh(surface), surface.material))
    here, nothing = np.eye(4)[None], np.zeros(1, dtype=np.int64)
    placed += [_Placed(*one, here, nothing) for one in alone]
    for lamp in scene.lamps:
        quad = lamp_quad(lamp)
        mesh = quad_mesh(quad)
        placed.append(_Placed("lamp", mesh, quad.material, here, nothing, lamp.radiance))
    return placed


def _mesh(folder: Path, index: int, placed: _Placed) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "vertices_m": placed.mesh.vertices_m.astype(np.float32),
        "faces": placed.mesh.faces.astype(np.int32),
        "T_world": placed.T_world,
    }
    if placed.mesh.corner_uv is not None:
        arrays["corner_uv"] = placed.mesh.corner_uv.astype(np.float32)
    if placed.mesh.corner_normals is not None:
        arrays["corner_normals"] = placed.mesh.corner_normals.astype(np.float32)
    if (grain := placed.material.grooves) is not None:
        arrays["corner_grain"] = corner_grain(placed.mesh, grain).astype(np.float32)
    file = f"mesh_{index:03d}.npz"
    np.savez(folder / file, **arrays)
    return {
        "name": placed.name,
        "file": file,
        "material": index,
        "instances": placed.instances.tolist(),
    }


def _material(
    folder: Path, index: int, material: Material, radiance: Bands | None
) -> dict[str, Any]:
    texture = None
    if material.texture is not None:
        texture = f"texture_{index:03d}.png"
        Image.fromarray(np.asarray(material.texture)).save(folder / texture, compress_level=1)
    roughness_map = None
    if material.roughness_map is not None:
        roughness_map = f"roughness_{index:03d}.npy"
        np.save(folder / roughness_map, material.local_roughness[..., None])
    return {
        "base_color": material.base_color,
        "texture": texture,
        "roughness_map": roughness_map,
        "metallic": material.metallic,
        "roughness": material.roughness,
        "anisotropy": material.anisotropy,
        "diffuse": material.diffuse,
        "ior": material.ior,
        "radiance": radiance,
    }


def _environment(environment: Environment) -> dict[str, Any] | None:
    if environment.map_file is None and not any(environment.radiance):
        return None
    file = None if environment.map_file is None else str(environment.map_file.resolve())
    return asdict(environment) | {"map_file": file}
