import json
from functools import cache

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, Mesh64
from PIL import Image

from graycast.base.frames import axis_rotation, rigid
from graycast.world.parts import BUILTIN, builtin_part
from graycast.world.parts.builtin import RING_PROFILE_MM, RING_SEGMENTS
from studies.printed_labels import (
    LABELS,
    LAYOUTS,
    pack,
    salt_box_panels,
    spray_panels,
    toothpaste_panels,
)

part_of = cache(builtin_part)  # No test changes a part.
# The outward normal of a panel, and the reader's upward direction.
READERS = {
    "front": ((0, -1, 0), (0, 0, 1)),
    "right": ((1, 0, 0), (0, 0, 1)),
    "back": ((0, 1, 0), (0, 0, 1)),
    "left": ((-1, 0, 0), (0, 0, 1)),
    "top": ((0, 0, 1), (0, 1, 0)),
}
MASS_KG = {
    "metal_workpiece_1": (0.15, 0.30),  # 60 x 40 x 30 mm, two fifths of it steel
    "metal_workpiece_2": (0.10, 0.16),
    "yellow_salt_cube": (0.66, 0.68),  # its print says 650 g; 20 g of carton
    "hygiene_spray": (0.28, 0.31),  # 250 ml and 45 g of plastic
    "toothpaste": (0.14, 0.17),  # 100 ml of paste at 1.3 kg per litre and 25 g of packaging
}


def as_trimesh(part):
    return trimesh.Trimesh(part.mesh.vertices_m, part.mesh.faces, process=False)


@pytest.mark.parametrize("name", BUILTIN)
def test_a_built_in_part_is_one_closed_body_around_the_origin(name):
    part = part_of(name)
    mesh = as_trimesh(part)
    assert part.name == name
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert len(mesh.faces) <= (12_000 if name == "metal_workpiece_2" else 10_000)
    assert np.abs(part.mesh.bounds_m.sum(axis=0)).max() < 1e-12
    assert (part.mesh.extent_m > 0.01).all() and part.mesh.extent_m.max() < 0.2
    lightest, heaviest = MASS_KG[name]
    assert lightest < mesh.volume * part.density_kg_m3 < heaviest
    assert (mesh.area_faces > 0).all()


@pytest.mark.parametrize("name", BUILTIN)
def test_shading_normals_of_a_built_in_part_deviate_at_most_by_its_facet_angle(name):
    part = part_of(name)
    normal = part.mesh.corner_normals
    assert np.abs(np.linalg.norm(normal, axis=-1) - 1).max() < 1e-12
    lean = np.einsum("fci,fi->fc", normal, as_trimesh(part).face_normals)
    assert np.degrees(np.arccos(lean.min())) < 35


@pytest.mark.parametrize("name", BUILTIN)
def test_a_built_in_part_is_the_same_each_time_it_is_made(name):
    one, other = builtin_part(name), builtin_part(name)
    assert np.array_equal(one.mesh.vertices_m, other.mesh.vertices_m)
    assert np.array_equal(one.mesh.faces, other.mesh.faces)
    if one.material.texture is not None:
        assert np.array_equal(one.material.texture, other.material.texture)


def test_the_error_for_an_unknown_part_lists_the_known_parts():
    with pytest.raises(ValueError, match=r"'salt'.*yellow_salt_cube.*toothpaste"):
        builtin_part("salt")


def test_the_volume_of_the_ring_follows_from_pappus_s_theorem():
    """Oracle: V = 2 pi * (first moment of the profile about the axis), in trapezoids along z.

    Each edge adds its z step times the mean of r^2 over it; chords enclose sin(x)/x of a circle.
    """
    r, z = np.array(RING_PROFILE_MM).T * 1e-3
    r_next, step = np.roll(r, -1), np.roll(z, -1) - z
    pappus = np.pi * (step * (r * r + r * r_next + r_next * r_next) / 3).sum()
    x = 2 * np.pi / RING_SEGMENTS
    volume = as_trimesh(part_of("metal_workpiece_2")).volume
    assert volume == pytest.approx(pappus * np.sin(x) / x, rel=1e-9)


