"""Small scenes in closed form: convex prisms in front of a tilted wall, traced by half-spaces."""

from collections import Counter

import numpy as np

from graycast.base.frames import random_quaternions, rigid, rotation_from_quaternion
from graycast.base.streams import image_seeds, scene_seeds
from graycast.camera.decode import DepthMap, Reason
from graycast.dataset.files.sample import Sample
from graycast.rendering.radiance import GroundTruth, Silhouette
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig
from graycast.world.parts import Material, Mesh, Part, Symmetry
from graycast.world.scene import Layout, Scene

WIDTH, HEIGHT = 160, 120
SEED, CONFIG = 7, {"rig": "test", "bin": {"size_m": [0.4, 0.3]}}  # of the dataset
SCALE_MM = 0.02  # step of the datasets' depth pictures
K = np.array([[212.0, 0.0, 78.3], [0.0, 214.0, 61.7], [0.0, 0.0, 1.0]])
WALL = (np.array([0.1, -0.2, 1.0]), 0.62)  # n . p = d, camera frame


def prism(section_m, height_m):
    """Return a mesh over a convex section (counter-clockwise), with uv per corner for its sides."""
    k = len(section_m)
    low = np.column_stack([section_m, np.full(k, -0.3 * height_m)])
    vertices = np.vstack([low, low + np.array([0, 0, height_m])])
    faces = [[0, i + 1, i] for i in range(1, k - 1)]
    faces += [[k, k + i, k + i + 1] for i in range(1, k - 1)]
    for i in range(k):
        j = (i + 1) % k
        faces += [[i, j, j + k], [i, j + k, i + k]]
    return vertices, np.array(faces)


def box_part():
    """Return a textured box with hard edges: each face has its own normals and a seam in uv."""
    section = np.array([[-0.015, -0.02], [0.015, -0.02], [0.015, 0.02], [-0.015, 0.02]])
    vertices, faces = prism(section, 0.06)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    texture = np.arange(8 * 4 * 3, dtype=np.uint8).reshape(8, 4, 3)
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:3, 3] = [0.001, 0.0, 0.0]
    return Part(
        name="box",
        mesh=Mesh(
            vertices_m=vertices,
            faces=faces,
            corner_uv=corner[..., [0, 2]] * 10 + 0.5,
            corner_normals=np.repeat(normal[:, None], 3, axis=1),
        ),
        material=Material(texture=texture),
        density_kg_m3=800.0,
        friction=0.5,
        symmetry=Symmetry(discrete=(turn,)),
    )


def wedge_part():
    """Return a plain wedge without normals and uv."""
    vertices, faces = prism(np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.03]]), 0.04)
    return Part(
        name="wedge",
        mesh=Mesh(vertices_m=vertices, faces=faces),
        material=Material(base_color=(0.5, 0.2, 0.0)),
        density_kg_m3=7800.0,
        friction=0.4,
        symmetry=Symmetry(continuous=(((0.0, 0.0, 1.0), (0.0, 0.002, 0.0)),)),
    )


def make_rig():
    side = rigid(np.eye(3), np.array([0.2, 0.0, 0.0]))
    camera = Optics(
        width_px=WIDTH, height_px=HEIGHT, fx_px=212.0, fy_px=214.0, cx_px=78.3, cy_px=61.7
    )
    return Rig(name="test", camera=camera, projector=camera, T_cam_proj=side, near_m=0.2, far_m=1.0)


def hit_depth(mesh, T_cam_part, x, y):
    """Return z where the rays (x, y, 1) enter a closed convex mesh; NaN if they miss it."""
    z_m = np.full(x.shape, np.nan)
    corner = mesh.vertices_m[mesh.faces] @ T_cam_part[:3, :3].T + T_cam_part[:3, 3]
    assert corner[..., 2].min() > 0  # inside the rays to its corners
    corner_xy = (corner[..., :2] / corner[..., 2:]).reshape(-1, 2)
    (left, top), (right, bottom) = corner_xy.min(axis=0), corner_xy.max(axis=0)
    near = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    x, y = x[near], y[near]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    offset = np.einsum("fi,fi->f", normal, corner[:, 0])
    slope = normal @ np.stack([x, y, np.ones(x.size)])
    with np.errstate(divide="ignore"):
        t = offset[:, None] / slope
    enter = np.where(slope < 0, t, -np.inf).max(axis=0)
    leave = np.where(slope > 0, t, np.inf).min(axis=0)
    z_m[near] = np.where((enter < leave) & (enter > 0), enter, np.nan)
    return z_m


