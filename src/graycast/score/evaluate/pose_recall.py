"""Count correct poses in each picture by BOP's rules.

The sources are the same as in `pose_errors`. Counting follows section 2.3 of BOP 2020: if an object
has n instances to find, its n estimates with the highest scores choose instances in descending
order of their scores. An instance is to be found if at least 10 % of it is visible.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...dataset.read.pose_results import PoseEstimate
from ...rig.meshdepth import rasterize
from ...rig.optics import Optics, rays
from ...world.parts import Mesh, Symmetry
from ...world.parts.symmetry import motions
from .pose_errors import mspd, mssd, rotation_translation, vsd

# The thresholds of correctness are from BOP 2020, section 2.4.
TAU = np.arange(1, 11) * 0.05  # VSD's tolerances as shares of the diameter
THETA_VSD = np.arange(1, 11) * 0.05
THETA_MSSD = np.arange(1, 11) * 0.05  # shares of the diameter
THETA_MSPD_PX = np.arange(1, 11) * 5.0  # for a picture that is 640 px wide
NEAR_RAD, NEAR_M = np.radians(5.0), 0.003  # a simple criterion in addition to BOP's criteria


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PictureTruth:
    """Truth of one picture: the camera, the depth, and the poses of the parts.

    Attributes:
        measured_m: measured z [m]; NaN without depth.
        to_find: whether each instance is visible enough to count.
    """

    scene_id: int
    camera: Optics
    measured_m: Float[np.ndarray, "h w"]
    obj_id: Int[np.ndarray, " n"]
    T_cam_part: Float[np.ndarray, "n 4 4"]
    to_find: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """A part for scoring: shape, diameter, centre and symmetry motions."""

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    diameter_m: float
    motions: Float[np.ndarray, "s 4 4"]
    middle_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Counts:
    """Counts of correct estimates of one object in one picture, and the estimates' errors.

    Attributes:
        vsd: counts by tolerance and threshold; `mssd` and `mspd` are counts by threshold.
        near: count of estimates within 5 degrees and 3 mm.
        angle_rad, shift_m: errors of the estimates that MSSD matches within half a diameter.
    """

    scene_id: int
    obj_id: int
    to_find: int
    vsd: Int[np.ndarray, "10 10"]
    mssd: Int[np.ndarray, " 10"]
    mspd: Int[np.ndarray, " 10"]
    near: int
    angle_rad: Float[np.ndarray, " m"]
    shift_m: Float[np.ndarray, " m"]


def solid_of(mesh: Mesh, symmetry: Symmetry, diameter_m: float) -> Solid:
    """Return a part for scoring; continuous symmetries are discretised as in BOP."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices_m[used].astype(np.float64)
    return Solid(
        vertices_m=vertices,
        faces=faces.reshape(mesh.faces.shape),
        diameter_m=diameter_m,
        motions=motions(symmetry),
        middle_m=mesh.bounds_m.mean(axis=0),
    )


def count_picture(
    truth: PictureTruth, estimates: Sequence[PoseEstimate], solids: Mapping[int, Solid]
) -> list[Counts]:
    """Return the counts for each object with instances to find in the picture."""
    candidates = []
    for obj_id in np.unique(truth.obj_id[truth.to_find]).tolist():
        there = np.flatnonzero((truth.obj_id == obj_id) & truth.to_find)
        mine = [one for one in estimates if one.obj_id == obj_id]
        mine.sort(
            key=lambda one: -one.score
        )  # A stable sort keeps the file's order of equal scores.
        candidates.append(_counted(truth, there, mine[: len(there)], solids[obj_id], obj_id))
    return candidates


