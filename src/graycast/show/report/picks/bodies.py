"""Meshes and poses of bodies for the page."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....robot.pick.replay import Replay
from ....robot.pick.solids import joined
from ....world.parts import Mesh
from ....world.scene import bin_mesh
from ..page.packing import pack_bytes

UPRIGHT = 0.9  # A face points up if the cosine of its angle to the vertical is larger.
TABLE_BEYOND_M = 0.25


def open_bin(replay: Replay) -> Mesh:
    """Return the bin without its outer sides, so that its inside is visible from anywhere."""
    whole = bin_mesh(replay.cell.box)
    normal, centre = whole.face_normal, whole.vertices_m[whole.faces].mean(axis=1)
    low, high = whole.bounds_m
    middle = np.array([*(low + high)[:2] / 2, high[2]])
    inwards = np.einsum("fi,fi->f", normal, middle - centre) > 0
    return Mesh(vertices_m=whole.vertices_m, faces=whole.faces[inwards | (normal[:, 2] > UPRIGHT)])


def table(replay: Replay) -> Mesh:
    """Return the part of the table that carries the bin, the robot and the placed parts."""
    box, config = replay.cell.box, replay.cell.config
    low, high = box.bounds_m
    stands = np.array([low, high, config.robot.base_m, config.picking.place_m])[:, :2]
    (x0, y0), (x1, y1) = stands.min(axis=0) - TABLE_BEYOND_M, stands.max(axis=0) + TABLE_BEYOND_M
    z = -box.floor_m - 1e-3  # The table is below the bin's own floor.
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return Mesh(vertices_m=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]))


def look(replay: Replay) -> dict[str, Any]:
    """Return the viewpoint: opposite the robot, slightly from the side where parts are placed."""
    config, box = replay.cell.config, replay.cell.box
    base, place = np.array(config.robot.base_m[:2]), np.array(config.picking.place_m[:2])
    home = zip(replay.limbs, replay.T_world_limb(replay.robot.home), strict=True)
    top_m = float(joined(home).bounds_m[1, 2])  # Tall arms need a more distant view.
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


def packed_mesh(mesh: Mesh) -> dict[str, Any]:
    """Return vertices [mm] and faces in the form that the page unpacks."""
    mesh = replace(mesh, corner_uv=None, corner_normals=None)
    return {
        "vertices": _packed((1e3 * mesh.vertices_m).astype("<f4")),
        "faces": _packed(mesh.faces.astype("<u4")),
    }


def placed(T: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 7"]:
    """Return poses as (x, y, z) [mm] and a unit quaternion (x, y, z, w)."""
    flat = T.reshape(-1, 4, 4)
    turn = Rotation.from_matrix(flat[:, :3, :3]).as_quat()
    return np.column_stack([1e3 * flat[:, :3, 3], turn]).reshape(*T.shape[:-2], 7)


def packed_places(T: Float[np.ndarray, "t limbs 4 4"]) -> str:
    """Return poses over time; consecutive quaternions have no jump of sign."""
    places = placed(T)
    turn = places[..., 3:]
    flips = np.where((turn[1:] * turn[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    turn[1:] *= np.cumprod(flips, axis=0)[..., None]
    return _packed(places.reshape(len(places), -1).astype("<f4"))


def _packed(values: np.ndarray) -> str:
    return pack_bytes(np.ascontiguousarray(values).view(np.uint8))