def cam_poses(seed):
    """Return random poses, and poses across a border, hidden, and outside the image."""
    rng = np.random.default_rng(seed)
    rotation = rotation_from_quaternion(random_quaternions(8, rng))
    place = np.column_stack(
        [rng.uniform(-0.1, 0.1, 8), rng.uniform(-0.07, 0.07, 8), rng.uniform(0.33, 0.5, 8)]
    )
    place[4] = [-0.17, 0.02, 0.44]  # leaves the image on the left
    place[5] = place[0] * 0.55 + [0.0, 0.0, 0.0]  # hides number 0, which is along its rays
    place[6] = [0.45, 0.0, 0.5]  # beyond the right border
    return np.stack([rigid(R, t) for R, t in zip(rotation, place, strict=True)])


def build_sample(seed, *, parts, rig, sensor="", image=0, station=0, T_first_cam=None):
    """Return a sample in closed form; the scanner's depth has noise and two kinds of gaps.

    Further images of the scene are from a camera at `T_first_cam`. The wall moves with the camera.
    """
    rng = np.random.default_rng(1000 + seed)
    T_world_cam = rigid(
        rotation_from_quaternion(random_quaternions(1, rng))[0], rng.uniform(-1, 1, 3)
    )
    T_cam_part = cam_poses(seed)
    if T_first_cam is not None:
        T_world_cam = T_world_cam @ T_first_cam
        T_cam_part = np.linalg.inv(T_first_cam) @ T_cam_part
    part_index = np.arange(len(T_cam_part)) % 2
    v, u = np.mgrid[-HEIGHT : 2 * HEIGHT, -WIDTH : 2 * WIDTH].astype(float)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    wide = [hit_depth(parts[p].mesh, T, x, y) for p, T in zip(part_index, T_cam_part, strict=True)]
    inside = np.s_[HEIGHT : 2 * HEIGHT, WIDTH : 2 * WIDTH]
    normal, d = WALL
    wall = d / (normal[0] * x + normal[1] * y + normal[2])[inside]
    layers = np.stack([wall, *(z[inside] for z in wide)])
    nearest = np.nanargmin(layers, axis=0)
    depth_m = np.take_along_axis(layers, nearest[None], axis=0)[0]
    reason = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    reason[40:55, 60:90] = Reason.SHADOW
    reason[rng.random((HEIGHT, WIDTH)) < 0.02] = Reason.CONTRADICTORY
    measured = depth_m + rng.normal(0, 2e-4, depth_m.shape)
    instance = nearest - 1
    rgb, gray, modulation = pictures(instance, reason == Reason.SHADOW, rng)
    pose = T_world_cam @ T_cam_part
    return Sample(
        scene=Scene(rig=rig, T_world_cam=T_world_cam, parts=parts),
        layout=Layout(T_world_part=pose, part_index=part_index),
        truth=GroundTruth(
            depth_m=depth_m,
            normal=np.full((HEIGHT, WIDTH, 3), np.nan),
            instance=instance,
            amodal=tuple(crop(~np.isnan(z)) for z in wide),
        ),
        rgb=rgb,
        gray=gray,
        scanner_depth=DepthMap(
            depth_m=np.where(reason == 0, measured, np.nan),
            sigma_m=np.where(reason == 0, 2e-4, np.nan),
            reason=reason,
            camera=rig.camera,
        ),
        modulation=modulation,
        manifest={
            "scene_id": seed,
            "dataset_seed": SEED,
            "seeds": scene_seeds(SEED, seed)
            | image_seeds(SEED, seed, station=station, image=image),
            "counts": dict(Counter(parts[p].name for p in part_index if parts[p].labelled)),
            "reasons": {r.name.lower(): float((reason == r).mean()) for r in Reason},
            "config": CONFIG,
            "timings": {"render_s": 1.5},
        },
        sensor=sensor,
        image=image,
    )


def pictures(instance, shadow, rng):
    """Return colour, white frame and modulation of parts with different reflectances."""
    albedo = 0.25 + 0.08 * (np.arange(-1, 8) * 5 % 9)
    light = np.where(shadow, 0.04, albedo[instance + 1]) * rng.uniform(0.97, 1, instance.shape)
    tint = rng.uniform(0.6, 1, (9, 3))[instance + 1]
    rgb = 255 * np.clip(light[..., None] * tint, 0, 1)
    return rgb.astype(np.uint8), (255 * light).astype(np.uint8), np.where(shadow, 0, 0.9) * light


def crop(wide):
    """Return a silhouette over three by three images."""
    if not wide.any():
        return Silhouette(left_px=0, top_px=0, mask=np.zeros((0, 0), dtype=bool))
    rows, columns = np.flatnonzero(wide.any(axis=1)), np.flatnonzero(wide.any(axis=0))
    window = wide[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return Silhouette(
        left_px=int(columns[0]) - WIDTH, top_px=int(rows[0]) - HEIGHT, mask=window.copy()
    )
