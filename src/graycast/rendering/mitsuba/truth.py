"""Ground truth from a Mitsuba scene: geometry at pixel centres, and complete silhouettes."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ...base.frames import inverse, transform_points
from ...base.mask_box import mask_box
from ...rig.optics import fold_radius2, project
from ...world.scene import Layout, Scene
from ..radiance import GroundTruth, Silhouette
from .lens import camera_ray, distorted, picture_place
from .scene import PartShape
from .stage import Stage

STEP_THROUGH_M = 2e-5  # More than the error of float32, and than the overlap of touching parts.
OUTLINE_POINTS = 33  # The number of points per side of a part's box, which distortion bends.
Box = tuple[int, int, int, int]
"""Pixels (left, top, right, bottom), where right and bottom are excluded."""


def truth(
    world: mi.Scene, part_shapes: tuple[PartShape, ...], scene: Scene, layout: Layout
) -> GroundTruth:
    camera = scene.rig.camera
    h, w = camera.height_px, camera.width_px
    boxes = [_silhouette_box(scene, layout, i) for i in range(len(layout.part_index))]
    ray = _centre_rays(scene, (0, 0, w, h))
    si = world.ray_intersect(ray)
    hit = si.is_valid()
    R_cam_world = mi.Matrix3f(scene.T_world_cam[:3, :3].T)
    axis = mi.Vector3f(scene.T_world_cam[:3, 2])
    depth = dr.select(hit, si.t * dr.dot(ray.d, axis), dr.nan)
    n = dr.select(hit, R_cam_world @ si.n, dr.nan)
    n = dr.mulsign(n, -dr.dot(si.n, ray.d))
    instance = _instance(si, part_shapes)
    dr.eval(depth, n, instance)
    bits, left, top = _amodal_bits(part_shapes, scene, boxes)
    return GroundTruth(
        depth_m=np.array(depth).reshape(h, w),
        normal=np.array(n).T.reshape(h, w, 3),
        instance=np.array(instance).reshape(h, w),
        amodal=tuple(_silhouette(bits, left, top, i, box) for i, box in enumerate(boxes)),
    )


def centre_places(stage: Stage, scene: Scene) -> mi.Point2f:
    """Return the projector position of the surface at each pixel's centre [px], or NaN.

    Thin walls of glass are ignored. The result is NaN on and behind solid glass, too.
    """
    camera = scene.rig.camera
    ray = _centre_rays(scene, (0, 0, camera.width_px, camera.height_px))
    si, solid = stage.sight.centre(ray)
    q = stage.light.in_own_frame(mi.Point3f(si.t * ray.d + ray.o))
    place, _, ahead = picture_place(stage.light.optics, q)
    return dr.select(si.is_valid() & ~solid & ahead, place, dr.nan)


def _centre_rays(scene: Scene, canvas: Box) -> mi.Ray3f:
    """Return rays through the pixel centres of a canvas."""
    x, y = _places(canvas)
    direction = mi.Matrix3f(scene.T_world_cam[:3, :3]) @ camera_ray(scene.rig.camera, x, y)
    return mi.Ray3f(mi.Point3f(scene.T_world_cam[:3, 3]), direction)


def _places(canvas: Box) -> tuple[mi.Float, mi.Float]:
    """Return pixel positions; corner and size are opaque, so that all scenes share a kernel."""
    left, top, right, bottom = canvas
    lane = dr.arange(mi.Int32, (right - left) * (bottom - top))
    columns = dr.opaque(mi.Int32, right - left)
    x = lane % columns + dr.opaque(mi.Int32, left)
    return mi.Float(x), mi.Float(lane // columns + dr.opaque(mi.Int32, top))


def _instance(si: mi.SurfaceInteraction3f, part_shapes: tuple[PartShape, ...]) -> mi.Int32:
    """Return the layout index of the part that was hit, or -1 for anything else."""
    instance = dr.full(mi.Int32, -1, dr.width(si))
    for part in part_shapes:
        table = mi.Int32(part.instances.astype(np.int32))
        mine = si.is_valid() & (si.shape == mi.ShapePtr(part.shape))
        index = dr.gather(mi.Int32, table, si.prim_index // part.faces_each, mine)
        instance = dr.select(mine, index, instance)
    return instance


def _silhouette_box(scene: Scene, layout: Layout, index: int) -> Box:
    """Return a box of the pixels that can see an instance, up to one image size beyond a border."""
    camera = scene.rig.camera
    part = scene.parts[layout.part_index[index]]
    T_cam_part = inverse(scene.T_world_cam) @ layout.T_world_part[index]
    pixel = project(camera, _outline(transform_points(T_cam_part, part.mesh.vertices_m)))
    size = np.array([camera.width_px, camera.height_px])
    if np.isnan(pixel).any():  # The part extends behind the lens, so it may be anywhere.
        low, high = -size, 2 * size
    else:
        # Add a margin of one pixel, because distortion bends the outline between its points.
        low = np.clip(np.floor(pixel.min(axis=0)).astype(int) - 1, -size, 2 * size)
        high = np.clip(np.ceil(pixel.max(axis=0)).astype(int) + 2, -size, 2 * size)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _outline(point: np.ndarray) -> np.ndarray:
    """Return points on the bounding box of the ideal image; distortion keeps the image inside."""
    if (point[:, 2] <= 0).any():
        return point
    ideal = point[:, :2] / point[:, 2:]
    low, high = ideal.min(axis=0), ideal.max(axis=0)
    step = np.linspace(0.0, 1.0, OUTLINE_POINTS)
    along = np.concatenate([step, step, 0 * step, 0 * step + 1])
    across = np.concatenate([0 * step, 0 * step + 1, step, step])
    border = low + (high - low) * np.stack([along, across], axis=-1)
    return np.concatenate([border, np.ones_like(border[:, :1])], axis=-1)


def _amodal_bits(
    part_shapes: tuple[PartShape, ...], scene: Scene, boxes: list[Box]
) -> tuple[np.ndarray, int, int]:
    """Return a bit per instance and pixel, uint32 (words, rows, columns), and the first pixel.

    Each centre ray is followed through all parts that it meets, so hidden surfaces count. The bin
    is left out, because a part that lies flat on it has the same depth.
    """
    if not boxes:
        return np.zeros((0, 0, 0), dtype=np.uint32), 0, 0
    box = np.array(boxes)
    (left, top), (right, bottom) = box[:, :2].min(axis=0).tolist(), box[:, 2:].max(axis=0).tolist()
    canvas, width, height = (left, top, right, bottom), right - left, bottom - top
    if width <= 0 or height <= 0:  # No part is near the picture.
        return np.zeros(((len(boxes) + 31) // 32, 0, 0), dtype=np.uint32), left, top
    ray = _centre_rays(scene, canvas)
    going = _exists(scene, ray, *_places(canvas))
    parts_alone = {f"part{i}": part.shape for i, part in enumerate(part_shapes)}
    world = mi.load_dict({"type": "scene"} | parts_alone)
    needed = (len(boxes) + 31) // 32
    # Use a multiple of eight words, so that all heaps of up to 256 parts share a kernel.
    words = _follow(world, part_shapes, ray, going, 8 * ((needed + 7) // 8))
    dr.eval(words)
    return np.stack([np.array(word).reshape(height, width) for word in words[:needed]]), left, top


def _exists(scene: Scene, ray: mi.Ray3f, x: mi.Float, y: mi.Float) -> mi.Bool:
    """Return whether the ray of a pixel projects back to it, which fails beyond a lens's fold."""
    camera = scene.rig.camera
    if not camera.has_distortion:
        return dr.full(mi.Bool, True, dr.width(ray.d))
    d = mi.Matrix3f(scene.T_world_cam[:3, :3].T) @ ray.d
    xi, yi = d.x / d.z, d.y / d.z
    u, v = distorted(xi, yi, camera.distortion)
    returns = dr.abs(dr.fma(u, camera.fx_px, camera.cx_px) - x) < 0.05
    returns &= dr.abs(dr.fma(v, camera.fy_px, camera.cy_px) - y) < 0.05
    return returns & (xi * xi + yi * yi < fold_radius2(camera.distortion))


