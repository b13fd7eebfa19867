"""Writers of a BOP scene with a cube in front of a wall; `rig/meshdepth` gives the depth."""

import json

import cv2
import numpy as np

from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.rig.meshdepth import visible_surface
from graycast.rig.optics import Optics

CAMERA = Optics(width_px=64, height_px=48, fx_px=90.0, fy_px=91.0, cx_px=31.0, cy_px=24.5)
SIDE_MM, WALL_M, SCALE_MM = 60.0, 0.9, 0.1
POSE = rigid(axis_rotation("x", 0.4) @ axis_rotation("z", 0.7), np.array([0.02, -0.01, 0.5]))
_QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
FACES = np.array([triangle for a, b, c, d in _QUADS for triangle in ((a, b, c), (a, c, d))])


def corners(side):
    return side * (np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5)


def cube_ply(side=SIDE_MM, colors=None, faces=FACES):
    """Return an ASCII PLY of a cube, with vertex colours if `colors` is given."""
    vertices = corners(side)
    rgb = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\n{rgb if colors is not None else ''}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(f"{v:g}" for v in vertex) for vertex in vertices]
    if colors is not None:
        rows = [f"{row} {r} {g} {b}" for row, (r, g, b) in zip(rows, colors, strict=True)]
    return head + "\n".join(rows + [f"3 {a} {b} {c}" for a, b, c in faces]) + "\n"


def true_depth_m():
    """Return the depth of the cube in front of the wall."""
    vertices_m = transform_points(POSE, corners(SIDE_MM / 1e3))
    z_m = visible_surface(np.eye(4), vertices_m, FACES, CAMERA)[1]
    return np.where(np.isnan(z_m), WALL_M, z_m)


def png(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def write_json(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def gt_of(T_cam_part, obj_id=1):
    return {
        "obj_id": obj_id,
        "cam_R_m2c": T_cam_part[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1e3 * T_cam_part[:3, 3]).tolist(),
    }


def write_scene(scene, sensor="", images=(0,), rgb=None):
    """Write the files of a scene like BlenderProc's writer, with a colour picture as JPEG."""
    end = f"_{sensor}" if sensor else ""
    view = {"cam_K": CAMERA.K.ravel().tolist(), "depth_scale": SCALE_MM}
    view |= {"cam_R_w2c": np.eye(3).ravel().tolist(), "cam_t_w2c": [0.0, 0.0, 0.0]}
    write_json(scene / f"scene_camera{end}.json", {str(i): view for i in images})
    write_json(scene / f"scene_gt{end}.json", {str(i): [gt_of(POSE)] for i in images})
    steps = np.rint(true_depth_m() * 1e3 / SCALE_MM).astype(np.uint16)
    for image in images:
        png(scene / f"depth{end}" / f"{image:06d}.png", steps)
        if rgb is not None:
            png(scene / f"rgb{end}" / f"{image:06d}.jpg", rgb[..., ::-1])


def write_models(folder, **changes):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "obj_000001.ply").write_text(cube_ply(**changes))


def write_dataset(root, **changes):
    """Write `root/train_pbr/000000` and `root/models`; return the split."""
    write_scene(root / "train_pbr/000000", **changes)
    write_models(root / "models")
    return root / "train_pbr"
