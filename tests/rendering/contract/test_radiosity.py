"""Light over several surfaces, compared with radiosity and with conservation of energy."""

import numpy as np
import pytest
from backends import slow
from stage import centred, in_camera, lambert, make_rig, plain_pattern

from graycast.base.frames import look_at, transform_points
from graycast.rendering import Quality
from graycast.world.scene import EMPTY_LAYOUT, Environment, Quad, Scene, Sphere

SIDE_M, ALBEDO, INTENSITY = 0.3, 0.8, 10.0
WHITE = Environment(radiance=(1.0, 1.0, 1.0))


def form_factors(point, normal, corners):
    """Return the share of the hemisphere's cosine-weighted light that comes from each polygon.

    Lambert's formula, 1 / (2 pi) sum over edges of angle times cosine (1760); exact for polygons
    above the horizon. Shapes: points (p, 3), one normal, polygons (q, 4, 3) seen clockwise along
    the normal's side; returns (p, q).
    """
    total = np.zeros((len(point), len(corners)))
    arm = corners[None] - point[:, None, None]
    arm /= np.linalg.norm(arm, axis=-1, keepdims=True)
    for i in range(4):
        a, b = arm[:, :, i], arm[:, :, (i + 1) % 4]
        cross = np.cross(a, b)
        length = np.sqrt((cross * cross).sum(axis=-1))
        angle = np.arctan2(length, (a * b).sum(axis=-1))
        total += angle * (cross @ normal) / np.maximum(length, 1e-300)
    return np.abs(total) / (2 * np.pi)


