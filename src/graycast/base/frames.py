"""Rigid transforms, rotations, the pixel grid and units of length.

`T_a_b` maps coordinates of frame b to frame a, so neighbours cancel:
`T_world_cam @ T_cam_part` is `T_world_part`. Transforms are float64 `(4, 4)` arrays.
World z is up. A camera or projector looks along its z; x is right, y is down.
"""

import numpy as np

from .array_types import Float

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}


def rigid(
    rotation: Float[np.ndarray, "3 3"], translation_m: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return the transform `p -> rotation @ p + translation_m`."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


def inverse(T_a_b: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 4 4"]:
    """Return the inverse of a rigid transform, `T_b_a` for `T_a_b`, by transposing its rotation."""
    rotation = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a = np.zeros_like(T_a_b)
    T_b_a[..., :3, :3] = rotation
    T_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, T_a_b[..., :3, 3])
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def transform_points(
    T_a_b: Float[np.ndarray, "4 4"], point_b: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Transform points from frame b to frame a."""
    return point_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def is_rigid(T: np.ndarray, tolerance: float = 1e-6) -> bool:
    """Return whether T is a rigid transform: orthonormal, determinant +1, last row 0 0 0 1."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return False
    rotation = T[:3, :3]
    orthonormal = np.abs(rotation @ rotation.T - np.eye(3)).max() < tolerance
    return bool(orthonormal and np.linalg.det(rotation) > 0 and np.array_equal(T[3], [0, 0, 0, 1]))


def axis_rotation(axis: str, angle_rad: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about a coordinate axis 'x', 'y' or 'z' by the right-hand rule."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    rotation = np.eye(3)
    rotation[j, j] = rotation[k, k] = cosine
    rotation[j, k], rotation[k, j] = -sine, sine
    return rotation


def rotation_from_quaternion(xyzw: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """Return the rotation matrices of unit quaternions given as (x, y, z, w)."""
    unit = xyzw / np.linalg.norm(xyzw, axis=-1, keepdims=True)
    x, y, z, w = (unit[..., i] for i in range(4))
    R = np.empty((*xyzw.shape[:-1], 3, 3))
    R[..., 0, 0] = 1 - 2 * (y * y + z * z)
    R[..., 0, 1] = 2 * (x * y - z * w)
    R[..., 0, 2] = 2 * (x * z + y * w)
    R[..., 1, 0] = 2 * (x * y + z * w)
    R[..., 1, 1] = 1 - 2 * (x * x + z * z)
    R[..., 1, 2] = 2 * (y * z - x * w)
    R[..., 2, 0] = 2 * (x * z - y * w)
    R[..., 2, 1] = 2 * (y * z + x * w)
    R[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return R


def random_quaternions(n: int, rng: np.random.Generator) -> Float[np.ndarray, "n 4"]:
    """Draw unit quaternions (x, y, z, w), uniform over rotations (normalised Gaussians)."""
    q = rng.standard_normal((n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def look_at(
    eye_m: Float[np.ndarray, "3"], target_m: Float[np.ndarray, "3"], down: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Return `T_world_cam` of a camera at `eye_m` that looks at `target_m`.

    The image's y axis is as close to `down` as the viewing direction allows.

    Raises:
        ValueError: eye and target coincide, or `down` is along the viewing direction.
    """
    z = target_m - eye_m
    x = np.cross(down, z)
    if np.linalg.norm(x) < 1e-9:
        raise ValueError(f"no camera at {eye_m} looking at {target_m} has its y axis along {down}")
    x = x / np.linalg.norm(x)
    z = z / np.linalg.norm(z)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(eye_m, dtype=np.float64))


def pixel_grid(height_px: int, width_px: int) -> Float[np.ndarray, "h w 2"]:
    """Return (x, y) of every pixel centre; the centre of the top-left pixel is (0, 0)."""
    y, x = np.mgrid[0:height_px, 0:width_px].astype(np.float64)
    return np.stack([x, y], axis=-1)
