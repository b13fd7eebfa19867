"""Scenes of a cell whose light is rendered once and reused in all trials of a search."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...base.frames import inverse, transform_points
from ...base.progress import ProgressMeter
from ...camera.scanner import Scanner
from ...camera.scanner import scan as shoot
from ...cell.config import quality_of
from ...cell.resolve import Cell
from ...rendering import GroundTruth, Radiance, Renderer
from ...rig.optics import corner_share, points, project
from ...rig.pair import Rig, grey_levels
from ...rig.pattern import CodeSpec
from ...world.scene import Scene, bin_of
from ..realism import DepthScan
from .restaging import layout_of

_STEEP, _STEP = 0.6, 10.0  # least depth gradients [m/m] of a steep side and of a depth step


@dataclass(frozen=True, slots=True, kw_only=True)
class BinLook:
    """A bin's look relative to the configured look: two factors, and a change of roughness."""

    color: float = 1.0
    gloss: float = 1.0
    rougher: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LitScene:
    """One scene's light for each code, and a mask of the pixels that show the bin.

    `coats` has the light of a black bin, which reflects only by its coat, for each addition to the
    configured roughness; it is empty if the gloss is not fitted. `corner_share` is the result of
    `in_projector_corner`, and `falloff` is the projector's.
    """

    radiance: dict[CodeSpec, Radiance]
    coats: Mapping[float, dict[CodeSpec, Radiance]] = field(default_factory=dict)
    is_bin: Bool[np.ndarray, "h w"]
    truth: DepthScan  # exact depth
    corner_share: Float[np.ndarray, "h w"] | float = 0.0
    falloff: float = 0.0


def light_scenes(
    cell: Cell,
    scenes: Sequence[Scene],
    codes: Sequence[CodeSpec],
    *,
    seed: int,
    renderer: Renderer,
    rougher: Sequence[float],
    names: Sequence[str],
    progress: ProgressMeter,
) -> tuple[LitScene, ...]:
    """Render each scene from `restage` with the patterns of all codes, and again with black bins.

    Args:
        rougher: additions to the roughness of black bins; empty renders no black bin.
        names: names of the scenes, for the progress report.
    """
    rig = cell.scanner.rig
    light_codes = [replace(cell.scanner, code=code).light_code() for code in codes]
    stack = [one.render(lambda share: grey_levels(rig, share)) for one in light_codes]
    ends = np.cumsum([len(one) for one in stack])
    lit = []
    for number, (scene, name) in enumerate(zip(scenes, names, strict=True)):
        progress.stage(f"{name}: {renderer.name} renders {int(ends[-1])} patterns")
        renderings = [
            renderer.render(
                one,
                layout_of(scene),
                np.concatenate(stack),
                quality=quality_of(cell.config.render),
                seed=seed + number,
            )
            for one in (scene, *(with_black_bin(scene, more) for more in rougher))
        ]
        split = [
            {
                code: replace(
                    one.radiance, pattern=one.radiance.pattern[end - len(own) : end].copy()
                )
                for code, own, end in zip(codes, stack, ends, strict=True)
            }
            for one in renderings
        ]
        truth = renderings[0].truth
        lit.append(
            LitScene(
                radiance=split[0],
                coats=dict(zip(rougher, split[1:], strict=True)),
                is_bin=_bin_pixels(scene, truth),
                truth=DepthScan(
                    name=f"{name}, perfect",
                    depth_m=truth.depth_m.astype(np.float64),
                    K=rig.camera.K,
                ),
                corner_share=in_projector_corner(rig, truth.depth_m),
                falloff=rig.projector.falloff or 0.0,
            )
        )
    return tuple(lit)


