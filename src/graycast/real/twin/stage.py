"""Scenes of a cell under light, rendered once for every code: what a twin's search looks at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from ...cell import Cell
from ...frames import pixel_grid, transform_points
from ...optics import rays
from ...pattern import CodeSpec
from ...render import GroundTruth, Radiance, Renderer
from ...rig import grey_levels
from ...scanner import Scanner
from ...scanner import scan as shoot
from ...scene import Scene, bin_of
from ...simulate import lay_out
from ..realism import DepthScan

OnStage = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lit:
    """One scene's light for each code, and which pixels show the bin."""

    radiance: dict[CodeSpec, Radiance]
    is_bin: Bool[np.ndarray, "h w"]
    truth: DepthScan  # perfect depth


def light_scenes(
    cell: Cell,
    codes: Sequence[CodeSpec],
    scene_ids: Sequence[int],
    *,
    seed: int,
    renderer: Renderer,
    quality,
    on_stage: OnStage,
) -> tuple[Lit, ...]:
    """Drop and render each scene once, all codes in one pass.

    Raises:
        DropError: the parts of a scene did not come to an acceptable rest.
    """
    rig = cell.scanner.rig
    shown = [replace(cell.scanner, code=code).light_code() for code in codes]
    stack = [one.render(lambda share: grey_levels(rig, share)) for one in shown]
    ends = np.cumsum([len(one) for one in stack])
    lit = []
    for scene_id in scene_ids:
        on_stage(f"scene {scene_id}: parts fall")
        scene, layout = lay_out(cell, scene_id, seed=seed)
        on_stage(f"scene {scene_id}: {renderer.name} renders {int(ends[-1])} patterns")
        rendering = renderer.render(
            scene, layout, np.concatenate(stack), quality=quality, seed=seed + scene_id
        )
        whole = rendering.radiance
        lit.append(
            Lit(
                radiance={
                    code: replace(whole, pattern=whole.pattern[end - len(one) : end].copy())
                    for code, one, end in zip(codes, stack, ends, strict=True)
                },
                is_bin=_bin_pixels(scene, rendering.truth),
                truth=DepthScan(
                    name=f"scene {scene_id}, perfect",
                    depth_m=rendering.truth.depth_m.astype(np.float64),
                    K=rig.camera.K,
                ),
            )
        )
    return tuple(lit)


def scan_lit(
    lit: Lit, scanner: Scanner, *, bin_factor: float, seed: int, name: str
) -> DepthScan | None:
    """What the scanner makes of a scene whose bin reflects so many times what was rendered.

    The bin's own light is scaled, direct and indirect alike; what it sends to the parts is not.
    That holds while the bin is dark. None where nothing is lit.
    """
    radiance = lit.radiance[scanner.code]
    if bin_factor != 1:
        factor = np.where(lit.is_bin, np.float32(bin_factor), np.float32(1))
        radiance = replace(
            radiance,
            pattern=radiance.pattern * factor,
            white=radiance.white * factor,
            ambient=radiance.ambient * factor,
        )
    try:
        shot = shoot(scanner, radiance, seed=seed)
    except ValueError:
        return None
    depth_m = shot.depth.depth_m.astype(np.float64)
    return DepthScan(name=name, depth_m=depth_m, K=scanner.rig.camera.K)


def _bin_pixels(scene: Scene, truth: GroundTruth) -> Bool[np.ndarray, "h w"]:
    """What is no part and lies over the table, within the bin's outline."""
    ray = rays(scene.rig.camera, pixel_grid(*truth.depth_m.shape))
    point = transform_points(scene.T_world_cam, (ray * truth.depth_m[..., None]).reshape(-1, 3))
    box = bin_of(scene)
    reach = np.array(box.inner_m[:2]) / 2 + 0.03
    with np.errstate(invalid="ignore"):
        inside = (np.abs(point[:, :2]) <= reach).all(axis=1)
    return (truth.instance < 0) & inside.reshape(truth.depth_m.shape)
