"""Where the world is: parts stand on the bin's inner floor, which is z = 0, and inside its walls.

Leaves out: a turn about the vertical and a shift along the floor that keep the visible floor within
the walls; bins of meshes, but for what lies under their floor.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...base.frames import transform_points
from .evidence import Evidence

FLOOR_MM = 1.0  # Depth is off by less than 0.05 mm.
# The drop lets parts overlap, and convex pieces leave the surface by a share of the part's size.
SUNK_MM, SUNK_SHARE = 2.0, 0.02
OUTSIDE_SHARE, FLOOR_LEAST_PX = 0.01, 200


def world_problems(scene: Evidence) -> Iterator[str]:
    """A world whose floor is elsewhere; nothing where the configuration tells of no bin."""
    box = scene.claim.config.get("bin", {})
    inner_m, physics = box.get("inner_m"), scene.manifest_record.physics
    if inner_m is None or physics is None or physics.outside > 0:
        return  # parts beside the bin lie on the table
    yield from _sunk(scene)
    if box.get("mesh") is None:
        varied = (scene.plain.manifest.get("domain") or {}).get("bin") or {}
        size_mm = 1e3 * varied.get("size_factor", 1.0) * np.array(inner_m, dtype=float)
        yield from _floor_problems(scene, size_mm, 1e3 * float(box.get("wall_m", np.inf)))


def _sunk(scene: Evidence) -> Iterator[str]:
    T_world_cam = scene.plain.T_world_cam
    for i, part_mm in enumerate(scene.parts_mm):
        z_mm = transform_points(T_world_cam, part_mm)[:, 2]
        allowed_mm = SUNK_MM + SUNK_SHARE * float(np.linalg.norm(np.ptp(part_mm, axis=0)))
        if z_mm.min() < -allowed_mm:
            yield (
                f"instance {i} reaches {-z_mm.min():.1f} mm under the bin's floor: the pose of "
                "the world in scene_camera.json may be of another scene"
            )


def _floor_problems(
    scene: Evidence, size_mm: Float[np.ndarray, "3"], wall_mm: float
) -> Iterator[str]:
    """What is no part, and in sight: nothing under the floor, the floor within the walls."""
    depth, step_mm = scene.image["depth"], scene.plain.view.depth_scale
    rest = ~scene.on_part & (depth > 0) & scene.sampled
    ray, z_mm = scene.ray[rest], depth[rest] * step_mm
    point_mm = transform_points(scene.plain.T_world_cam, ray * z_mm[:, None])
    near_mm = min(FLOOR_MM, wall_mm / 3) + step_mm  # the table is a wall deeper
    over = (np.abs(point_mm[:, :2]) < size_mm[:2] / 2 - FLOOR_MM).all(axis=1)
    under = int((over & (point_mm[:, 2] < -near_mm)).sum())
    if under > OUTSIDE_SHARE * over.sum() + FLOOR_LEAST_PX / 10:
        yield (
            f"depth is under the bin's floor in {under} pixels: the pose of the world may be of "
            "another scene"
        )
    floor = np.abs(point_mm[:, 2]) < near_mm
    beyond = (np.abs(point_mm[:, :2]) > size_mm[:2] / 2 + FLOOR_MM).any(axis=1)
    outside = int((floor & beyond).sum())
    if outside > OUTSIDE_SHARE * floor.sum() + FLOOR_LEAST_PX / 10:
        yield (
            f"the bin's floor reaches beyond its walls in {outside} pixels: the pose of the world "
            "in scene_camera.json may be of another scene"
        )
    yield from _unsupported(scene, int(floor.sum()))


def _unsupported(scene: Evidence, floor_px: int) -> Iterator[str]:
    """Parts that hang in the air, in a bin whose floor is nowhere to be seen."""
    if floor_px >= FLOOR_LEAST_PX or not scene.parts_mm:
        return
    T_world_cam = scene.plain.T_world_cam
    low = [transform_points(T_world_cam, part)[:, 2].min() for part in scene.parts_mm]
    size = [float(np.linalg.norm(np.ptp(part, axis=0))) for part in scene.parts_mm]
    if min(low) > SUNK_MM + SUNK_SHARE * max(size) and "domain" not in scene.plain.manifest:
        yield (
            f"no part is nearer than {min(low):.1f} mm to the bin's floor: nothing supports the "
            "parts"
        )
