"""Small rigs, walls and boxes in camera coordinates, for tests of rendering."""

from dataclasses import replace

import numpy as np

from graycast.base.frames import axis_rotation, rigid, transform_points
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import Environment, Layout, Quad, Scene, Sphere

DARK = Environment(radiance=(0.0, 0.0, 0.0))
# The camera is oblique, so that no two frames coincide by chance.
SOMEWHERE = rigid(
    axis_rotation("x", 2.5) @ axis_rotation("y", 0.2) @ axis_rotation("z", 0.4),
    np.array([0.3, -0.2, 0.9]),
)


def lambert(*albedo):
    """Return a Lambertian material with one albedo, or with an albedo for each colour."""
    return Material(base_color=tuple(albedo) if len(albedo) == 3 else albedo * 3, specular=0.0)


def optics(width_px, height_px, f_px, *, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)):
    """Return optics with fx != fy and an off-centre axis, so that tests detect exchanged axes."""
    return Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=float(f_px),
        fy_px=1.04 * f_px,
        cx_px=0.5 * width_px - 1.7,
        cy_px=0.5 * height_px + 0.9,
        distortion=distortion,
    )


def centred(width_px, height_px, f_px):
    """Return optics with square pixels and a centred axis."""
    return Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=float(f_px),
        fy_px=float(f_px),
        cx_px=0.5 * (width_px - 1),
        cy_px=0.5 * (height_px - 1),
    )


def make_rig(camera, projector, *, baseline_m=(0.1, 0.0, 0.0), rotation=None, **words):
    """Return a rig with the projector at `baseline_m` in the camera frame, parallel by default."""
    rotation = np.eye(3) if rotation is None else rotation
    return Rig(
        name="test",
        camera=camera,
        projector=projector,
        T_cam_proj=rigid(rotation, np.array(baseline_m)),
        near_m=0.05,
        far_m=20.0,
        **words,
    )


def turned(x_rad, y_rad, z_rad):
    return axis_rotation("x", x_rad) @ axis_rotation("y", y_rad) @ axis_rotation("z", z_rad)


def askew_rig(*, camera=None, projector=None, **words):
    """Return a rig with toe-in, roll, and a baseline that is not along an axis."""
    return make_rig(
        optics(96, 72, 110) if camera is None else camera,
        optics(64, 48, 52) if projector is None else projector,
        baseline_m=(0.14, -0.05, 0.03),
        rotation=turned(0.04, -0.13, 0.06),
        **words,
    )


def wall(z_m, material, *, half_m=5.0):
    """Return a square perpendicular to the camera's axis that faces the camera."""
    return Quad(
        center_m=(0.0, 0.0, z_m),
        half_u_m=(half_m, 0.0, 0.0),
        half_v_m=(0.0, -half_m, 0.0),
        material=material,
    )


def leaning_wall(normal, offset_m, material, *, half_m=5.0):
    """Return a square in the plane `normal . p = offset_m > 0` that faces the camera."""
    normal = np.asarray(normal) / np.linalg.norm(normal)
    u = np.cross([0.0, 1.0, 0.0], normal)
    u /= np.linalg.norm(u)
    v = -np.cross(normal, u)  # With this v, u x v = -normal points towards the camera.
    return Quad(
        center_m=tuple((offset_m * normal).tolist()),
        half_u_m=tuple((half_m * u).tolist()),
        half_v_m=tuple((half_m * v).tolist()),
        material=material,
    )


def in_camera(rig, *surfaces, T_world_cam=SOMEWHERE, **words):
    """Return a scene from surfaces in the camera frame."""
    words.setdefault("environment", DARK)
    return Scene(
        rig=rig,
        T_world_cam=T_world_cam.copy(),
        surfaces=tuple(_moved(surface, T_world_cam) for surface in surfaces),
        **words,
    )


def _moved(surface, T):
    def point(p):
        return tuple(transform_points(T, np.array(p)).tolist())

    def direction(d):
        return tuple((T[:3, :3] @ np.array(d)).tolist())

    if isinstance(surface, Sphere):
        return replace(surface, center_m=point(surface.center_m))
    return replace(
        surface,
        center_m=point(surface.center_m),
        half_u_m=direction(surface.half_u_m),
        half_v_m=direction(surface.half_v_m),
    )


def centre_rays(camera):
    """Return ray directions with z = 1 through pixel centres, without lens distortion."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    x, y = (x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=-1)


BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def box_part(half_m, material, *, name="box"):
    """Return a box whose centre is its own origin."""
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    mesh = Mesh(vertices_m=BOX_CORNERS * half_m, faces=faces)
    return Part(name=name, mesh=mesh, material=material, density_kg_m3=1000.0, friction=0.5)


def layout_in_camera(part_index, poses_cam, T_world_cam=SOMEWHERE):
    return Layout(
        T_world_part=np.stack([T_world_cam @ pose for pose in poses_cam]),
        part_index=np.array(part_index),
    )


def plain_pattern(rig, *levels):
    """Return uniform pictures of the projector's size, one for each grey level."""
    size = (rig.projector.height_px, rig.projector.width_px)
    return np.stack([np.full(size, level, dtype=np.uint8) for level in levels])
