"""Parts that are defined by a few numbers and have closed forms."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from graycast.world.drop import Decomposition, prepare
from graycast.world.parts import Material, Mesh, Part
from graycast.world.scene import Bin, Scene

RING_INNER_M, RING_OUTER_M, RING_HEIGHT_M = 0.015, 0.025, 0.010


def as_part(shape: trimesh.Trimesh, name: str, friction: float = 0.4) -> Part:
    mesh = Mesh(vertices_m=np.array(shape.vertices), faces=np.array(shape.faces))
    return Part(name=name, mesh=mesh, material=Material(), density_kg_m3=2700.0, friction=friction)


def convex_hulls(part: Part, folder: Path) -> Decomposition:
    (hulls,) = prepare((part,), hull_folder=folder)
    return hulls


def box_part(size_m: tuple[float, float, float], friction: float = 0.4) -> Part:
    return as_part(trimesh.creation.box(size_m), "box", friction)


@pytest.fixture(scope="session")
def ring_part() -> Part:
    shape = trimesh.creation.annulus(RING_INNER_M, RING_OUTER_M, RING_HEIGHT_M, sections=64)
    return as_part(shape, "ring")


@pytest.fixture(scope="session")
def angle_part() -> Part:
    """Return an L of two boxes: 50 x 30 x 8 mm lying, 8 x 30 x 42 mm standing on its end."""
    lying, standing = (
        trimesh.creation.box((0.05, 0.03, 0.008)),
        trimesh.creation.box((0.008, 0.03, 0.042)),
    )
    standing.apply_translation((-0.021, 0.0, 0.025))
    return as_part(trimesh.boolean.union([lying, standing], engine="manifold"), "angle")


@pytest.fixture(scope="session")
def hull_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hulls")


@pytest.fixture(scope="session")
def ring_hulls(ring_part, hull_folder):
    return convex_hulls(ring_part, hull_folder).hulls


@pytest.fixture
def scene_of():
    def build(parts: tuple[Part, ...], inner_m=(0.4, 0.3, 0.2)) -> Scene:
        from graycast.rig.pair import preset_rig

        box = Bin(inner_m=inner_m)
        return Scene(rig=preset_rig("paper"), T_world_cam=np.eye(4), parts=parts, bin=box)

    return build
