"""A small exact renderer in NumPy: planes and spheres in the projector's direct light.

The tests of other renderers compare half pixels, signs and radiometry with it; it is not fast. Rays
go through a regular grid of positions in each pixel, so there is no noise, and the seed is unused.

Limits: Lambertian `surfaces` only, without parts, bin, lamps or environment; path depth 1; sharp
lenses. The blur of other renderers is tested against closed forms.
"""

import math
from typing import final

import numpy as np
from jaxtyping import Float

from ..base.frames import inverse, pixel_grid, transform_points
from ..rig.optics import corner_share, project, rays, relative_illumination
from ..rig.pair import emission
from ..world.scene import Layout, Quad, Scene, Sphere
from .denoise import open_denoiser
from .radiance import (
    Denoiser,
    GroundTruth,
    Patterns,
    Quality,
    Radiance,
    Renderer,
    Rendering,
    refuse_other_size,
)
from .wavelength import at_projector_wavelength, refuse_layers

CLEARANCE_M = 1e-9  # Distance of a shadow ray's start from its surface; enough for float64.


@final
class ReferenceRenderer(Renderer):
    """The exact renderer; it raises ValueError for a scene beyond the limits of this module."""

    name, device = "reference", "cpu"

    def __init__(self) -> None:
        self.versions: dict[str, str] = {}
        self.denoiser: Denoiser = open_denoiser(self.device)

    def render(
        self, scene: Scene, layout: Layout, pattern: Patterns, *, quality: Quality, seed: int
    ) -> Rendering:
        _refuse_beyond_limits(scene, layout, pattern, quality)
        camera = scene.rig.camera
        side = math.isqrt(quality.samples)
        offsets = ((np.arange(side) + 0.5) / side - 0.5) * math.sqrt(camera.fill_factor)
        grid = pixel_grid(camera.height_px, camera.width_px)
        h, w = grid.shape[:2]
        measured = at_projector_wavelength(scene)
        weights, level = np.array(scene.rig.band_weights), emission(scene.rig, pattern)
        image, white = np.zeros((len(pattern), h, w)), np.zeros((h, w))
        placed = np.zeros((2, h, w))
        white_rgb, albedo = np.zeros((h, w, 3)), np.zeros((h, w, 3))
        share = relative_illumination(camera) / side**2
        for dy in offsets:
            for dx in offsets:
                place = grid + np.array([dx, dy])
                irradiance, base, place_px = _direct(scene, place)
                pixel = np.floor(place_px + 0.5).astype(int)
                surface = base if measured is scene else _direct(measured, place)[1]
                arriving = share * irradiance / math.pi
                white_rgb += arriving[..., None] * base * weights
                albedo += base / side**2
                mono = arriving * (surface @ weights)
                white += mono
                placed += mono * np.moveaxis(place_px, -1, 0)
                image += level[:, pixel[..., 1], pixel[..., 0]] * mono
        radiance = Radiance(
            pattern=image.astype(np.float32),
            white=white.astype(np.float32),
            ambient=np.zeros((h, w), dtype=np.float32),
            white_rgb=white_rgb.astype(np.float32),
            ambient_rgb=np.zeros((h, w, 3), dtype=np.float32),
            albedo=albedo.astype(np.float32),
            place_px=(placed / np.where(white > 0, white, np.nan)).astype(np.float32),
        )
        return Rendering(radiance=radiance, truth=_truth(scene, grid))


def _refuse_beyond_limits(
    scene: Scene, layout: Layout, pattern: np.ndarray, quality: Quality
) -> None:
    projector = scene.rig.projector
    refuse_other_size(pattern, projector)
    if scene.bin is not None or len(layout.part_index) or scene.lamps:
        raise ValueError(
            "the reference renderer renders only surfaces: remove parts, bin and lamps"
        )
    if any(scene.environment.radiance):
        raise ValueError("the reference renderer has no environment light: set it to 0, 0, 0")
    refuse_layers(scene, "the reference renderer")
    if quality.depth != 1 or math.isqrt(quality.samples) ** 2 != quality.samples:
        raise ValueError("the reference renderer needs depth 1 and a square number of samples")
    if not (scene.rig.camera.is_pinhole and projector.is_pinhole):
        raise ValueError("the reference renderer has no defocus: set aperture_m and psf_px to 0")
    if quality.denoise != "none":
        raise ValueError("the reference renderer has no noise: set denoise to 'none'")
    for surface in scene.surfaces:
        material = surface.material
        if material.metallic or material.specular or material.texture is not None:
            raise ValueError("the reference renderer is Lambertian: set metallic and specular to 0")


