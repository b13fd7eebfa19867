"""Poses of bodies for the page, and the table and the viewpoint of the page's 3D view."""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....robot.pick.results.replay import Replay
from ....robot.pick.tool.solids import joined
from ....world.parts import Mesh
from ..page.walls import packed_values

TABLE_BEYOND_M = 0.25


def table(replay: Replay) -> Mesh:
    """Return the area of the table under the bin, the robot and the place of released parts."""
    box, config = replay.cell.box, replay.cell.config
    low, high = box.bounds_m
    stands = np.array([low, high, config.robot.base_m, config.picking.place_m])[:, :2]
    (x0, y0), (x1, y1) = stands.min(axis=0) - TABLE_BEYOND_M, stands.max(axis=0) + TABLE_BEYOND_M
    z = -box.floor_m - 1e-3  # just below the bin's own floor, so that both stay visible
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return Mesh(vertices_m=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]))


def look(replay: Replay) -> dict[str, Any]:
    """Return the viewpoint: opposite the robot, somewhat towards the place of released parts."""
    config, box = replay.cell.config, replay.cell.box
    base, place = np.array(config.robot.base_m[:2]), np.array(config.picking.place_m[:2])
    home = zip(replay.limbs, replay.T_world_limb(replay.robot.home), strict=True)
    top_m = float(joined(home).bounds_m[1, 2])  # The view is more distant for a tall arm.
    far = max(float(np.linalg.norm(base)), 0.75 * top_m, 0.3)
    aside = -base / max(float(np.linalg.norm(base)), 1e-9)
    aside = aside + 0.6 * place / max(float(np.linalg.norm(place)), 1e-9)
    high_m = float(box.bounds_m[1, 2])
    return {
        "middle": (1e3 * np.array([*(base + place) / 4, 0.45 * top_m])).tolist(),
        "bin": (1e3 * np.array([0.0, 0.0, high_m / 2])).tolist(),
        "yaw": float(np.arctan2(aside[1], aside[0])),
        "reach": 1e3 * far,
    }


def placed(T: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 7"]:
    """Return poses as (x, y, z) [mm] and a unit quaternion (x, y, z, w)."""
    flat = T.reshape(-1, 4, 4)
    turn = Rotation.from_matrix(flat[:, :3, :3]).as_quat()
    return np.column_stack([1e3 * flat[:, :3, 3], turn]).reshape(*T.shape[:-2], 7)


def packed_places(T: Float[np.ndarray, "t limbs 4 4"]) -> str:
    """Return poses over time; the signs of consecutive quaternions are continuous."""
    places = placed(T)
    turn = places[..., 3:]
    flips = np.where((turn[1:] * turn[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    turn[1:] *= np.cumprod(flips, axis=0)[..., None]
    return packed_values(places.reshape(len(places), -1).astype("<f4"))