def in_projector_corner(rig: Rig, depth_m: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Return `optics.corner_share` at the projector pixel of each camera pixel; 0 without depth."""
    point = transform_points(inverse(rig.T_cam_proj), points(rig.camera, depth_m))
    share = corner_share(rig.projector, project(rig.projector, point))
    return np.nan_to_num(np.minimum(share, 1.0)).astype(np.float32)


def with_black_bin(scene: Scene, rougher: float) -> Scene:
    """Return the scene with a black bin of the same gloss, whose roughness is `rougher` higher."""
    box = bin_of(scene)
    black = {
        name: replace(
            material,
            base_color=(0.0, 0.0, 0.0),
            projector_reflectance=None,
            roughness=material.roughness + rougher,
        )
        for name in ("material", "floor")
        if (material := getattr(box, name)) is not None
    }
    return replace(scene, bin=replace(box, **black))


def missing_places(
    lit: Sequence[LitScene], real: Sequence[DepthScan]
) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Return masks in which missing depth is counted: visible pixels, steep sides, blind pixels.

    `visible` has the pixels at which any real scan has depth. `blind` has the pixels of the bin at
    which no real scan has depth, for example because of too little light. The sides are named by
    their position in the picture. They have only visible pixels, because a bin differs from its
    model and its rim may hide a wall. Their slope is that of the farthest depth over all scenes,
    so that parts hide little of them. All scenes must have the same camera and the same bin.
    """
    visible = np.any([scan.valid for scan in real], axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Where no scene shows the bin, all is NaN.
        far_m = np.nanmax([np.where(one.is_bin, one.truth.depth_m, np.nan) for one in lit], axis=0)
    K = lit[0].truth.K
    down, right = np.gradient(far_m)
    across, along = right * K[0, 0] / far_m, down * K[1, 1] / far_m
    with np.errstate(invalid="ignore"):  # Comparisons with NaN are false.
        steep = (np.hypot(across, along) > _STEEP) & (np.hypot(across, along) < _STEP) & visible
        sideways = np.abs(across) > np.abs(along)
        return {
            "visible": visible,
            "left": steep & sideways & (across > 0),
            "right": steep & sideways & (across < 0),
            "upper": steep & ~sideways & (along > 0),
            "lower": steep & ~sideways & (along < 0),
            "blind": ~visible & np.any([one.is_bin for one in lit], axis=0),
        }


def scan_lit(
    lit: LitScene, scanner: Scanner, look: BinLook, *, seed: int, name: str
) -> DepthScan | None:
    """Scan a scene whose bin has another look; return None if no pixel is lit.

    All light from the bin's pixels is scaled, direct and indirect, but not the light that the bin
    sends to the parts. This is a good approximation for a dark bin. Gloss is assumed to be
    proportional to the coat's reflectance at normal incidence, which is wrong at grazing incidence.
    Light under the coat is assumed not to depend on the coat: with half of the coat, 6 % of the
    light is missing. Between rendered coats, light is interpolated linearly over the roughness.
    The projector's falloff at a pixel's own point dims all its light, even from other surfaces.
    """
    radiance = lit.radiance[scanner.named_code()]
    if look != BinLook():
        coats = {more: coat[scanner.named_code()] for more, coat in lit.coats.items()}
        light: dict[str, Any] = {
            name: _with_look(
                getattr(radiance, name),
                {more: getattr(coat, name) for more, coat in coats.items()},
                lit.is_bin,
                look,
            )
            for name in ("pattern", "white", "ambient")
        }
        albedo = np.where(
            lit.is_bin[..., None], np.float32(look.color) * radiance.albedo, radiance.albedo
        )
        radiance = replace(radiance, **light, albedo=albedo)
    falloff = scanner.rig.projector.falloff or 0.0
    if falloff != lit.falloff:
        left = (1 - falloff * lit.corner_share) / (1 - lit.falloff * lit.corner_share)
        dimmed = {name: getattr(radiance, name) * left for name in ("pattern", "white")}
        radiance = replace(radiance, **dimmed)
    try:
        shot = shoot(scanner, radiance, seed=seed)
    except ValueError:
        return None
    depth_m = shot.depth.depth_m.astype(np.float64)
    return DepthScan(name=name, depth_m=depth_m, K=scanner.rig.camera.K)


def _with_look(
    light: Float[np.ndarray, "*n h w"],
    coats: Mapping[float, Float[np.ndarray, "*n h w"]],
    is_bin: Bool[np.ndarray, "h w"],
    look: BinLook,
) -> Float[np.ndarray, "*n h w"]:
    """Return the light after the bin's look is changed to `look`; other pixels are unchanged.

    At the bin's pixels, the light is multiplied by `look.color`, and the light reflected by the
    bin's glossy coat is added for the required gloss and roughness.

    Args:
        coats: light reflected only by the coat, for each increase in roughness.
    """
    weight = _weights(sorted(coats), look)
    scaled = np.float32(look.color) * light
    for more, share in weight.items():
        if share:
            scaled += np.float32(share) * coats[more]
    if coats:
        np.maximum(scaled, 0, out=scaled)  # Noise of the renderings may make values negative.
    return np.where(is_bin, scaled, light)


def _weights(rougher: Sequence[float], look: BinLook) -> dict[float, float]:
    """Return the weight of each coat: its share of the new look minus its share in scaled light."""
    return {
        more: look.gloss * float(np.interp(look.rougher, rougher, own))
        - look.color * float(np.interp(0.0, rougher, own))
        for more, own in zip(rougher, np.eye(len(rougher)), strict=True)
    }


def _bin_pixels(scene: Scene, truth: GroundTruth) -> Bool[np.ndarray, "h w"]:
    """Return a mask of the pixels that show no part and are within the bin's outline."""
    point_cam = points(scene.rig.camera, truth.depth_m).reshape(-1, 3)
    point = transform_points(scene.T_world_cam, point_cam)
    box = bin_of(scene)
    reach = np.array(box.inner_m[:2]) / 2 + 0.03
    with np.errstate(invalid="ignore"):
        inside = (np.abs(point[:, :2]) <= reach).all(axis=1)
    return (truth.instance < 0) & inside.reshape(truth.depth_m.shape)