def _direct(scene: Scene, pixel: Float[np.ndarray, "h w 2"]) -> tuple:
    """Return irradiance from an all-white projector, base colour, and projector position [px].

    The position is 0 if a ray meets no point in the projector's picture.
    """
    rig = scene.rig
    direction, _, index, point = _first(scene, pixel)
    normal = _normals(scene, point, index)
    colors = [surface.material.base_color for surface in scene.surfaces]
    base = np.array([*colors, (0.0, 0.0, 0.0)])[index]  # The last colour is for index -1.
    T_world_proj = scene.T_world_cam @ rig.T_cam_proj
    in_projector = transform_points(inverse(T_world_proj), point)
    place_px = project(rig.projector, in_projector)
    size = np.array([rig.projector.width_px, rig.projector.height_px])
    with np.errstate(invalid="ignore"):
        inside = ((place_px >= -0.5) & (place_px < size - 0.5)).all(axis=-1)
        # A point is lit only by the active square of a pixel, and not by the gaps.
        aside = np.abs(place_px - np.floor(place_px + 0.5))
        inside &= (aside <= 0.5 * math.sqrt(rig.projector.fill_factor)).all(axis=-1)
    place_px = np.where(inside[..., None], place_px, 0.0)
    to_lens = T_world_proj[:3, 3] - point
    distance = np.linalg.norm(to_lens, axis=-1)
    cosine = (normal * to_lens).sum(axis=-1) / distance
    lit = (index >= 0) & inside & (cosine > 0) & ((normal * direction).sum(axis=-1) < 0)
    start = point + CLEARANCE_M * normal
    for surface in scene.surfaces:
        lit &= _meet(surface, start, T_world_proj[:3, 3] - start) >= 1
    irradiance = np.where(lit, rig.intensity_w_sr * cosine / distance**2, 0.0)
    if rig.projector.natural_vignetting:
        irradiance *= in_projector[..., 2] / distance
    if rig.projector.falloff:
        irradiance *= 1 - rig.projector.falloff * np.where(
            lit, corner_share(rig.projector, place_px), 0.0
        )
    return irradiance, base, place_px


def _first(scene: Scene, pixel: Float[np.ndarray, "h w 2"]) -> tuple:
    """Return direction, ray parameter, surface (or -1) and point of the first hit of each ray."""
    direction = rays(scene.rig.camera, pixel) @ scene.T_world_cam[:3, :3].T
    eye = scene.T_world_cam[:3, 3]
    t, index = _nearest(scene, eye, direction)
    point = eye + np.where(index >= 0, t, 1.0)[..., None] * direction
    return direction, t, index, point


def _nearest(scene: Scene, origin: np.ndarray, direction: np.ndarray) -> tuple:
    """Return the smallest positive ray parameter and the index of its surface, or -1."""
    best = np.full(direction.shape[:-1], np.inf)
    index = np.full(direction.shape[:-1], -1)
    for i, surface in enumerate(scene.surfaces):
        t = _meet(surface, origin, direction)
        nearer = t < best
        best, index = np.where(nearer, t, best), np.where(nearer, i, index)
    return best, index


def _meet(surface: Quad | Sphere, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the smallest positive t with `origin + t direction` on a surface, or infinity."""
    away = origin - np.array(surface.center_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(surface, Sphere):
            a = (direction**2).sum(axis=-1)
            b = (direction * away).sum(axis=-1)
            c = (away * away).sum(axis=-1) - surface.radius_m**2
            root = np.sqrt(b * b - a * c)
            near, far = (-b - root) / a, (-b + root) / a
            t = np.where(near > 0, near, far)
            return np.where(t > 0, t, np.inf)  # A miss is NaN, which compares as false.
        u, v = np.array(surface.half_u_m), np.array(surface.half_v_m)
        normal = np.cross(u, v)
        t = -(away @ normal) / (direction @ normal)
        place = away + t[..., None] * direction
        inside = (abs(place @ u) <= u @ u) & (abs(place @ v) <= v @ v)
        return np.where((t > 0) & inside, t, np.inf)


def _normals(scene: Scene, point: np.ndarray, index: np.ndarray) -> np.ndarray:
    normal = np.full(point.shape, np.nan)
    for i, surface in enumerate(scene.surfaces):
        if isinstance(surface, Sphere):
            n = (point - np.array(surface.center_m)) / surface.radius_m
        else:
            n = np.cross(surface.half_u_m, surface.half_v_m)
            n = np.broadcast_to(n / np.linalg.norm(n), point.shape)
        normal = np.where((index == i)[..., None], n, normal)
    return normal


def _truth(scene: Scene, grid: np.ndarray) -> GroundTruth:
    direction, t, index, point = _first(scene, grid)
    normal = _normals(scene, point, index)
    normal *= -np.sign((normal * direction).sum(axis=-1, keepdims=True))
    return GroundTruth(
        depth_m=np.where(index >= 0, t, np.nan),  # Rays have unit z, so t is the depth.
        normal=normal @ scene.T_world_cam[:3, :3],
        instance=np.full(index.shape, -1),
        amodal=(),
    )
