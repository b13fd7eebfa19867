"""Render one pattern at a time with Mitsuba's own camera, projector and path integrator.

This is an independent program for tests of the one-pass renderer. It uses the shapes of the scene,
but none of the renderer's code except its coated material, which has tests of its own. It
translates the materials itself.
"""

import math

import numpy as np

from graycast.world.scene import Quad

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's cameras and projectors have x left and y up.
FINER = 8  # texels per projector pixel and axis, for the cosine in `_projector`


def render(scene, layout, pattern, *, samples, depth, seeds):
    """Return the monochrome radiance (seeds, h, w) for one 8-bit pattern."""
    import mitsuba as mi

    world = mi.load_dict({"type": "scene", **_shapes(scene, layout), **_projector(scene, pattern)})
    sensor = mi.load_dict(_camera(scene))
    path = mi.load_dict({"type": "path", "max_depth": depth + 1})  # It counts edges, not vertices.
    weights = np.array(scene.rig.band_weights)
    return np.stack(
        [
            np.array(mi.render(world, sensor=sensor, integrator=path, spp=samples, seed=seed))
            @ weights
            for seed in seeds
        ]
    )


def _camera(scene):
    import mitsuba as mi

    camera = scene.rig.camera
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(scene.T_world_cam @ FLIP),
        **_field(camera),
        "film": {
            "type": "hdrfilm",
            "width": camera.width_px,
            "height": camera.height_px,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
    }


def _field(optics):
    """Return a field with square pixels and a central axis, which Mitsuba's projector requires."""
    assert optics.fx_px == optics.fy_px and not optics.has_distortion
    assert optics.cx_px == (optics.width_px - 1) / 2 and optics.cy_px == (optics.height_px - 1) / 2
    fov = math.degrees(2 * math.atan(optics.width_px / 2 / optics.fx_px))
    return {"fov": fov, "fov_axis": "x"}


def _projector(scene, pattern):
    """Mitsuba's projector emits irradiance at z = 1, so a constant intensity falls by cos^3."""
    import mitsuba as mi

    rig = scene.rig
    h, w = pattern.shape
    y, x = (np.mgrid[0 : h * FINER, 0 : w * FINER] + 0.5) / FINER - 0.5
    x, y = (x - rig.projector.cx_px) / rig.projector.fx_px, y - rig.projector.cy_px
    cosine = 1 / np.sqrt(1 + x**2 + (y / rig.projector.fy_px) ** 2)
    level = np.kron(pattern / 255.0, np.ones((FINER, FINER)))
    irradiance = level * rig.intensity_w_sr * cosine**3 / math.pi
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.repeat(irradiance[..., None], 3, axis=2).astype(np.float32)),
        "raw": True,
        "filter_type": "nearest",
        "wrap_mode": "clamp",
    }
    T_world_proj = scene.T_world_cam @ rig.T_cam_proj
    to_world = mi.ScalarTransform4f(T_world_proj @ FLIP)
    return {
        "projector": {
            "type": "projector",
            "to_world": to_world,
            "irradiance": texture,
            **_field(rig.projector),
        }
    }


def _shapes(scene, layout):
    import mitsuba as mi

    shapes = {}
    for i, surface in enumerate(scene.surfaces):
        if isinstance(surface, Quad):
            u, v = np.array(surface.half_u_m), np.array(surface.half_v_m)
            n = np.cross(u, v)
            rows = np.stack([u, v, n / np.linalg.norm(n), surface.center_m], axis=1)
            to_world = mi.ScalarTransform4f(np.vstack([rows, [0, 0, 0, 1]]))
            shape = {"type": "rectangle", "to_world": to_world}
        else:
            center = list(surface.center_m)
            shape = {"type": "sphere", "center": center, "radius": surface.radius_m}
        shapes[f"surface{i}"] = {**shape, "bsdf": _bsdf(surface.material)}
    for i, index in enumerate(layout.part_index):
        part = scene.parts[index]
        half = np.diag([*(part.mesh.extent_m / 2), 1.0])  # All parts of these tests are boxes.
        to_world = mi.ScalarTransform4f(layout.T_world_part[i] @ half)
        shapes[f"box{i}"] = {"type": "cube", "to_world": to_world, "bsdf": _bsdf(part.material)}
    return shapes


def _bsdf(material):
    color = {"type": "rgb", "value": list(material.base_color)}
    if material.metallic:  # This BSDF and coated_diffuse are the renderer's; the transport is not.
        return {"type": "rough_conductor", "alpha": material.roughness**2, "reflectance": color}
    if material.specular == 0:
        return {"type": "diffuse", "reflectance": color}
    assert material.specular == 0.5  # This means a refractive index of 1.5.
    return {
        "type": "coated_diffuse",
        "alpha": material.roughness**2,
        "eta": 1.5,
        "reflectance": color,
    }