def share_not_shared(part, T):
    """Return the volume of a part outside its own moved copy, over its volume."""
    mesh = Mesh64(part.mesh.vertices_m * 1e3, part.mesh.faces.astype(np.uint64))
    body = Manifold(mesh)
    T_mm = T[:3].copy()
    T_mm[:, 3] *= 1e3
    return (body - body.transform(T_mm)).volume() / body.volume()


def turn(axis, angle_rad):
    return rigid(axis_rotation(axis, angle_rad), np.zeros(3))


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN)
def test_every_declared_symmetry_maps_the_part_onto_itself(name):
    part = part_of(name)
    for T in part.symmetry.discrete:
        assert share_not_shared(part, T) < 1e-9
    for axis, point_m in part.symmetry.continuous:
        assert axis == (0.0, 0.0, 1.0) and point_m == (0.0, 0.0, 0.0)
        for angle_rad in (0.3, 1.0, 2.5):
            # Facets of 128 do not coincide: at most 1 - sin(x)/x of the outer disc, x = 2 pi/128.
            assert share_not_shared(part, turn("z", angle_rad)) < 2e-3


def test_the_metal_workpieces_have_no_undeclared_symmetry():
    """Half turns about the axes, and quarter turns of the workpieces, fit only if declared."""
    bracket, ring = part_of("metal_workpiece_1"), part_of("metal_workpiece_2")
    assert len(bracket.symmetry.discrete) == 1 and len(ring.symmetry.continuous) == 1
    for part, T in [
        (bracket, turn("x", np.pi)),
        (bracket, turn("y", np.pi)),
        (bracket, turn("z", np.pi / 2)),
        (ring, turn("x", np.pi)),
        (ring, turn("y", np.pi)),
    ]:
        assert share_not_shared(part, T) > 0.05


def test_printed_boxes_have_no_symmetry():
    for name in ("yellow_salt_cube", "toothpaste", "hygiene_spray"):
        assert part_of(name).symmetry.discrete == ()
        assert part_of(name).symmetry.continuous == ()


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_stored_label_pictures_equal_those_that_the_study_draws(name):
    draw, rows = LAYOUTS[name]
    image, places = pack(draw(), rows)
    assert np.array_equal(np.array(Image.open(LABELS / f"{name}.png")), image)
    assert json.loads((LABELS / "panels.json").read_text())[name] == places


def view_of(part, normal, up, right_m, up_m):
    """Return the texture that a far viewer sees at the points (right, up) [m], row by row.

    Parallel rays against every triangle, nearest hit, uv interpolated, nearest texel: independent
    of the program except for the conventions of `Material` and `Mesh`.
    """
    normal, up = np.array(normal, dtype=float), np.array(up, dtype=float)
    view = np.stack([np.cross(up, normal), up, normal])
    corner = (part.mesh.vertices_m @ view.T)[part.mesh.faces]
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    x, y = right_m.ravel(), up_m.ravel()
    nearest, uv = np.full(x.size, -np.inf), np.full((x.size, 2), np.nan)
    for f in np.flatnonzero(area > 1e-12):
        inside = np.flatnonzero(
            (x >= corner[f, :, 0].min()) & (x <= corner[f, :, 0].max())
            & (y >= corner[f, :, 1].min()) & (y <= corner[f, :, 1].max())
        )  # fmt: skip
        dx, dy = x[inside] - a[f, 0], y[inside] - a[f, 1]
        s = (dx * (c[f, 1] - a[f, 1]) - dy * (c[f, 0] - a[f, 0])) / area[f]
        t = ((b[f, 0] - a[f, 0]) * dy - (b[f, 1] - a[f, 1]) * dx) / area[f]
        weight = np.stack([1 - s - t, s, t], axis=1)
        z = weight @ corner[f, :, 2]
        hit = (weight >= -1e-9).all(axis=1) & (z > nearest[inside])
        nearest[inside[hit]] = z[hit]
        uv[inside[hit]] = weight[hit] @ part.mesh.corner_uv[f]
    h, w = part.material.texture.shape[:2]
    row, column = np.floor((1 - uv[:, 1]) * h).astype(int), np.floor(uv[:, 0] * w).astype(int)
    return part.material.texture[row, column].reshape(*right_m.shape, 3).astype(float)