def _counted(
    truth: PictureTruth,
    there: Int[np.ndarray, " n"],
    estimates: Sequence[PoseEstimate],
    solid: Solid,
    obj_id: int,
) -> Counts:
    poses = truth.T_cam_part[there]
    shape = (len(estimates), len(there))
    e_mssd, e_mspd, angle, shift = (np.zeros(shape) for _ in range(4))
    for i, one in enumerate(estimates):
        for j, T in enumerate(poses):
            e_mssd[i, j] = mssd(one.T_cam_part, T, solid.vertices_m, solid.motions)
            e_mspd[i, j] = mspd(one.T_cam_part, T, solid.vertices_m, solid.motions, truth.camera)
            angle[i, j], shift[i, j] = rotation_translation(
                one.T_cam_part, T, solid.motions, middle_m=solid.middle_m
            )
    near = np.maximum(angle / NEAR_RAD, shift / NEAR_M)
    e_vsd = _vsd_of_pairs(truth, poses, estimates, solid)
    taken = matched(e_mssd, 0.5 * solid.diameter_m)
    return Counts(
        scene_id=truth.scene_id,
        obj_id=obj_id,
        to_find=len(there),
        vsd=np.array([[len(matched(e, theta)) for theta in THETA_VSD] for e in e_vsd]),
        mssd=np.array([len(matched(e_mssd, t * solid.diameter_m)) for t in THETA_MSSD]),
        mspd=np.array([len(matched(e_mspd, t)) for t in THETA_MSPD_PX]),
        near=len(matched(near, np.nextafter(1.0, 2.0))),
        angle_rad=np.array([angle[pair] for pair in taken]),
        shift_m=np.array([shift[pair] for pair in taken]),
    )


def matched(error: Float[np.ndarray, "e n"], threshold: float) -> list[tuple[int, int]]:
    """Pair each estimate with the free instance of least error, if it is below `threshold`."""
    free = np.ones(error.shape[1], bool)
    pairs = []
    for i, row in enumerate(error):
        open_ = np.where(free, row, np.inf)
        if len(open_) and open_.min() < threshold:
            j = int(np.argmin(open_))
            free[j] = False
            pairs.append((i, j))
    return pairs


def _vsd_of_pairs(
    truth: PictureTruth,
    poses: Float[np.ndarray, "n 4 4"],
    estimates: Sequence[PoseEstimate],
    solid: Solid,
) -> Float[np.ndarray, "10 e n"]:
    """Return VSD for each tolerance and pair; 1 for pairs whose bounding boxes do not overlap."""
    height, width = truth.measured_m.shape
    y, x = np.mgrid[:height, :width].astype(np.float64)
    length = np.linalg.norm(rays(truth.camera, np.stack([x, y], axis=-1)), axis=-1)
    mine = [_distance(one.T_cam_part, solid, truth.camera, length) for one in estimates]
    its = [_distance(T, solid, truth.camera, length) for T in poses]
    measured = truth.measured_m * length
    error = np.ones((len(TAU), len(mine), len(its)))
    for i, (a, box_a) in enumerate(mine):
        for j, (b, box_b) in enumerate(its):
            low, high = np.minimum(box_a[0], box_b[0]), np.maximum(box_a[1], box_b[1])
            apart = (np.maximum(box_a[0], box_b[0]) >= np.minimum(box_a[1], box_b[1])).any()
            if not apart:
                window = np.s_[low[0] : high[0], low[1] : high[1]]
                error[:, i, j] = vsd(a[window], b[window], measured[window], TAU * solid.diameter_m)
    return error


def _distance(
    T: Float[np.ndarray, "4 4"], solid: Solid, camera: Optics, length: Float[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "h w"], np.ndarray]:
    """Return a map of distances from the camera's centre to the part, and its bounding box."""
    vertices = solid.vertices_m @ T[:3, :3].T + T[:3, 3]
    z = rasterize(vertices, solid.faces, camera).over(camera)[1]
    rows, columns = np.nonzero(np.isfinite(z))
    if not len(rows):
        return z, np.zeros((2, 2), int)
    box = np.array([[rows.min(), columns.min()], [rows.max() + 1, columns.max() + 1]])
    return z * length, box
