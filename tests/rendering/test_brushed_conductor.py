"""Metal with grooves: energy, published shape, samples and their density, direction of grooves."""

import numpy as np
import pytest
from backends import slow
from bsdf_samples import (
    arriving,
    assert_samples_fall_where_densities_say,
    direction,
    evaluated,
    leaning,
    samples_of,
    upper,
)

from graycast.base.frames import axis_rotation, rigid
from graycast.world.parts import Grain, Material, Mesh

WHITE, GOLD = (1.0, 1.0, 1.0), (1.0, 0.7, 0.3)
# Roughness, anisotropy, and the share of light that white metal may lose.
CASES = [
    (0.1, 0.8, 0.003), slow(0.3, 0.6, 0.003), (0.35, 0.8, 0.003), (0.5, 1.0, 0.003),
    (0.8, 0.8, 0.007), (1.0, 1.0, 0.014),
]  # fmt: skip
SHAPES = [(0.25, 0.7), (0.35, 0.8), (0.5, 1.0)]


def widths(roughness, anisotropy):
    """Return the widths along and across the grain, with Burley's aspect."""
    aspect = np.sqrt(1 - 0.9 * anisotropy)
    return roughness**2 * aspect, roughness**2 / aspect


def metal(along, across, reflectance=GOLD):
    import mitsuba as mi

    import graycast.rendering.mitsuba.scene  # noqa: F401  (registers the material)

    color = {"type": "rgb", "value": list(reflectance)}
    words = {"type": "brushed_conductor", "alpha": along, "alpha_across": across}
    return mi.load_dict(words | {"reflectance": color})


def one_reflection(wi, wo, along, across):
    """Return D G2 / (4 cos cos) of white facets, by Heitz' D over slopes and his Lambda.

    x is along the grain.
    """
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=0)
    slope2 = (half[0] / half[2] / along) ** 2 + (half[1] / half[2] / across) ** 2
    d = 1 / (np.pi * along * across * half[2] ** 4 * (1 + slope2) ** 2)
    hidden = []
    for w in (wi, wo):
        azimuth = np.arctan2(w[1], w[0])
        wide2 = (along * np.cos(azimuth)) ** 2 + (across * np.sin(azimuth)) ** 2
        hidden.append(0.5 * (np.sqrt(1 + wide2 * (1 / w[2] ** 2 - 1)) - 1))
    return d / (1 + hidden[0] + hidden[1]) / (4 * wi[2] * wo[2])


@pytest.mark.parametrize(("roughness", "anisotropy", "limit"), CASES)
@pytest.mark.parametrize(
    ("angle_deg", "turn_deg"),
    [
        (angle, turn) if (angle, turn) in ((80, 0), (45, 30)) else slow(angle, turn)
        for angle in (0, 45, 80, 88)
        for turn in (0, 30, 45, 70, 90)
    ],
)
def test_white_metal_with_grooves_absorbs_no_light(
    cpu_device, roughness, anisotropy, limit, turn_deg, angle_deg
):
    """The limits are those in `rough_conductor.lost_share`."""
    bsdf = metal(*widths(roughness, anisotropy), WHITE)
    weight = samples_of(bsdf, leaning(angle_deg, turn_deg), 400_000)[2][0]
    error = weight.std() / np.sqrt(weight.size)
    assert error < 0.004
    assert abs(weight.mean() - 1) < limit + 4 * error


@pytest.mark.parametrize(("roughness", "anisotropy"), SHAPES)
def test_the_grooved_lobe_has_the_published_shape(cpu_device, roughness, anisotropy):
    """The compensation is one factor for all outgoing directions: for white metal 1 / E, with E as
    a sum over a fine grid of directions.
    """
    along, across = widths(roughness, anisotropy)
    wi = leaning(40, 25)
    mirror, rng = wi * [-1, -1, 1], np.random.default_rng(1)
    wo = mirror[:, None] + 2 * np.array([along, across, along])[:, None] * rng.normal(size=(3, 800))
    wo /= np.linalg.norm(wo, axis=0)
    wo = wo[:, wo[2] > 0.05]
    ratio = evaluated(metal(along, across, WHITE), wi, wo)[0][0]
    ratio /= one_reflection(wi[:, None], wo, along, across)
    assert wo.shape[1] > 300
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.002
    z, turn = (np.arange(500) + 0.5) / 500, 2 * np.pi * (np.arange(500) + 0.5) / 500
    grid = np.stack(np.broadcast_arrays(*direction(z[:, None], turn[None]))).reshape(3, -1)
    albedo = 2 * np.pi * (one_reflection(wi[:, None], grid, along, across) * grid[2]).mean()
    assert abs(np.median(ratio) * albedo - 1) < 0.004


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.8])
def test_grooved_metal_without_anisotropy_equals_plain_metal(cpu_device, roughness):
    """Only the last digits of float32 may differ."""
    import mitsuba as mi

    alpha, color = roughness**2, {"type": "rgb", "value": list(GOLD)}
    plain = mi.load_dict({"type": "rough_conductor", "alpha": alpha, "reflectance": color})
    grooved, wi = metal(alpha, alpha), leaning(50, 35)
    wo = samples_of(plain, wi, 3000, seed=2)[0]
    wo = wo[:, wo[2] > 0.01]
    for one, other in zip(evaluated(plain, wi, wo), evaluated(grooved, wi, wo), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-3)
    for one, other in zip(samples_of(plain, wi, 3000), samples_of(grooved, wi, 3000), strict=True):
        assert np.abs(other - one)[..., one.ravel()[-3000:] > 0].max() < 2e-3 * np.abs(one).max()


