"""Triangle meshes of Coal shapes are on the surface, closed, and have the right volume."""

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="needs pinocchio: pip install 'graycast[pick]'")

import coal
import trimesh

from graycast.base.errors import ConfigError
from graycast.base.frames import rigid
from graycast.robot.pick.arm.obstacles import triangles
from graycast.robot.pick.tool.solids import ROUND, joined, shape_mesh


def solid(mesh):
    return trimesh.Trimesh(mesh.vertices_m, mesh.faces)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (coal.Sphere(0.05), 4 / 3 * np.pi * 0.05**3),
        (coal.Cylinder(0.03, 0.2), np.pi * 0.03**2 * 0.2),
        (coal.Box(0.1, 0.2, 0.3), 0.1 * 0.2 * 0.3),
    ],
)
def test_a_shape_has_the_right_volume_and_centre(shape, volume):
    """Oracle: closed forms; a polygon of n corners has n / (2 pi) sin(2 pi / n) of its circle."""
    mesh = solid(shape_mesh(shape))
    corners = ROUND / (2 * np.pi) * np.sin(2 * np.pi / ROUND)
    assert mesh.is_watertight
    assert 0.98 * corners * volume <= mesh.volume <= volume * (1 + 1e-9)
    np.testing.assert_allclose(mesh.center_mass, 0, atol=1e-9)


def test_a_mesh_is_returned_unchanged():
    cube = trimesh.creation.box((0.1, 0.2, 0.3))
    mesh = shape_mesh(triangles(shape_mesh(coal.Box(0.1, 0.2, 0.3))))
    assert solid(mesh).volume == pytest.approx(cube.volume)


def test_a_shape_that_urdf_does_not_define_is_named():
    with pytest.raises(ConfigError, match="Plane cannot be drawn"):
        shape_mesh(coal.Plane(0.0, 0.0, 1.0, 0.0))


def test_joined_meshes_keep_their_poses():
    box = shape_mesh(coal.Box(0.1, 0.1, 0.1))
    apart = rigid(np.eye(3), np.array([1.0, 0.0, 0.0]))
    both = solid(joined([(box, np.eye(4)), (box, apart)]))
    np.testing.assert_allclose(both.bounds, [[-0.05, -0.05, -0.05], [1.05, 0.05, 0.05]])
    assert both.volume == pytest.approx(2e-3)