def _follow(
    world: mi.Scene,
    part_shapes: tuple[PartShape, ...],
    ray: mi.Ray3f,
    going: mi.Bool,
    word_count: int,
) -> list[mi.UInt32]:
    """Return, as bits, the instances that each ray meets along its full length."""

    def body(origin, going, words):
        # Neighbouring rays soon have different depths; as incoherent rays they take 25 % less time.
        si = world.ray_intersect(
            mi.Ray3f(origin, ray.d), mi.RayFlags.Minimal, coherent=False, active=going
        )
        instance = _instance(si, part_shapes)
        bit = mi.UInt32(1) << mi.UInt32(instance & 31)
        words = [
            word | dr.select((instance >= 0) & (instance >> 5 == k), bit, 0)
            for k, word in enumerate(words)
        ]
        # Do not use `spawn_ray`, which steps along the normal and would leave the pixel's ray.
        return mi.Point3f(origin + (si.t + STEP_THROUGH_M) * ray.d), si.is_valid(), words

    none = [dr.zeros(mi.UInt32, dr.width(ray.d)) for _ in range(word_count)]
    _, _, words = dr.while_loop(
        state=(mi.Point3f(ray.o), going, none), cond=lambda o, going, w: going, body=body
    )
    return words


def _silhouette(bits: np.ndarray, left: int, top: int, index: int, box: Box) -> Silhouette:
    x0, y0, x1, y1 = box
    word = bits[index // 32, y0 - top : y1 - top, x0 - left : x1 - left]
    mask = (word >> np.uint32(index % 32)) & np.uint32(1) == 1
    x, y, columns, rows = mask_box(mask)
    crop = mask[y : y + rows, x : x + columns]
    return Silhouette(left_px=x0 + x, top_px=y0 + y, mask=crop.copy())