@pytest.mark.parametrize(("roughness", "anisotropy"), SHAPES)
@pytest.mark.parametrize(("angle_deg", "turn_deg"), [(50, 25), (75, 80)])
def test_sample_weights_are_the_value_divided_by_the_density(
    cpu_device, roughness, anisotropy, angle_deg, turn_deg
):
    bsdf, wi = metal(*widths(roughness, anisotropy)), leaning(angle_deg, turn_deg)
    wo, density, weight = samples_of(bsdf, wi, 5000)
    above = weight[0] > 0
    value, again = evaluated(bsdf, wi, wo)
    value, again, weight = (value * wo[2])[:, above], again[above], weight[:, above]
    assert np.median(np.abs(again / density[above] - 1)) < 1e-3  # the half vector, in float32
    assert np.abs(again / density[above] - 1).max() < 0.05
    assert np.abs(value / again / weight - 1).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("roughness", "anisotropy"), [(0.5, 0.6), (0.6, 0.9)])
@pytest.mark.parametrize(("angle_deg", "turn_deg"), [(0, 0), (50, 25), slow(75, 80)])
def test_sample_densities_integrate_to_one_and_samples_follow_them(
    cpu_device, roughness, anisotropy, angle_deg, turn_deg
):
    bsdf, wi = metal(*widths(roughness, anisotropy)), leaning(angle_deg, turn_deg)
    assert_samples_fall_where_densities_say(bsdf, wi, fine=1024)


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [0, 60])
def test_samples_reflect_the_same_light_and_mean_direction_as_values(cpu_device, angle_deg):
    """Compare reflected light and its mean direction from samples with sums of values."""
    bsdf, wi, n = metal(*widths(0.7, 0.8)), leaning(angle_deg, 25), 400_000
    wo, _, weight = samples_of(bsdf, wi, n)
    other = upper(n, 5)
    value = evaluated(bsdf, wi, other)[0] * other[2] * 2 * np.pi
    for moment, same in ((weight[1], value[1]), (weight[1] * wo, value[1] * other)):
        error = np.hypot(moment.std(axis=-1), same.std(axis=-1)) / np.sqrt(n)
        assert (np.abs(moment.mean(axis=-1) - same.mean(axis=-1)) < 5 * error).all()


@pytest.mark.slow
@pytest.mark.parametrize(("roughness", "limit"), [(0.3, 1.05), (0.5, 1.04)])
def test_the_reciprocity_error_is_below_its_documented_limit(cpu_device, roughness, limit):
    """Oracle: the table in docs/explanation/light.md, within 60 degrees at anisotropy 0.8."""
    import mitsuba as mi

    bsdf = metal(*widths(roughness, 0.8), WHITE)
    a, b = upper(4000, 0), upper(4000, 1)
    near = (a[2] > 0.5) & (b[2] > 0.5)
    a, b = a[:, near], b[:, near]
    values = []
    for wi, wo in ((a, b), (b, a)):
        towards = mi.Vector3f(wo.astype(np.float32))
        value = bsdf.eval(mi.BSDFContext(), arriving(wi), towards, True)
        values.append(np.array(value)[0] / wo[2])
    ratio = np.maximum(values[0] / values[1], values[1] / values[0])
    assert limit - 0.5 * (limit - 1) < ratio.max() < limit


# --- the direction of the grooves on meshes ------------------------------------------------------


def plate(half_m=0.1):
    corner_m = half_m * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Mesh(vertices_m=corner_m, faces=np.array([[0, 1, 2], [0, 2, 3]]))


