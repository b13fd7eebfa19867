"""Random shapes like household objects, for clutter besides cartons and machine parts.

There are four kinds: limbs that meet in a joint (like tools and toys), arches with or without a
handle, flasks, and cards with a dome. A shape is one closed solid in metres, about as long as a
hand, and does not copy a real object.
"""

from itertools import pairwise

import numpy as np
import trimesh
from manifold3d import Manifold, OpType

SEGMENTS = 20
_ADD = OpType.Add


def random_shape(seed: int) -> trimesh.Trimesh:
    """Return the shape of a seed; `seed % 4` is its kind: forked, arch, flask, card."""
    rng = np.random.default_rng([20, seed])
    kind = (_forked, _arch, _flask, _card)[seed % 4]
    mesh = kind(rng).to_mesh64()
    vertices_m = np.array(mesh.vert_properties[:, :3], dtype=np.float64) * 1e-3
    vertices_m -= (vertices_m.min(axis=0) + vertices_m.max(axis=0)) / 2
    return trimesh.Trimesh(vertices_m, np.asarray(mesh.tri_verts, dtype=np.int64), process=False)


def _forked(rng: np.random.Generator) -> Manifold:
    count = rng.integers(2, 5)
    gaps = rng.uniform(0.6, 1.4, count)
    heading = np.cumsum(gaps) / gaps.sum() * 2 * np.pi
    limbs = []
    for angle in heading:
        length_mm, bend_rad = rng.uniform(50, 130), rng.uniform(-0.9, 0.9)
        turn = angle + bend_rad * np.linspace(0, 1, 8)
        step = length_mm / 8 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        path_mm = np.vstack([[0, 0], np.cumsum(step, axis=0)])
        limbs.append(_limb(path_mm, rng.uniform(7, 14), rng.uniform(3, 10), rng.uniform(6, 24)))
    return Manifold.batch_boolean(limbs, _ADD)


def _arch(rng: np.random.Generator) -> Manifold:
    radius_mm, sweep = rng.uniform(25, 55), np.radians(rng.uniform(150, 310))
    angle = np.linspace(0, sweep, 20)
    path_mm = radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    thick_mm = rng.uniform(8, 25)
    parts = [_limb(path_mm, rng.uniform(4, 10), rng.uniform(4, 10), thick_mm)]
    if rng.random() < 0.5:
        away = path_mm[10] / radius_mm
        handle_mm = path_mm[10] + np.outer(np.linspace(0, rng.uniform(50, 110), 5), away)
        parts.append(_limb(handle_mm, rng.uniform(6, 12), rng.uniform(5, 12), thick_mm))
    return Manifold.batch_boolean(parts, _ADD)


def _flask(rng: np.random.Generator) -> Manifold:
    body_mm, height_mm = rng.uniform(14, 38), rng.uniform(70, 170)
    neck_mm, shoulder = body_mm * rng.uniform(0.3, 0.8), rng.uniform(0.5, 0.85)
    waist_mm = body_mm * rng.uniform(0.75, 1.0)
    profile_mm = [
        (0.0, 0.0),
        (body_mm, 0.0),
        (waist_mm, 0.35 * height_mm),
        (body_mm, shoulder * 0.9 * height_mm),
        (neck_mm, shoulder * height_mm),
        (neck_mm * rng.uniform(0.6, 1.0), height_mm),
        (0.0, height_mm),
    ]
    rings = [
        Manifold.cylinder(z1 - z0, r0, r1, SEGMENTS).translate((0, 0, z0))
        for (r0, z0), (r1, z1) in pairwise(profile_mm)
        if z1 > z0
    ]
    return Manifold.batch_boolean(rings, _ADD).scale((1.0, rng.uniform(0.4, 1.0), 1.0))


def _card(rng: np.random.Generator) -> Manifold:
    width_mm, height_mm, thick_mm = rng.uniform(50, 110), rng.uniform(80, 170), rng.uniform(2, 6)
    parts = [Manifold.cube((width_mm, height_mm, thick_mm), True)]
    for _ in range(rng.integers(1, 3)):
        size_mm = rng.uniform(0.3, 0.8, 2) * (width_mm, height_mm)
        foot = Manifold.cube((size_mm[0], size_mm[1], thick_mm), True)
        top_mm = (*(size_mm * rng.uniform(0.5, 0.95)), 1.0)
        top = Manifold.cube(top_mm, True).translate((0, 0, rng.uniform(10, 30)))
        free_mm = (np.array([width_mm, height_mm]) - size_mm) / 2
        x_mm, y_mm = rng.uniform(-free_mm, free_mm)
        parts.append(Manifold.batch_hull([foot, top]).translate((x_mm, y_mm, 0)))
    return Manifold.batch_boolean(parts, _ADD)


def _limb(path_mm: np.ndarray, from_mm: float, to_mm: float, thick_mm: float) -> Manifold:
    """Return a bar along a path in the plane z = 0; its half width changes linearly."""
    knots = [
        Manifold.cylinder(thick_mm, radius_mm, radius_mm * 0.8, SEGMENTS, True).translate((x, y, 0))
        for (x, y), radius_mm in zip(
            path_mm, np.linspace(from_mm, to_mm, len(path_mm)), strict=True
        )
    ]
    spans = [Manifold.batch_hull([a, b]) for a, b in pairwise(knots)]
    return Manifold.batch_boolean(spans, _ADD)
