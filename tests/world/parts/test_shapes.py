import numpy as np
import pytest
import trimesh

from graycast.world.parts.shapes import loft, revolve, rounded_box, superellipse


def closed(vertices, faces):
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    return mesh


def test_the_volume_of_a_revolved_profile_follows_pappus_s_theorem():
    """Oracle: V = 2 pi r_centroid A for a triangle, times the share of a circle in n chords."""
    profile, n = np.array([[2.0, 0.0], [5.0, 1.0], [3.0, 4.0]]), 40
    area = 0.5 * (3 * 4 - 1 * 1)
    pappus = 2 * np.pi * profile[:, 0].mean() * area
    mesh = closed(*revolve(profile, n))
    assert mesh.volume == pytest.approx(pappus * np.sin(2 * np.pi / n) / (2 * np.pi / n), rel=1e-12)


def test_the_volume_of_a_rounded_box_follows_steiner_s_formula():
    """Oracle: Steiner's formula for a box grown by r, its quarter circles replaced by chords."""
    size, r, steps = (70.0, 60.0, 145.0), 8.0, 3
    a, b, c = (side - 2 * r for side in size)
    chords = 8 * steps  # chords of a full circle
    circle = 0.5 * chords * np.sin(2 * np.pi / chords) * r**2
    prisms = a * b * c + 2 * r * (a * b + b * c + c * a) + circle * (a + b + c)
    vertices, faces, _ = rounded_box(size, r, steps)
    ball = closed(vertices, faces).volume - prisms
    assert 0.96 < ball / (4 / 3 * np.pi * r**3) < 1.0
    assert np.ptp(vertices, axis=0) == pytest.approx(size, rel=1e-12)


def test_a_box_with_almost_sharp_edges_has_the_inertia_of_a_sharp_box():
    """Oracle: m (b^2 + c^2) / 12; trimesh integrates the mesh."""
    a, b, c = 0.19, 0.038, 0.045
    vertices, faces, _ = rounded_box((a, b, c), 1e-7, steps=1)
    mesh = closed(vertices, faces)
    squares = np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    assert mesh.moment_inertia == pytest.approx(np.diag(a * b * c * squares / 12), abs=1e-10)


def test_each_panel_of_a_rounded_box_faces_its_named_direction():
    vertices, faces, panel = rounded_box((0.3, 0.2, 0.1), 0.01, steps=2)
    normal = closed(vertices, faces).face_normals
    outward = {"front": -normal[:, 1], "right": normal[:, 0], "back": normal[:, 1],
               "left": -normal[:, 0], "top": normal[:, 2], "bottom": -normal[:, 2]}  # fmt: skip
    for name, cosine in outward.items():
        mine = np.array(panel) == name
        assert mine.sum() == 50
        assert cosine[mine].min() > 0.4  # up to the middle of a rounded corner


def test_a_loft_between_equal_sections_has_the_volume_of_a_prism():
    """Oracle: the area of |x/a|^4 + |y/b|^4 = 1 is 4 a b gamma(5/4)^2 / gamma(3/2)."""
    from math import gamma

    sections = np.stack([superellipse(3.0, 2.0, 4.0, z, 720) for z in (0.0, 1.0, 5.0)])
    mesh = closed(*loft(sections))
    area = 4 * 3 * 2 * gamma(5 / 4) ** 2 / gamma(3 / 2)
    assert mesh.volume == pytest.approx(5 * area, rel=5e-5)