class Groove:
    """Two white squares at a right angle, x = 0 and z = 0, with the y axis as their edge."""

    def __init__(self, n, lens_m):
        self.lens_m = lens_m
        edge = SIDE_M * np.linspace(0, 1, n + 1) ** 2  # finer towards the edge
        along = SIDE_M * np.linspace(-1, 1, n + 1)
        a0, y0 = (g.ravel() for g in np.meshgrid(edge[:-1], along[:-1], indexing="ij"))
        a1, y1 = (g.ravel() for g in np.meshgrid(edge[1:], along[1:], indexing="ij"))
        zero = np.zeros_like(a0)
        floor = [(a0, y0), (a1, y0), (a1, y1), (a0, y1)]
        self.corners = (
            np.stack([np.stack([a, y, zero], axis=-1) for a, y in floor], axis=1),
            np.stack([np.stack([zero, y, a], axis=-1) for a, y in floor], axis=1),
        )
        self.normals = (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        middles = [corners.mean(axis=1) for corners in self.corners]
        self.direct = [self.irradiance(m, n) for m, n in zip(middles, self.normals, strict=True)]
        self.between = [
            form_factors(middles[0], self.normals[0], self.corners[1]),
            form_factors(middles[1], self.normals[1], self.corners[0]),
        ]

    def irradiance(self, point, normal):
        to_lens = self.lens_m - point
        return INTENSITY * (to_lens @ normal) / np.linalg.norm(to_lens, axis=-1) ** 3

    def radiance(self, point, side, depth):
        """Return the radiance [W sr^-1 m^-2] of points of a square for up to `depth` vertices.

        Radiosity as a Neumann series on the patches; the last gathering is exact per point.
        """
        leaving = [ALBEDO * e for e in self.direct]
        for _ in range(depth - 2):
            leaving = [ALBEDO * (self.direct[i] + self.between[i] @ leaving[1 - i]) for i in (0, 1)]
        arriving = self.irradiance(point, self.normals[side])
        if depth > 1:
            factors = form_factors(point, self.normals[side], self.corners[1 - side])
            arriving = arriving + factors @ leaving[1 - side]
        return ALBEDO / np.pi * arriving


def groove_scene(material, environment):
    rig = make_rig(
        centred(40, 30, 62), centred(40, 40, 22), baseline_m=(0.1, 0.0, 0.0), intensity_w_sr=10.0
    )
    T_world_cam = look_at(np.array([0.62, -0.1, 0.5]), np.array([0.08, 0.0, 0.08]), -np.eye(3)[2])
    floor = Quad(
        center_m=(SIDE_M / 2, 0.0, 0.0),
        half_u_m=(SIDE_M / 2, 0.0, 0.0),
        half_v_m=(0.0, SIDE_M, 0.0),
        material=material,
    )
    back = Quad(
        center_m=(0.0, 0.0, SIDE_M / 2),
        half_u_m=(0.0, SIDE_M, 0.0),
        half_v_m=(0.0, 0.0, SIDE_M / 2),
        material=material,
    )
    return Scene(rig=rig, T_world_cam=T_world_cam, surfaces=(floor, back), environment=environment)


def whole_pixels(truth, T_world_cam, camera):
    """Return each pixel's world point, and the pixels at least a pixel inside either square."""
    y, x = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    ray = np.stack([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px], axis=-1)
    ray = np.concatenate([ray, np.ones_like(ray[..., :1])], axis=-1)
    point = transform_points(T_world_cam, ray * np.float64(truth.depth_m)[..., None])
    margin = 0.02
    inside = (np.abs(point[..., 1]) < SIDE_M - margin) & (point[..., :2].sum(axis=-1) < 9)
    on_floor = inside & (abs(point[..., 2]) < 1e-5) & (point[..., 0] > margin)
    on_back = inside & (abs(point[..., 0]) < 1e-5) & (point[..., 2] > margin)
    on_floor &= point[..., 0] < SIDE_M - margin
    on_back &= point[..., 2] < SIDE_M - margin
    return point, (on_floor, on_back)


@pytest.fixture(scope="module")
def groove(path_tracer):
    """Return the scene, its radiosity solution, its pictures (seeds, h, w) and their truth."""
    dark = Environment(radiance=(0.0, 0.0, 0.0))
    scene = groove_scene(lambert(ALBEDO), dark)
    lens_m = (scene.T_world_cam @ scene.rig.T_cam_proj)[:3, 3]
    pattern = plain_pattern(scene.rig, 255)

    def images(depth, seeds=6, samples=25):
        quality = Quality(samples=samples, depth=depth)
        renderings = [
            path_tracer.render(scene, EMPTY_LAYOUT, pattern, quality=quality, seed=seed)
            for seed in range(seeds)
        ]
        truth = renderings[0].truth
        return np.stack([r.radiance.pattern[0] for r in renderings]).astype(float), truth

    return scene, Groove(20, lens_m), images


def deviation(images, truth, scene, model, depth):
    """Return mean and standard error of simulated over predicted per square, and block scores."""
    point, sides = whole_pixels(truth, scene.T_world_cam, scene.rig.camera)
    ratios, scores = [], []
    for side, mask in enumerate(sides):
        assert mask.sum() > 150
        share = images[:, mask] / model.radiance(point[mask], side, depth)
        ratios.append(share.mean())
        split = share[:, : mask.sum() // 25 * 25].reshape(len(images), -1, 25).mean(axis=-1)
        error = split.std(axis=0, ddof=1) / np.sqrt(len(images))
        scores.append((split.mean(axis=0) - 1) / np.hypot(error, 0.003))
    return np.array(ratios), np.concatenate(scores)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [slow(1), slow(2), 3, slow(16)])
def test_two_walls_light_each_other_as_radiosity_predicts(groove, depth):
    """Every further vertex of a path adds one term of the Neumann series. The solution on 20 x 20
    patches per wall is converged to 0.1 % (next test); a pixel's width costs up to 0.2 %.
    """
    scene, model, images = groove
    ratio, score = deviation(*images(depth), scene, model, depth)
    assert np.abs(ratio - 1).max() < 0.004
    assert np.abs(score).max() < 5


@pytest.mark.slow
def test_the_radiosity_solution_has_converged_and_differs_from_direct_light(groove):
    scene, fine, images = groove
    coarse = Groove(10, fine.lens_m)
    point = np.stack([np.linspace(0.02, 0.28, 9), np.linspace(-0.2, 0.2, 9), np.zeros(9)], axis=1)
    assert np.abs(coarse.radiance(point, 0, 16) / fine.radiance(point, 0, 16) - 1).max() < 0.004
    ratio, score = deviation(*images(1, seeds=2), scene, fine, 16)
    assert ratio.max() < 0.9
    assert np.abs(score).max() > 20


@pytest.mark.slow
@pytest.mark.parametrize("shape", [slow("sphere"), "groove"])
def test_a_white_object_in_uniform_white_light_is_invisible(path_tracer, shape):
    """White furnace: with albedo 1 and a constant radiance of 1, every pixel is 1."""
    if shape == "groove":
        scene = groove_scene(lambert(1.0), WHITE)
    else:
        ball = Sphere(center_m=(0.0, 0.0, 1.0), radius_m=0.3, material=lambert(1.0))
        rig = make_rig(centred(40, 30, 50), centred(8, 8, 8))
        scene = in_camera(rig, ball, environment=WHITE)
    quality = Quality(samples=64, depth=64)
    images = np.stack(
        [
            path_tracer.render(
                scene, EMPTY_LAYOUT, plain_pattern(scene.rig, 0), quality=quality, seed=seed
            ).radiance.ambient_rgb[..., 0]
            for seed in range(8)
        ]
    ).astype(float)
    mean = images.mean(axis=(1, 2))
    error = mean.std(ddof=1) / np.sqrt(8)
    assert error < 1e-3
    assert abs(mean.mean() - 1) < 4 * error + 1e-6  # float32; Cycles' light has no noise here
    assert np.abs(images.mean(axis=0) - 1).max() < 0.25  # no pixel is a hole or a leak
