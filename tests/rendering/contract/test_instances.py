"""The visible instance of each pixel, complete silhouettes, and surfaces of parts."""

import numpy as np
import pytest
from stage import (
    SOMEWHERE,
    askew_rig,
    box_part,
    centre_rays,
    centred,
    in_camera,
    lambert,
    layout_in_camera,
    make_rig,
    optics,
    plain_pattern,
    turned,
    wall,
)

from graycast.base.frames import inverse, random_quaternions, rigid, rotation_from_quaternion
from graycast.rendering import Quality
from graycast.rig.optics import rays
from graycast.world.parts import Grain, Material, Mesh, Part
from graycast.world.scene import EMPTY_LAYOUT, Bin, Environment
from studies.crates import Crate

ONE = Quality(samples=1, depth=1)
HALVES = (np.array([0.05, 0.03, 0.02]), np.array([0.02, 0.06, 0.03]))
KINDS = tuple(
    box_part(half, lambert(0.5), name=f"box{i}") for i, half in enumerate(HALVES)
)  # two kinds with one material, which must not become one shape


def truth_of(renderer, scene, layout):
    pattern = plain_pattern(scene.rig, 255)
    return renderer.render(scene, layout, pattern, quality=ONE, seed=0).truth


def slab_depth(ray, pose, half):
    """Return z at which rays (h, w, 3) of unit z enter a box; infinity for none (slab method)."""
    T_box_cam = inverse(pose)
    origin, direction = T_box_cam[:3, 3], ray @ T_box_cam[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (-half - origin) / direction, (half - origin) / direction
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((enter < leave) & (leave > 0), enter, np.inf)


def heap(count, seed, *, spread_m=(0.35, 0.25, 0.1)):
    """Return boxes of both kinds: some hidden, some cut by the border, some outside."""
    rng = np.random.default_rng(seed)
    rotations = rotation_from_quaternion(random_quaternions(count, rng))
    places = rng.uniform(-1, 1, (count, 3)) * spread_m + [0.0, 0.0, 0.8]
    poses = [rigid(r, p) for r, p in zip(rotations, places, strict=True)]
    return rng.integers(0, 2, count), poses


@pytest.mark.slow
def test_ids_depth_and_silhouettes_of_a_heap_agree_with_the_slab_method(path_tracer):
    """Oracle: the slab method, box by box. 70 instances need more than two words of bits;
    silhouettes extend beyond the border by up to one image size. Edges may differ by rounding.
    """
    camera = optics(96, 72, 110)
    rig = askew_rig(camera=camera)
    index, poses = heap(70, 8)
    scene = in_camera(rig, wall(1.2, lambert(0.5)), parts=KINDS)
    truth = truth_of(path_tracer, scene, layout_in_camera(index, poses))

    y, x = np.mgrid[-72:144, -96:192].astype(float)
    ray = [(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, np.ones_like(x)]
    ray = np.stack(ray, axis=-1)
    depth = np.stack(
        [slab_depth(ray, pose, HALVES[i]) for i, pose in zip(index, poses, strict=True)]
    )
    for i, silhouette in enumerate(truth.amodal):
        whole = np.zeros(x.shape, dtype=bool)
        h, w = silhouette.mask.shape
        top, left = silhouette.top_px + 72, silhouette.left_px + 96
        assert h == 0 or (silhouette.mask.any(axis=1).all() or silhouette.mask.any(axis=0).all())
        whole[top : top + h, left : left + w] = silhouette.mask
        assert (whole != np.isfinite(depth[i])).sum() <= 2
        assert np.array_equal(silhouette.in_image(72, 96), whole[72:144, 96:192])

    inside = depth[:, 72:144, 96:192]
    nearest = np.where(inside.min(axis=0) < 1.2, inside.argmin(axis=0), -1)
    assert (truth.instance != nearest).sum() <= 10
    same = truth.instance == nearest
    expected = np.minimum(inside.min(axis=0), 1.2)
    assert np.abs(truth.depth_m - expected)[same].max() < 1e-5
    visible = np.unique(truth.instance)
    assert 20 < len(visible) < 70  # some boxes are hidden and some are outside of the image
    for i in visible[visible >= 0]:
        assert truth.amodal[i].in_image(72, 96)[truth.instance == i].all()


@pytest.mark.slow
def test_other_parts_do_not_change_a_silhouette(path_tracer):
    """Each instance alone in the scene has the same silhouette, and all of it is visible."""
    rig = askew_rig()
    index, poses = heap(12, 3)
    scene = in_camera(rig, parts=KINDS)
    together = truth_of(path_tracer, scene, layout_in_camera(index, poses)).amodal
    for i, pose in enumerate(poses):
        alone = truth_of(path_tracer, scene, layout_in_camera(index[i : i + 1], [pose]))
        one = alone.amodal[0]
        assert (one.left_px, one.top_px) == (together[i].left_px, together[i].top_px)
        assert np.array_equal(one.mask, together[i].mask)
        assert np.array_equal(alone.instance == 0, one.in_image(72, 96))


def test_a_part_partly_outside_the_image_has_a_complete_silhouette(path_tracer):
    """A square on the left border: its mask is symmetric about the border, half of it outside."""
    rig = make_rig(centred(64, 48, 80), centred(32, 24, 40))
    half = np.array([0.1, 0.1, 0.001])
    left = (-0.5 - rig.camera.cx_px) / 80
    pose = rigid(np.eye(3), np.array([left * 1.001, 0.0, 1.001]))
    scene = in_camera(rig, parts=(box_part(half, lambert(0.5)),))
    silhouette = truth_of(path_tracer, scene, layout_in_camera([0], [pose])).amodal[0]
    assert silhouette.left_px == -8 and silhouette.mask.shape == (16, 16)
    assert silhouette.mask.all()
    assert silhouette.in_image(48, 64).sum() == 8 * 16


def test_parts_out_of_sight_have_an_empty_silhouette_or_one_outside_the_image(path_tracer):
    rig = make_rig(centred(64, 48, 80), centred(32, 24, 40))
    places = [(0.0, 0.0, -0.5), (5.0, 0.0, 1.0), (0.6, 0.0, 1.0)]
    poses = [rigid(np.eye(3), np.array(p)) for p in places]
    scene = in_camera(rig, parts=KINDS[:1])
    truth = truth_of(path_tracer, scene, layout_in_camera([0, 0, 0], poses))
    behind, far, beside = truth.amodal
    assert behind.mask.shape == (0, 0) and far.mask.shape == (0, 0)
    assert beside.left_px >= 64 and beside.mask.any()
    assert not any(s.in_image(48, 64).any() for s in truth.amodal)
    assert (truth.instance == -1).all() and np.isnan(truth.depth_m).all()


def test_a_distorted_lens_bends_silhouettes_and_gives_no_ghosts(path_tracer):
    """A barrel lens folds over at r^2 = 1 / (3 |k1|), which it images at 2/3 of that radius: pixels
    further out have no ray. Inside, the oracle is the slab method on undistorted rays, for a rod
    across the top whose image bulges, a box in the middle and one far outside.
    """
    k1 = -0.15
    camera = optics(96, 72, 72, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    rod = np.array([0.55, 0.02, 0.02])
    halves = [HALVES[0], rod]
    places = [(0.05, 0.1, 0.8), (0.0, -0.36, 0.8), (2.2, 0.1, 0.8)]
    index, poses = [0, 1, 0], [rigid(np.eye(3), np.array(p)) for p in places]
    parts = (KINDS[0], box_part(rod, lambert(0.5), name="rod"))
    scene = in_camera(askew_rig(camera=camera), parts=parts)
    truth = truth_of(path_tracer, scene, layout_in_camera(index, poses))

    y, x = np.mgrid[-72:144, -96:192].astype(float)
    radius = np.hypot((x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px)
    fold = 2 / 3 * np.sqrt(1 / (3 * abs(k1)))
    within, beyond = radius < 0.98 * fold, radius > 1.01 * fold
    assert within[72:144, 96:192].all() and beyond.sum() > 1000
    ray = np.full((*x.shape, 3), np.nan)
    ray[within] = rays(camera, np.stack([x, y], axis=-1)[within])
    if path_tracer.name == "cycles":  # silhouettes end at the border of the distorted image
        within[:72], within[144:], within[:, :96], within[:, 192:] = False, False, False, False
    for i, silhouette in enumerate(truth.amodal):
        whole = np.zeros(x.shape, dtype=bool)
        h, w = silhouette.mask.shape
        top, left = silhouette.top_px + 72, silhouette.left_px + 96
        whole[top : top + h, left : left + w] = silhouette.mask
        expected = np.isfinite(slab_depth(ray, poses[i], halves[index[i]]))
        assert (whole != expected)[within].sum() <= 2
        assert not whole[beyond].any()
        assert silhouette.in_image(72, 96)[truth.instance == i].all()
    assert not truth.amodal[2].mask.any()


def square_part(material, *, corner_normals=None):
    """Return a square of 0.1 m whose front is its -z side, so that with a pose of identity it faces
    the camera: u to the camera's right, v up.
    """
    vertices = 0.1 * np.array(
        [[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]
    )
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = Mesh(
        vertices_m=vertices, faces=faces, corner_uv=uv[faces], corner_normals=corner_normals
    )
    return Part(name="square", mesh=mesh, material=material, density_kg_m3=1.0, friction=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_texture_has_row_0_at_the_top_and_srgb_levels(path_tracer, metallic):
    """Four quarters of known colours; linear values by the sRGB curve of IEC 61966-2-1."""
    texture = np.zeros((64, 64, 3), dtype=np.uint8)
    texture[:32, :32], texture[:32, 32:] = (255, 0, 0), (0, 255, 0)
    texture[32:, :32], texture[32:, 32:] = (0, 0, 255), (188, 100, 30)
    part = square_part(Material(texture=texture, metallic=metallic, specular=0.0))
    rig = make_rig(centred(32, 32, 100), centred(32, 24, 40))
    scene = in_camera(rig, parts=(part,))
    layout = layout_in_camera([0], [rigid(np.eye(3), np.array([0.0, 0.0, 1.0]))])
    rendering = path_tracer.render(scene, layout, plain_pattern(rig, 255), quality=ONE, seed=0)
    albedo = rendering.radiance.albedo
    linear = ((np.array([188, 100, 30]) / 255 + 0.055) / 1.055) ** 2.4
    rounding = 2e-3 if path_tracer.device == "cuda" else 1e-3  # Cycles' textures have 16 bits
    assert np.abs(albedo[8:14, 8:14] - [1, 0, 0]).max() < rounding
    assert np.abs(albedo[8:14, 18:24] - [0, 1, 0]).max() < rounding
    assert np.abs(albedo[18:24, 8:14] - [0, 0, 1]).max() < rounding
    assert np.abs(albedo[18:24, 18:24] - linear).max() < rounding
    assert (rendering.truth.instance[8:24, 8:24] == 0).all()
    if metallic == 0:
        light = rendering.radiance.white_rgb
        assert light[10, 10, 0] > 0 and light[10, 10, 1] == 0 and light[10, 20, 0] == 0


@pytest.mark.slow
def test_corner_normals_change_the_shading_but_not_the_geometric_normals(path_tracer):
    """Lambert's cosine with the given normal; the truth keeps the plane's normal."""
    normal = np.array([0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, -1.0])
    part = square_part(lambert(0.8), corner_normals=np.tile(normal, (2, 3, 1)))
    rig = make_rig(centred(32, 32, 100), centred(32, 24, 40), baseline_m=(0.2, 0.0, 0.0))
    pose = rigid(turned(0.0, 0.0, 0.3), np.array([0.0, 0.0, 1.0]))
    scene = in_camera(rig, parts=(part,))
    rendering = path_tracer.render(
        scene,
        layout_in_camera([0], [pose]),
        plain_pattern(rig, 255),
        quality=Quality(samples=16, depth=1),
        seed=0,
    )
    to_lens = np.array([0.2, 0.0, 0.0]) - centre_rays(rig.camera)
    distance = np.linalg.norm(to_lens, axis=-1)
    expected = 0.8 / np.pi * 10.0 * (to_lens @ (pose[:3, :3] @ normal)) / distance**3
    inside = np.s_[11:21, 11:21]
    assert np.abs(rendering.radiance.pattern[0] / expected - 1)[inside].max() < 0.003
    assert np.abs(rendering.truth.normal[inside] - [0.0, 0.0, -1.0]).max() < 1e-6


def smooth_ball(radius_m, material):
    """Return a sphere of flat triangles, 4 degrees wide, that is shaded as a smooth sphere."""
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, 91), np.linspace(0, np.pi, 46))
    ring = np.sin(height)
    point = np.stack([ring * np.cos(turn), ring * np.sin(turn), np.cos(height)], axis=-1)
    number = np.arange(91 * 46).reshape(46, 91)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    lower, upper = np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)
    faces = np.concatenate([lower[:-90], upper[90:]])  # squares at the poles are triangles
    point = point.reshape(-1, 3)
    mesh = Mesh(vertices_m=radius_m * point, faces=faces, corner_normals=point[faces])
    return Part(name="ball", mesh=mesh, material=material, density_kg_m3=1.0, friction=0.5)


def test_a_smooth_mesh_is_lit_like_the_approximated_sphere(path_tracer):
    """Lambert's cosine with the true normal, where neither lens is at a grazing angle.

    A pixel spans 0.08 rad of the ball, and twice that at a slope of 66 degrees: its mean is up to
    0.3 % below the value at its centre. Facets add 0.06 %.
    """
    rig = make_rig(centred(48, 36, 100), centred(32, 32, 40), baseline_m=(0.2, 0.05, 0.0))
    centre, radius = np.array([0.02, -0.01, 0.8]), 0.1
    scene = in_camera(rig, parts=(smooth_ball(radius, lambert(0.8)),))
    layout = layout_in_camera([0], [rigid(turned(0.3, 0.2, 0.1), centre)])
    rendering = path_tracer.render(
        scene, layout, plain_pattern(rig, 255), quality=Quality(samples=64, depth=1), seed=0
    )
    ray = centre_rays(rig.camera)
    a, b = (ray * ray).sum(-1), ray @ centre
    with np.errstate(invalid="ignore"):
        z = (b - np.sqrt(b * b - a * (centre @ centre - radius**2))) / a
    point = ray * z[..., None]
    normal = (point - centre) / radius
    to_lens = np.array([0.2, 0.05, 0.0]) - point
    distance = np.linalg.norm(to_lens, axis=-1)
    cosine = (to_lens * normal).sum(axis=-1) / distance
    view_cosine = -(ray * normal).sum(axis=-1) / np.sqrt(a)
    with np.errstate(invalid="ignore"):
        inside = (cosine > 0.4) & (view_cosine > 0.4)
    assert inside.sum() > 250
    expected = 0.8 / np.pi * 10.0 * cosine / distance**2
    light = rendering.radiance.pattern[0]
    assert np.abs(light / expected - 1)[inside].max() < 0.015
    assert abs(light[inside].sum() / expected[inside].sum() - 1) < 0.0036
    # The sagitta of a facet along its diagonal is 0.12 mm, and 2.5 times that at a slant.
    assert np.abs(rendering.truth.depth_m - z)[inside].max() < 3e-4


def test_a_bin_rests_on_its_table_centred_on_the_origin(path_tracer):
    """Seen from straight above: rim, floor and table at their heights, walls at their sizes."""
    box = Bin(inner_m=(0.4, 0.3, 0.1), wall_m=0.02, material=lambert(0.5))
    rig = make_rig(centred(120, 90, 150), centred(32, 24, 40))
    pose = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    scene = in_camera(rig, T_world_cam=pose, bin=box)
    truth = truth_of(path_tracer, scene, EMPTY_LAYOUT)
    z = 1.0 - truth.depth_m
    ray = centre_rays(rig.camera)
    x, y = np.abs(ray[..., 0]), np.abs(ray[..., 1])
    slack = 0.004
    floor = (x < 0.2 / 1.0 - slack) & (y < 0.15 - slack)
    rim_x, rim_y = x * 0.9, y * 0.9
    rim = (rim_x < 0.22 - slack) & (rim_y < 0.17 - slack)
    rim &= (rim_x > 0.2 + slack) | (rim_y > 0.15 + slack)
    table = (rim_x > 0.22 + slack) | (rim_y > 0.17 + slack)
    assert floor.sum() > 1000 and rim.sum() > 100 and table.sum() > 1000
    assert np.abs(z[floor & ~(rim_x > 0.2 - slack)]).max() < 1e-5
    assert np.abs(z[rim] - 0.1).max() < 1e-5
    assert np.abs(z[table] + 0.02).max() < 1e-5
    assert (truth.instance == -1).all()


def test_the_inclined_walls_of_a_mesh_bin_are_rendered(path_tracer, tmp_path):
    """Seen from straight above, each ray ends at a wall, on the rim, or on the table."""
    crate = Crate(lean=0.5, rim_m=0.03)  # The crate opens wider than the cone of rays.
    rig = make_rig(centred(120, 90, 110), centred(32, 24, 40))
    pose = rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    scene = in_camera(rig, T_world_cam=pose, bin=crate.bin(tmp_path))
    truth = truth_of(path_tracer, scene, EMPTY_LAYOUT)
    ray = np.abs(centre_rays(rig.camera)[..., :2])
    depth, half = crate.inner_m[2], crate.half_m(0)
    # On the wall x = half + lean z, and x = r (1 - z): z = (r - half) / (lean + r).
    wall_z = ((ray - half) / (crate.lean + ray)).max(axis=-1)
    at_rim = ray * (1 - depth)
    inside = (at_rim < crate.half_m(depth) - 0.004).all(axis=-1)
    beyond = (at_rim > crate.half_m(depth) + crate.rim_m + 0.004).any(axis=-1)
    rim = ~inside & ~beyond & (at_rim > crate.half_m(depth) + 0.004).any(axis=-1)
    rim &= (at_rim < crate.half_m(depth) + crate.rim_m - 0.004).all(axis=-1)
    z = 1.0 - truth.depth_m
    assert min(inside.sum(), beyond.sum(), rim.sum()) > 100
    assert (wall_z[inside] > 0.01).sum() > 300
    assert np.abs(z - np.maximum(wall_z, 0))[inside].max() < 1e-5
    assert np.abs(z[rim] - depth).max() < 1e-5
    assert np.abs(z[beyond] + 0.010).max() < 1e-5
    assert (truth.instance == -1).all()


def test_a_wall_behind_the_camera_is_invisible(path_tracer):
    rig = askew_rig()
    scene = in_camera(rig, wall(1.0, lambert(0.5)), T_world_cam=SOMEWHERE)
    flipped = in_camera(
        rig, wall(-1.0, lambert(0.5)), environment=Environment(radiance=(0.0, 0.0, 0.0))
    )
    assert np.isfinite(truth_of(path_tracer, scene, EMPTY_LAYOUT).depth_m).all()
    truth = truth_of(path_tracer, flipped, EMPTY_LAYOUT)
    assert np.isnan(truth.depth_m).all() and np.isnan(truth.normal).all()


@pytest.mark.slow
@pytest.mark.parametrize("turned_grain", [False, True])
def test_grooves_are_rotated_with_their_part(path_tracer, turned_grain):
    """Two squares with different rotations under the projector. Oracle for each pixel: GGX with two
    widths, its x along the grooves of the part (Burley's aspect, Heitz' masking). At roughness
    0.25, multiple reflection adds less than 1 %.
    """
    point_m = np.array([0.03, -0.02, 0.0])
    grain = Grain(axis=(0.6, 0.8, 0.0))
    if turned_grain:
        grain = Grain(axis=(0.0, 0.0, 1.0), turned=True, point_m=tuple(point_m.tolist()))
    metal = Material(
        base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=0.25, anisotropy=0.8, grain=grain
    )
    rig = make_rig(centred(64, 32, 130), centred(64, 32, 40), baseline_m=(0.25, 0.1, 0.0))
    poses = [
        rigid(turned(0.1, 0.1, angle), np.array([x, 0.0, 1.0]))
        for angle, x in ((0.9, -0.12), (2.5, 0.12))
    ]
    scene = in_camera(rig, parts=(square_part(metal),))
    rendering = path_tracer.render(
        scene,
        layout_in_camera([0, 0], poses),
        plain_pattern(rig, 255),
        quality=Quality(samples=256, depth=1),
        seed=0,
    )
    ray = centre_rays(rig.camera)
    aspect = np.sqrt(1 - 0.9 * 0.8)
    along, across = 0.25**2 * aspect, 0.25**2 / aspect
    for number, pose in enumerate(poses):
        R, t = pose[:3, :3], pose[:3, 3]
        hit = ray * ((t @ R[:, 2]) / (ray @ R[:, 2]))[..., None]
        own = (hit - t) @ R
        way = np.cross([0.0, 0.0, 1.0], own - point_m) if turned_grain else np.array(grain.axis)
        x = np.broadcast_to(way / np.linalg.norm(way, axis=-1, keepdims=True), own.shape)
        normal = np.broadcast_to([0.0, 0.0, -1.0], own.shape)  # the front of the square
        to_lens = np.array([0.25, 0.1, 0.0]) - hit
        d = np.linalg.norm(to_lens, axis=-1)
        frame = np.stack([x, np.cross(normal, x), normal])
        wi = np.einsum("khwi,hwi->khw", frame, -hit @ R / np.linalg.norm(hit, axis=-1)[..., None])
        wo = np.einsum("khwi,hwi->khw", frame, to_lens @ R / d[..., None])
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=0)
        slope2 = (half[0] / half[2] / along) ** 2 + (half[1] / half[2] / across) ** 2
        density = 1 / (np.pi * along * across * half[2] ** 4 * (1 + slope2) ** 2)
        hidden = [
            0.5 * (np.sqrt(1 + ((along * w[0]) ** 2 + (across * w[1]) ** 2) / w[2] ** 2) - 1)
            for w in (wi, wo)
        ]
        value = density / (1 + hidden[0] + hidden[1]) / (4 * wi[2] * wo[2])
        expected = value * rig.intensity_w_sr * wo[2] / d**2
        inside = np.abs(own[..., :2]).max(axis=-1) < 0.085
        inside &= np.linalg.norm(own - point_m, axis=-1) > 0.05
        ratio = rendering.radiance.white[inside] / expected[inside]
        assert (rendering.truth.instance[inside] == number).all() and inside.sum() > 100
        assert expected[inside].max() > 5 * expected[inside].min()
        assert abs(np.median(ratio) - 1.01) < 0.015
        assert np.abs(ratio / np.median(ratio) - 1).max() < 0.08
