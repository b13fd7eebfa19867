import numpy as np
import trimesh

from graycast.world.parts.normals import crease_normals
from graycast.world.parts.shapes import rounded_box


def test_a_cylinder_is_smooth_around_its_axis_and_sharp_at_its_rims():
    """Oracle: the radial direction, which is exact at a regular prism's vertices by symmetry."""
    mesh = trimesh.creation.cylinder(radius=0.02, height=0.05, sections=48)
    normal = crease_normals(mesh.vertices, mesh.faces, np.radians(30))
    corner = mesh.vertices[mesh.faces]
    side = np.abs(mesh.face_normals[:, 2]) < 0.5
    radial = corner[side] * [1, 1, 0]
    radial = radial / np.linalg.norm(radial, axis=-1, keepdims=True)
    assert np.abs(normal[side] - radial).max() < 1e-9
    assert np.abs(normal[~side] - mesh.face_normals[~side][:, None]).max() < 1e-9


def test_facets_at_angles_above_the_crease_angle_remain_flat():
    mesh = trimesh.creation.cylinder(radius=0.02, height=0.05, sections=48)  # 7.5 degree steps
    normal = crease_normals(mesh.vertices, mesh.faces, np.radians(7))
    assert np.abs(normal - mesh.face_normals[:, None]).max() < 1e-9


def test_corner_normals_of_a_smoothed_cube_are_along_its_diagonals():
    """For any triangulation of its sides, each side has the same weight at a corner."""
    mesh = trimesh.creation.box((1, 1, 1))
    normal = crease_normals(mesh.vertices, mesh.faces, np.radians(95))
    assert np.abs(normal - mesh.vertices[mesh.faces] * 2 / np.sqrt(3)).max() < 1e-12


def test_sphere_normals_converge_at_least_linearly_in_the_edge_length():
    error = []
    for subdivisions in (2, 3, 4):
        mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
        normal = crease_normals(mesh.vertices, mesh.faces, np.radians(40))
        error.append(np.abs(normal - mesh.vertices[mesh.faces]).max())
    assert error[0] < 0.02
    assert error[0] / error[1] > 1.9
    assert error[1] / error[2] > 1.9


def test_flat_sides_of_a_finely_rounded_box_have_flat_normals():
    vertices, faces, panel = rounded_box((70.0, 60.0, 145.0), 2.5, steps=3)
    normal = crease_normals(vertices, faces, np.radians(35))
    corner = vertices[faces]
    flat = (np.ptp(corner[..., 2], axis=1) == 0) & (np.array(panel) == "top")
    large = flat & (np.ptp(corner[..., 0], axis=1) > 50) & (np.ptp(corner[..., 1], axis=1) > 50)
    assert large.sum() == 2
    assert np.degrees(np.arccos(normal[large][..., 2].min())) < 1.0


def test_rotating_a_mesh_rotates_its_crease_normals():
    mesh = trimesh.creation.torus(0.03, 0.01, major_sections=24, minor_sections=12)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7]))[:3, :3]
    straight = crease_normals(mesh.vertices, mesh.faces, 0.6)
    turned = crease_normals(mesh.vertices @ turn.T, mesh.faces, 0.6)
    assert np.abs(straight @ turn.T - turned).max() < 1e-9