def likeness(one, other):
    return np.corrcoef(one.mean(axis=-1).ravel(), other.mean(axis=-1).ravel())[0, 1]


@pytest.mark.parametrize("side", READERS)
@pytest.mark.parametrize(
    ("name", "panels"),
    [("yellow_salt_cube", cache(salt_box_panels)), ("toothpaste", cache(toothpaste_panels))],
)
def test_each_panel_of_a_printed_box_is_upright_and_not_mirrored(name, panels, side):
    """Oracle: the panel as drawn, compared with the view from in front of that side."""
    part, panel = part_of(name), panels()[side]
    normal, up = READERS[side]
    width_m = abs(np.cross(up, normal) @ part.mesh.extent_m)
    height_m = abs(np.array(up) @ part.mesh.extent_m)
    h, w = panel.shape[:2]
    row, column = np.mgrid[14 : h - 14 : 2, 14 : w - 14 : 2]  # inside the rounded edges
    right_m = ((column + 0.5) / w - 0.5) * width_m
    up_m = (0.5 - (row + 0.5) / h) * height_m
    picture = view_of(part, normal, up, right_m, up_m)
    expected = panel[row, column].astype(float)
    assert np.abs(picture - expected).mean() < 1  # some texels belong to their neighbour
    assert likeness(picture, expected) > 0.99
    for wrong in (expected[:, ::-1], expected[::-1], expected[::-1, ::-1]):
        assert likeness(picture, wrong) < 0.9


BOTTLE_AXIS_M = 0.029 - 0.067 / 2  # x of the body's axis: the nozzle shifts the box's middle


@pytest.mark.slow
def test_the_front_of_the_bottle_shows_its_name_upright_and_not_mirrored():
    """The middle of the front is nearly flat, so arc length equals x there."""
    part, panel = part_of("hygiene_spray"), spray_panels()["body"]
    girth_m, height_m = 0.1774, 0.128  # of the superellipse 58 x 46 mm, exponent 3.2; to the neck
    h, w = panel.shape[:2]
    row, column = np.mgrid[int(0.26 * h) : int(0.55 * h) : 2, int(0.43 * w) : int(0.57 * w) : 2]
    right_m = ((column + 0.5) / w - 0.5) * girth_m + BOTTLE_AXIS_M
    up_m = (1 - (row + 0.5) / h) * height_m - part.mesh.extent_m[2] / 2
    picture = view_of(part, (0, -1, 0), (0, 0, 1), right_m, up_m)
    expected = panel[row, column].astype(float)
    assert likeness(picture, expected) > 0.9
    for wrong in (expected[:, ::-1], expected[::-1], expected[::-1, ::-1]):
        assert likeness(picture, wrong) < 0.6


@pytest.mark.slow
def test_the_label_wraps_once_around_the_bottle_with_its_seam_at_the_back():
    """From behind the bottle, the panel's two ends meet in the middle."""
    part, panel = part_of("hygiene_spray"), spray_panels()["body"]
    uv = part.mesh.corner_uv
    assert uv.min() >= 0 and uv.max() <= 1
    assert np.ptp(uv[..., 0], axis=1).max() < 0.1  # no face crosses the whole label in reverse
    # From behind, right is -x: the panel's left end, with the barcode, is right of the seam.
    x_m = np.linspace(-0.018, 0.018, 61)[None] - BOTTLE_AXIS_M
    z_m = np.full_like(x_m, 0.6 * 0.128 - part.mesh.extent_m[2] / 2)
    picture = view_of(part, (0, 1, 0), (0, 0, 1), x_m, z_m)[0]
    h, w = panel.shape[:2]
    arc = (x_m[0] + BOTTLE_AXIS_M) / 0.1774 % 1.0
    expected = panel[int(0.4 * h), (arc * w).astype(int)].astype(float)
    assert likeness(picture, expected) > 0.7
    assert likeness(picture, expected[::-1]) < 0.5