def hits(mesh, grain, poses, origin, ray, material=None):
    """Return a scene of parts, which must live as long as its hits, and the hits of rays along
    `ray` from `origin` (n, 3).
    """
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _mesh

    brushed = {"base_color": WHITE, "metallic": 1.0, "roughness": 0.35, "anisotropy": 0.8}
    material = material or Material(**brushed, grain=grain)
    scene = mi.load_dict({"type": "scene", "part": _mesh("part", mesh, material, np.stack(poses))})
    rays = mi.Ray3f(mi.Point3f(origin.T.astype("f4")), mi.Vector3f(*ray))
    return scene, scene.ray_intersect(rays)


def values_at(mesh, grain, poses, origin, ray, to_light, material=None):
    """Return hits (n, 3), normals, and the values towards a light, without the cosine."""
    import mitsuba as mi

    scene, si = hits(mesh, grain, poses, origin, ray.tolist(), material)
    wo = si.to_local(mi.Vector3f(*to_light.tolist()))
    value = si.bsdf().eval(mi.BSDFContext(), si, wo, si.is_valid())
    values = np.array(si.p).T, np.array(si.n).T, np.array(value)[0] / np.array(wo)[2]
    del scene
    return values


def expected_at(normal, grain, ray, to_light, *, roughness=0.35, anisotropy=0.8):
    """Return the closed form at each hit, in the frame of grain and normal."""
    grain = grain - (grain * normal).sum(axis=1, keepdims=True) * normal
    x = grain / np.linalg.norm(grain, axis=1, keepdims=True)
    frame = np.stack([x, np.cross(normal, x), normal])
    wi, wo = (np.einsum("kni,i->kn", frame, w) for w in (-np.array(ray), np.array(to_light)))
    return one_reflection(wi, wo, *widths(roughness, anisotropy))


RAY = np.array([0.3, -0.2, -0.933])
RAY /= np.linalg.norm(RAY)
LIGHT = np.array([0.5, 0.35, 0.79])
LIGHT /= np.linalg.norm(LIGHT)
TURNS = (
    axis_rotation("z", 0.7) @ axis_rotation("x", 0.3),
    axis_rotation("y", -0.2) @ axis_rotation("z", 2.0),
)
POSES = [rigid(turn, np.array([float(k), 0, 0])) for k, turn in enumerate(TURNS)]


def origins(places_m):
    return np.concatenate([places_m + pose[:3, 3] for pose in POSES]) - RAY


@pytest.mark.parametrize("turned", [False, True])
def test_grooves_rotate_with_each_instance(cpu_device, turned):
    """Two plates have different poses; each hit agrees with the formula in its own frame."""
    point_m = (0.02, -0.03, 0.0)
    grain = Grain(axis=(0.0, 0.0, 1.0), turned=True, point_m=point_m)
    grain = grain if turned else Grain(axis=(0.6, 0.8, 0.0))
    rng = np.random.default_rng(4)
    places = np.column_stack([rng.uniform(-0.06, 0.06, (300, 2)), np.zeros(300)])
    hit, normal, value = values_at(plate(), grain, POSES, origins(places), RAY, LIGHT)
    own = np.repeat(np.arange(2), 300)
    R, t = np.stack(POSES)[own, :3, :3], np.stack(POSES)[own, :3, 3]
    local = np.einsum("nji,nj->ni", R, hit - t)
    way = np.cross([0.0, 0, 1], local - point_m) if turned else np.tile(grain.axis, (600, 1))
    expected = expected_at(normal, np.einsum("nij,nj->ni", R, way), RAY, LIGHT)
    ratio = value / expected
    far = np.linalg.norm(local - point_m, axis=1) > 0.01
    assert far.sum() > 400 and expected[far].max() > 5 * expected[far].min()
    assert np.abs(ratio / np.median(ratio) - 1)[far].max() < 0.03
    assert 1 < np.median(ratio) < 1.06


def test_sampled_directions_follow_the_grooves_of_each_plate(cpu_device):
    """On a plate with diagonal grooves, each weight is value over density, evaluated again."""
    import mitsuba as mi

    rng = np.random.default_rng(6)
    places = np.column_stack([rng.uniform(-0.06, 0.06, (2000, 2)), np.zeros(2000)])
    scene, si = hits(plate(), Grain(axis=(0.6, 0.8, 0.0)), POSES, origins(places), RAY.tolist())
    uv = mi.Point2f(rng.random((2, 4000)).astype("f4"))
    bs, weight = si.bsdf().sample(mi.BSDFContext(), si, mi.Float(0.5), uv, True)
    value, density = si.bsdf().eval_pdf(mi.BSDFContext(), si, bs.wo, True)
    del scene
    above = np.array(weight)[0] > 0
    assert above.sum() > 3800
    weight, value = np.array(weight)[0, above], np.array(value)[0, above]
    density, stated = np.array(density)[above], np.array(bs.pdf)[above]
    assert np.abs(density / stated - 1).max() < 0.02
    assert np.abs(value / density / weight - 1).max() < 2e-3


def test_a_lathe_faced_disc_shines_along_a_line_through_its_centre(cpu_device):
    """Grooves are circles, so a point shines if the half vector is at right angles to them: on the
    line from the centre along the half vector's projection, for any rotation of the disc about its
    axis. A disc brushed in one direction shines evenly.
    """
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ring = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    half = LIGHT - RAY
    line = np.arctan2(half[1], half[0])
    for turn in (0.0, 1.1):
        pose = rigid(axis_rotation("z", turn), np.zeros(3))
        lathe = Grain(axis=(0.0, 0.0, 1.0), turned=True)
        value = values_at(plate(), lathe, [pose], ring - RAY, RAY, LIGHT)[2]
        off = np.abs(np.sin(angle - line))
        assert off[value > 0.9 * value.max()].max() < 0.1
        assert value[off > 0.7].max() < 0.2 * value.max()
        even = values_at(plate(), Grain(axis=(1.0, 0.0, 0.0)), [pose], ring - RAY, RAY, LIGHT)[2]
        assert np.ptp(even) < 0.01 * even.max()


def test_grooves_around_a_cylinder_give_a_narrower_highlight_than_grooves_along_it(cpu_device):
    """Seen and lit from far away, all points have the same half vector h. Grooves around the axis
    spread light along it: a line at the azimuth of h, whose width is the roughness across the line.
    Grooves along the axis spread light around it: the line is wider.
    """
    n = 256
    angle = 2 * np.pi * np.arange(n) / n
    rim = 0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corner = np.stack([np.append(r, h) for h in (-0.1, 0.1) for r in rim])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, n + j], 1), np.stack([i, n + j, n + i], 1)])
    mesh = Mesh(vertices_m=corner, faces=faces)
    pose = rigid(axis_rotation("y", np.pi / 2) @ axis_rotation("z", 0.4), np.zeros(3))  # z -> x
    ray, light = np.array([0.0, 0.0, -1.0]), np.array([0.0, np.sin(0.6), np.cos(0.6)])
    across = np.linspace(-0.045, 0.045, 601)
    origin = np.stack([0 * across, across, 0 * across + 1.0], axis=1)
    wide = {}
    for turned in (True, False):
        grain = Grain(axis=(0.0, 0.0, 1.0), turned=turned)
        hit, _, value = values_at(mesh, grain, [pose], origin, ray, light)
        azimuth = np.arcsin(hit[:, 1] / np.linalg.norm(hit[:, 1:], axis=1))
        bright = azimuth[value > 0.5 * value.max()]
        assert abs(bright.mean() - 0.3) < 0.02  # halfway between camera and lamp
        wide[turned] = np.ptp(bright)
    along, wide_alpha = widths(0.35, 0.8)
    # D falls to a half at a slope of sqrt(sqrt 2 - 1) widths, on both sides.
    assert abs(wide[True] / (2 * along * np.sqrt(np.sqrt(2) - 1)) - 1) < 0.3
    assert abs(wide[False] / (2 * wide_alpha * np.sqrt(np.sqrt(2) - 1)) - 1) < 0.2


def test_a_mesh_of_plain_metal_has_no_grain_attribute(cpu_device):
    import mitsuba as mi

    from graycast.rendering.mitsuba.scene import _mesh

    shape = _mesh("part", plate(), Material(metallic=1.0), np.eye(4)[None])
    assert not any("grain" in name for name, _ in mi.traverse(shape))
    assert "RoughConductor" in str(shape.bsdf())


@pytest.mark.slow
def test_a_half_metallic_surface_mixes_grooved_metal_and_plastic_equally(cpu_device):
    grain = Grain(axis=(0.6, 0.8, 0.0))
    looks = [
        Material(metallic=m, roughness=0.35, anisotropy=a, grain=grain)
        for m, a in ((1.0, 0.8), (0.0, 0.0), (0.5, 0.8))
    ]
    place = np.zeros((1, 3))
    metal_alone, plastic, both = (
        values_at(plate(), grain, POSES[:1], place - RAY, RAY, LIGHT, material=look)[2]
        for look in looks
    )
    assert abs(both / (0.5 * metal_alone + 0.5 * plastic) - 1) < 1e-4
